"""Run a simulation and export it: the cloth after some frames, or a clip of all frames. `tc.Simulation`."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import count
from os import PathLike
from pathlib import Path
from typing import BinaryIO, SupportsIndex

import numpy as np

from ..collision.colliders import PosedCollider, is_deforming
from ..geometry.scene_loader import load_scene
from ..geometry.topology import ClothMetrics
from ..render.draw_list import TriangleSoup, collider_color, pole_mesh
from ..render.image import render_image
from ..render.webgl import local_mesh, merge_corners, pose_matrix
from ..scene import Scene, parameters_of
from ..scene.collider_schema import Ground
from ..scene.schema import FRAME_SECONDS, sections
from ..simulation.convergence import overstretched, unconverged
from ..simulation.copies import FrameError, FrameErrorMeter
from ..simulation.events import Event
from ..simulation.parameter_values import check_frames
from ..simulation.recording import read_recording, run_recording
from ..simulation.rollback import DivergenceGuard, guarded_frames
from ..simulation.running_cloth import check_simulation
from ..simulation.simulation import Simulation as BaseSimulation
from ..state import ClothState
from ..system.errors import Diverged, UsageError
from ..system.files import next_free_path
from .mesh_files import (
    ExportMesh,
    Floats,
    Solid,
    collider_name,
    export_mesh_of,
    floor_square,
    glb_clip,
    pc2_clip,
    rotate_to_up,
    vertex_normals,
    write_obj,
    write_ply,
)
from .output import BY_SUFFIX, CLIP_ONLY_FORMATS, Output, check_format, format_of

Add = Callable[[], None]  # adds a sample to a clip: the cloth and the colliders as they are now


def export(simulation: BaseSimulation, output: Output, on_frame: Callable[[int], object]) -> None:
    """Run the simulation for `output.frames` frames and write its output. The folder must exist.

    `on_frame(k)` is called after frame k. Raises Diverged if the cloth blows up, and OSError if a file cannot be
    written. After an error the finished numbered files of a clip remain; any other file is as it was before.
    """
    before = output.first if output.clip else output.frames
    for _ in guarded_frames(simulation, range(before), on_frame):
        pass
    if output.clip:
        with _clip(output, simulation) as add:
            for k in guarded_frames(simulation, range(before, output.frames), on_frame):
                if (k - before) % output.every == 0:
                    add()
    else:
        write_frame(output.path, output.format, simulation, output.up)


def write_frame(path: Path, format: str, simulation: BaseSimulation, up: str = "y") -> None:
    """Write the cloth as it is now, without torn triangles, to an OBJ, PLY, USD or glTF file. Raises OSError."""
    sheet, x = _sheet(simulation), simulation.positions()
    if format == "usd":
        from .usd import write_usd

        write_usd(path, sheet, x, simulation.colliders(), up, _pole(simulation))
    elif format == "glb":
        with glb_clip(path, sheet, _solids(simulation), 1, 1.0) as add:
            add(x, _poses(simulation))
    else:
        write = {"obj": write_obj, "ply": write_ply}[format]
        x = rotate_to_up(x, up)
        write(path, sheet, x, vertex_normals(x, sheet.triangles))


def export_mesh(simulation: Simulation, path: str | PathLike[str], up: str = "y") -> None:
    """Write the cloth as it is now, as `Simulation.export` does."""
    check_simulation(simulation)
    file = Path(path)
    format = BY_SUFFIX.get(file.suffix.lower(), "")
    if not format or format in CLIP_ONLY_FORMATS:
        suffixes = [suffix for suffix, name in BY_SUFFIX.items() if name not in CLIP_ONLY_FORMATS]
        problem = f"{CLIP_ONLY_FORMATS[format]} a clip, not one frame" if format else f"unknown suffix {file.suffix!r}"
        more = "; export_clip writes clips" if format else ""
        raise UsageError(f"{file}: {problem}; use {', '.join(suffixes)}{more}")
    check_format(format, up)
    file.parent.mkdir(parents=True, exist_ok=True)
    write_frame(file, format, simulation, up)


def export_clip(simulation: Simulation, output: Output, on_frame: Callable[[int], object] | None) -> None:
    """Run a simulation and write a clip, as `Simulation.export_clip` does."""
    check_simulation(simulation)
    check_format(output.format, output.up)
    output.prepare()
    export(simulation, output, on_frame or (lambda _: None))


def tuned_scene(simulation: BaseSimulation) -> Scene:
    """Return the scene with the present values of the parameters; without wind its air is at rest, and slows cloth."""
    values: dict[str, object] = {}
    for name, one in parameters_of(simulation.scene).items():
        index = f"[{one.index}]" if sections()[one.section].is_array else ""
        values[f"{one.section}{index}.{one.key_name}"] = simulation.params[name]
    tuned = load_scene(simulation.scene, **values)
    return tuned if tuned.wind is None or simulation.params["wind"] else load_scene(tuned, wind_x=0.0, wind_z=0.0)


# What other modules of this package use. It is not documented, and the completion of names leaves it out.
_INNER = """
built check_between_frames check_particle depenetration displacements find_pairs frames_stepped free_positions grabs h
has_changed has_self_contact is_held_still notify origin place rebuild reduces_damping requested_layout
scene_colliders set_frame set_grabs set_origin set_pins set_torn
"""
INNER_NAMES = frozenset(_INNER.split())


CHECKED_EVERY = 10  # frames between checks for divergence, which take 0.16 ms, a quarter of a frame of 15×15 particles


class Simulation(BaseSimulation):  # with what the base class cannot import, as it is used there
    __doc__ = BaseSimulation.__doc__

    _frame_error: FrameError | None = None
    _measured: tuple[Scene, FrameErrorMeter] | None = None
    _guarded: tuple[ClothState, DivergenceGuard] | None = None
    _unchecked = 0  # frames since the last check for divergence

    def __dir__(self) -> list[str]:
        return [name for name in super().__dir__() if name not in INNER_NAMES and (name[0] != "_" or name[:2] == "__")]

    @property
    def warnings(self) -> str:
        """One line about what differs from the request, is unusual or goes wrong; empty if there is nothing to say.

        It names what the solver does not use as the scene sets it, values that are often mistakes, cloth inside a
        collider at the start, held still, or stretched to twice its length, a thickness that does not suit the cells,
        and too few iterations: of `verlet` and `xpbd` for a sheet that hangs from its pins, and of `lines` for single
        pins. Grabs count as pins if the cloth has none; with `lines` no figure is given for them. Nothing is estimated
        for `implicit`, and for tethered cloth with `lines`.
        """
        few = unconverged(self.scene, self.topology, self.h, int(self.params["iterations"]), self.grabbed)
        stretched = overstretched(self.topology, self.positions())
        return "; ".join(filter(None, [super().warnings, few, stretched, self._unknown_error()]))

    def _unknown_error(self) -> str:
        found = self._measured_error
        if found is None or found.reference_has_converged:
            return ""
        return f"the error of frame {found.frame} is not known: its reference has not converged (docs/frame_error.md)"

    def step(self, frames: SupportsIndex = 1, *, measure_error: bool = False) -> None:
        """Advance by frames of 1/60 s.

        `measure_error`: measure the error of the last frame, which `frame_error` and `metrics` have then, unless its
        reference has not converged: in folded cloth that touches itself its own error can be as large. The first
        time, and after a change of the scene, it compiles for some seconds. Raises UsageError if the fabric is too
        stiff for the reference; nothing has changed then. Raises ValueError for a number that is not an integer from 0.

        Raises Diverged, with advice, if the cloth has blown up: a position is not finite, or a speed exceeds 10⁴ m/s.
        This is checked at the end of a call, once ten frames have passed since the last check. `reset`, `load` and
        `set_state` bring the cloth back.
        """
        wanted, guard = check_frames(frames), self._guard_of_cloth()
        if not measure_error or not wanted:
            super().step(wanted)
            self._frame_error = None
        else:
            meter = self._meter()
            super().step(wanted - 1)
            if not guard.check_and_snapshot():  # no copy can have this state
                raise Diverged(guard.describe())
            self._frame_error = meter.measure_frame(self, super().step)
        self._unchecked += wanted
        if self._unchecked >= CHECKED_EVERY:
            self._unchecked = 0
            if not guard.check_and_snapshot():
                raise Diverged(guard.describe())

    def _guard_of_cloth(self) -> DivergenceGuard:
        if self._guarded is None or self._guarded[0] is not self.cloth:  # another scene or solver has another cloth
            # A guard that referred to this simulation would keep it, and its fields, from being freed at once.
            self._guarded = self.cloth, DivergenceGuard(weakref.proxy(self))
        return self._guarded[1]

    @property
    def frame_error(self) -> FrameError | None:
        """Error of the present frame if `step` measured it and nothing has changed since, else None.

        None too if its reference has not converged: `warnings` says so.
        """
        found = self._measured_error
        return found if found and found.reference_has_converged else None

    @property
    def _measured_error(self) -> FrameError | None:
        """The error of the present frame, also if its reference has not converged."""
        return self._frame_error if self._frame_error and self._frame_error.frame == self.frame else None

    def notify(self, event: Event) -> None:
        if event.name not in ("move_grab", "find_pairs"):  # which change nothing before the next frame
            self._frame_error = None
        super().notify(event)

    def tuned_scene(self) -> Scene:
        """Return the scene with the present values of `params`, with air at rest if the wind is off, for `save_scene`.

        A checkpoint has these values too; it belongs to the scene that runs, `scene`, not to this one.
        """
        return tuned_scene(self)

    def _meter(self) -> FrameErrorMeter:
        if self._measured is None or self._measured[0] != self.scene:
            self._close_meter()
            self._measured = self.scene, FrameErrorMeter(self.scene, self.requested_layout)
        return self._measured[1]

    def _close_meter(self) -> None:
        if self._measured is not None:
            self._measured[1].close()
        self._measured = None

    def metrics(self) -> ClothMetrics:
        """Return strain, energy and penetration of the cloth as it is now, and the error of its frame if measured."""
        found, error = super().metrics(), self.frame_error
        return replace(found, frame_error=error.error) if error else found

    def close(self) -> None:
        """Release the fields for the next simulation. Closing twice does no harm."""
        self._close_meter()
        self._guarded = None
        super().close()

    def save(self, path: str | PathLike[str] | BinaryIO) -> None:
        """Write a checkpoint (.npz) to a path or an open binary file, such as io.BytesIO. Not within a frame.

        A missing folder is made. Raises OSError; a partial file never remains.
        """
        if isinstance(path, str | PathLike):
            Path(path).parent.mkdir(parents=True, exist_ok=True)
        super().save(path)

    def export(self, path: str | PathLike[str], up: str = "y") -> None:
        """Write the cloth as it is now to an OBJ, PLY, USD or glTF file, by the suffix of `path`. `up`: "y" or "z".

        A missing folder is made. Raises UsageError for another suffix, for another axis, and for z in a glTF file, and
        OSError; a partial file never remains.
        """
        export_mesh(self, path, up)

    def export_clip(
        self,
        path: str | PathLike[str],
        frames: SupportsIndex,
        *,
        every: SupportsIndex = 1,
        up: str = "y",
        format: str | None = None,
        on_frame: Callable[[int], object] | None = None,
    ) -> None:
        """Run some frames, and write the cloth before every `every`-th of them to a clip, by the suffix of `path`.

        .pc2 (with an OBJ file beside it), .usdc, .usda, .usd, .glb and .html are one file; a path without a suffix is a
        folder of OBJ files, or of PLY files if `format` is "ply". `up`: "y" or "z". `on_frame(k)` is called after step
        k, 0 first, when the cloth is that of the frame k + 1. It may move grabs and change parameters, but not step,
        reset or change the scene (UsageError).

        Existing files are replaced, and a missing folder is made. Raises UsageError for another suffix, format or axis,
        ValueError for numbers that are not integers from 1, Diverged if the cloth blows up, and OSError; a partial file
        never remains, and the finished files of a folder do.
        """
        count, step = check_frames(frames, "frames", 1), check_frames(every, "every", 1)
        chosen = format_of(Path(path), format, clip=True)
        export_clip(self, Output(Path(path), chosen, count, up, clip=True, every=step), on_frame)

    def _repr_png_(self) -> bytes | None:
        """Return an image of the current frame as a PNG file; None for a closed simulation."""
        return None if self.closed else render_image(self)._repr_png_()


def replay(path: str | PathLike[str]) -> Simulation:
    """Replay a recording without drawing it. Return the simulation after its last frame.

    Raises UsageError and SceneError, one line, for a file that is not a recording and for an event that the scene does
    not support.
    """
    recording = read_recording(Path(path))
    simulation = Simulation(recording.scene, recording.layout)
    try:
        run_recording(recording, simulation)
    except UsageError as error:
        simulation.close()
        raise UsageError(f"{path}: {error}") from None
    return simulation


def export_snapshot(simulation: BaseSimulation, folder: Path) -> Path:
    """Write the cloth as it is now to a new OBJ file in a folder. Return its path. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    path = next_free_path(folder, "mesh").with_suffix(".obj")
    write_frame(path, "obj", simulation)
    return path


