"""A running simulation written as it goes on: the moment after some frames, or a clip."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

from ..errors import BlewUp, why
from ..files import new_name
from ..guard import Guard
from ..scene.model import FRAME_SECONDS
from ..simulation import Simulation
from .obj import write_obj
from .output import Output
from .pc2 import pc2_clip
from .ply import write_ply
from .sheet import Sheet, sheet_of, turned_up, vertex_normals

Add = Callable[[], None]  # takes a sample: the cloth and the colliders as they are now


def export(simulation: Simulation, output: Output, on_frame: Callable[[int], None]) -> None:
    """Runs the simulation for `output.frames` frames and writes what was asked for; folders must be there.

    `on_frame(k)` is called after every frame. Raises BlewUp when the cloth does, and OSError when a file cannot be
    written: the numbered files of a clip that are finished stay, any other file is whole or as it was.
    """
    frames = _frames(simulation, output.frames, on_frame)
    if output.clip:
        with _clip(output, simulation) as add:
            for k in frames:
                if k % output.every == 0:
                    add()
    else:
        for _ in frames:
            pass
        write_moment(output.path, output.format, simulation, output.up)


def write_moment(path: Path, format: str, simulation: Simulation, up: str = "y") -> None:
    """The cloth as it is now, without what is torn, as an OBJ, PLY or USD file. Raises OSError."""
    sheet, x = _sheet(simulation), simulation.positions()
    if format == "usd":
        from .usd import write_usd

        write_usd(path, sheet, x, simulation.bodies(), up)
    else:
        write = {"obj": write_obj, "ply": write_ply}[format]
        x = turned_up(x, up)
        write(path, sheet, x, vertex_normals(x, sheet.triangles))


def snapshot(simulation: Simulation, folder: Path) -> str:
    """Writes the cloth as it is now to an OBJ file of its own; returns the line that says where, or why not."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        name = new_name(folder, simulation.scene.name)
        path = name.with_name(f"{name.name}.obj")
        write_moment(path, "obj", simulation)
    except OSError as error:
        return f"no mesh: {why(error)}"
    return f"frame {simulation.frame} is in {folder.name}/{path.name}"


def _sheet(simulation: Simulation) -> Sheet:
    return sheet_of(simulation.scene.name, simulation.topology)


def _frames(simulation: Simulation, frames: int, on_frame: Callable[[int], None]) -> Iterator[int]:
    """Numbers of frames, each before it is simulated. Raises BlewUp."""
    guard = Guard(simulation)
    for k in range(frames):
        yield k
        simulation.advance_frame()
        if not guard.sound():
            raise BlewUp(guard.restore())
        on_frame(k)


@contextmanager
def _clip(output: Output, simulation: Simulation) -> Iterator[Add]:
    """A function that adds the next sample to a clip. In one file the triangles are those of the first."""
    if output.format == "usd":
        from .usd import usd_clip

        rate = 1 / (FRAME_SECONDS * output.every)
        with usd_clip(output.path, _sheet(simulation), output.up, rate) as write:
            yield lambda: write(simulation.positions(), simulation.bodies())
    elif output.format == "pc2":
        yield from _point_cache(output, simulation)
    elif output.format == "html":
        from .html import html_clip

        with html_clip(output.path, simulation, 1 / (FRAME_SECONDS * output.every)) as write_page:
            yield write_page
    else:
        numbers = count()
        yield lambda: write_moment(output.numbered(next(numbers)), output.format, simulation, output.up)


def _point_cache(output: Output, simulation: Simulation) -> Iterator[Add]:
    sheet, first = _sheet(simulation), turned_up(simulation.positions(), output.up)
    with pc2_clip(output.path, len(sheet.uv), output.samples) as write:
        yield lambda: write(turned_up(simulation.positions(), output.up))
        # Without normals, which would stay behind when the cache moves the mesh.
        write_obj(output.mesh, sheet, first)
