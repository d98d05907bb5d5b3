"""A running simulation written as it goes on: the moment after some frames, or a clip."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ..contact.bodies import Body
from ..errors import BlewUp, why
from ..guard import Guard
from ..scene.model import FRAME_SECONDS
from ..simulation import Simulation
from .obj import write_obj
from .output import Output
from .pc2 import pc2_clip
from .ply import write_ply
from .sheet import Floats, Sheet, sheet_of, turned_up, vertex_normals

Add = Callable[[Floats, list[Body]], None]  # takes a sample: places (N, 3) [m], y up, and the colliders


def export(simulation: Simulation, output: Output, on_frame: Callable[[int], None]) -> None:
    """Runs the simulation for `output.frames` frames and writes what was asked for; folders must be there.

    `on_frame(k)` is called after every frame. Raises BlewUp when the cloth does, and OSError when a file cannot be
    written: the numbered files of a clip that are finished stay, any other file is whole or as it was.
    """
    sheet = sheet_of(simulation.scene.name, simulation.topology)
    frames = _frames(simulation, output.frames, on_frame)
    if output.clip:
        with _clip(output, sheet) as add:
            for k in frames:
                if k % output.every == 0:
                    add(simulation.positions(), simulation.bodies())
    else:
        for _ in frames:
            pass
        write_moment(output.path, output.format, sheet, simulation, output.up)


def write_moment(path: Path, format: str, sheet: Sheet, simulation: Simulation, up: str = "y") -> None:
    """The cloth as it is now, as an OBJ, PLY or USD file. Raises OSError."""
    if format == "usd":
        from .usd import write_usd

        write_usd(path, sheet, simulation.positions(), simulation.bodies(), up)
    else:
        _write_mesh(path, format, sheet, turned_up(simulation.positions(), up))


def snapshot(simulation: Simulation, folder: Path) -> str:
    """Writes the cloth as it is now to an OBJ file of its own; returns the line that says where, or why not."""
    name, number = simulation.scene.name, 1
    while (path := folder / f"{name}_{number:03d}.obj").exists():
        number += 1
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_moment(path, "obj", sheet_of(name, simulation.topology), simulation)
    except OSError as error:
        return f"{path.name} could not be written: {why(error)}"
    return f"frame {simulation.frame} is in {folder.name}/{path.name}"


def _frames(simulation: Simulation, frames: int, on_frame: Callable[[int], None]) -> Iterator[int]:
    """Numbers of frames, each before it is simulated. Raises BlewUp."""
    guard = Guard(simulation)
    for k in range(frames):
        yield k
        simulation.advance_frame()
        if not guard.sound():
            raise BlewUp(guard.restore())
        on_frame(k)


def _write_mesh(path: Path, format: str, sheet: Sheet, x: Floats) -> None:
    write = {"obj": write_obj, "ply": write_ply}[format]
    write(path, sheet, x, vertex_normals(x, sheet.triangles))


@contextmanager
def _clip(output: Output, sheet: Sheet) -> Iterator[Add]:
    """A function that adds the next sample to a clip."""
    if output.format == "usd":
        from .usd import usd_clip

        with usd_clip(output.path, sheet, output.up, 1 / (FRAME_SECONDS * output.every)) as add:
            yield add
    elif output.format == "pc2":
        yield from _point_cache(output, sheet)
    else:
        yield from _numbered(output, sheet)


def _point_cache(output: Output, sheet: Sheet) -> Iterator[Add]:
    first: list[Floats] = []
    with pc2_clip(output.path, len(sheet.uv), output.samples) as write:

        def add(x: Floats, bodies: list[Body]) -> None:
            places = turned_up(x, output.up)
            if not first:
                first.append(places)
            write(places)

        yield add
        # Without normals, which would stay behind when the cache moves the mesh.
        write_obj(output.mesh, sheet, first[0])


def _numbered(output: Output, sheet: Sheet) -> Iterator[Add]:
    sample = 0

    def add(x: Floats, bodies: list[Body]) -> None:
        nonlocal sample
        _write_mesh(output.numbered(sample), output.format, sheet, turned_up(x, output.up))
        sample += 1

    yield add