def _sheet(simulation: BaseSimulation) -> ExportMesh:
    return export_mesh_of(simulation.scene, simulation.topology)


def _solids(simulation: BaseSimulation) -> list[Solid]:
    """Return the colliders, each in its own coordinates, and the pole."""
    colliders = simulation.colliders()
    return [*(_collider(simulation, *one) for one in enumerate(colliders)), *_pole(simulation)]


def _collider(simulation: BaseSimulation, number: int, posed: PosedCollider) -> Solid:
    """Return a collider in its own coordinates."""
    name = collider_name(number, posed.collider)
    if is_deforming(posed.collider):
        mesh = local_mesh(posed)
        _, _, owner = merge_corners(mesh)

        def vertices_now() -> tuple[Floats, Floats]:
            positions, normals, _ = local_mesh(simulation.colliders()[number])
            return positions[owner].astype(np.float64), normals[owner].astype(np.float64)

        return replace(_solid(name, mesh), vertices_now=vertices_now)
    if not isinstance(posed.collider, Ground):
        return _solid(name, local_mesh(posed))
    corners = floor_square(simulation.positions(), posed.center)
    up = np.tile([0.0, 1.0, 0.0], (4, 1))
    return Solid(name, np.array(collider_color(posed)), corners, up, np.array([[0, 1, 2], [0, 2, 3]]))


def _pole(simulation: BaseSimulation) -> list[Solid]:
    """Return the pole in world space, if the scene has one."""
    if not simulation.scene.look.pole:
        return []
    return [_solid("pole", pole_mesh(simulation.scene, simulation.topology.start))]


def _solid(name: str, soup: TriangleSoup) -> Solid:
    vertices, corners, _ = merge_corners(soup)
    return Solid(name, soup[2][0], vertices[:, :3], vertices[:, 3:], corners.reshape(-1, 3))


def _poses(simulation: BaseSimulation) -> Floats:
    """Return the current pose of each of the `_solids` as a matrix, (K, 4, 4)."""
    poses = [pose_matrix(posed, posed.size[0]) for posed in simulation.colliders()]
    if simulation.scene.look.pole:
        poses.append(np.eye(4))
    return np.array(poses).reshape(-1, 4, 4)


@contextmanager
def _clip(output: Output, simulation: BaseSimulation) -> Iterator[Add]:
    """Yield a function that adds a sample to a clip. A clip in one file has the triangles of its first sample."""
    rate = 1 / (FRAME_SECONDS * output.every)
    if output.format == "usd":
        from .usd import usd_clip

        with usd_clip(output.path, _sheet(simulation), output.up, rate, _pole(simulation)) as write:
            yield lambda: write(simulation.positions(), simulation.colliders())
    elif output.format == "glb":
        with glb_clip(output.path, _sheet(simulation), _solids(simulation), output.samples, rate) as add:
            yield lambda: add(simulation.positions(), _poses(simulation))
    elif output.format == "pc2":
        yield from _point_cache(output, simulation)
    elif output.format == "html":
        from .html import html_clip

        with html_clip(output.path, simulation, rate) as write_page:
            yield write_page
    else:
        numbers = count()
        yield lambda: write_frame(output.sample_path(next(numbers)), output.format, simulation, output.up)


def _point_cache(output: Output, simulation: BaseSimulation) -> Iterator[Add]:
    sheet, first = _sheet(simulation), rotate_to_up(simulation.positions(), output.up)
    with pc2_clip(output.path, len(sheet.uv), output.samples) as write:
        yield lambda: write(rotate_to_up(simulation.positions(), output.up))
        # Without normals: the cache moves points only, so they would keep their first directions.
        write_obj(output.mesh, sheet, first)
