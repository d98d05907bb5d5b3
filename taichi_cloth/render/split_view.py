"""Two running scenes side by side in one image, seen by one camera, and their comparison.

The result is a sequence of numbered PNG files, and a report with the times and strains of each frame.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..scene import Camera, Scene, scene_to_toml
from ..simulation.copies import MAX_SECONDS, FrameError, FrameErrorMeter
from ..simulation.rollback import DivergenceGuard
from ..simulation.simulation import Simulation
from ..system.errors import Diverged, UsageError
from ..system.files import atomic_file
from ..system.taichi_runtime import machine
from .camera import OrbitCamera, camera_of, floor_height
from .colors import draw_legend_below
from .draw_list import DrawList
from .image import MEASURED_EVERY, RenderPlan, render_without_scale
from .image_files import Pixels, background_writer
from .rasterizer import Rasterizer

# -- images ------------------------------------------------------------------------------------------------------------

SEAM = 2  # [pixels] between the halves
MIN_ASPECT = (
    1.15  # smallest aspect ratio (width / height) at which an image shows what the scene's camera is meant to show
)


def camera_for_both(scene: Scene, aspect: float) -> OrbitCamera:
    """Return the scene's camera, farther away for an aspect ratio below `MIN_ASPECT`, to show the same width."""
    camera = camera_of(scene)
    eye, target = np.array(camera.eye), np.array(camera.target)
    far = target + max(1.0, MIN_ASPECT / aspect) * (eye - target)
    return OrbitCamera(far, target.tolist(), camera.fov, floor_height(scene))


def half_width(width: int) -> int:
    """Return the width of one half of a split image [pixels]. Raises UsageError if it would be below 1."""
    if width <= SEAM + 1:
        raise UsageError(f"two images side by side need a width of at least {SEAM + 2} pixels, not {width}")
    return (width - SEAM) // 2


class SplitRenderer:
    """Renders two draw lists into one image: left half, seam, right half."""

    def __init__(self, width: int, height: int, samples: int) -> None:
        """`width`, `height` in pixels; `samples` per pixel, 1 or 4. Raises UsageError like `half_width`."""
        self._half = Rasterizer(half_width(width), height, samples)
        self._blank = np.full((height, width, 3), 255, np.uint8)

    @property
    def aspect(self) -> float:
        """Width / height of one half."""
        return self._half.width / self._half.height

    def draw(self, sides: tuple[DrawList, DrawList], view: str, camera: OrbitCamera) -> Pixels:
        """Return an image, uint8 (height, width, 3), in a new array. The color scale of both halves is below them."""
        a, b = sides
        a.other_error, b.other_error = b.largest_error, a.largest_error
        image = self._blank.copy()
        width = self._half.width
        for side, left in zip(sides, (0, image.shape[1] - width), strict=True):
            image[:, left : left + width] = render_without_scale(self._half, side, camera, view)
        scales = [scale for side in sides if (scale := side.scale(view))]
        if not scales:
            return image
        captions = dict.fromkeys(scale.caption for scale in scales)  # frames of their errors, which may differ
        return draw_legend_below(image, replace(scales[0], caption="   ".join(captions)))


# -- comparison --------------------------------------------------------------------------------------------------------


def rms_distance(a: Simulation, b: Simulation, partner: NDArray[np.int64]) -> float:
    """Return the root mean square distance between the particles of a and the particles `partner`, (N,), of b.

    It is relative to the longer side of the cloth.
    """
    offset = a.positions() - b.positions()[partner]
    return float(np.sqrt((offset**2).sum(axis=1).mean())) / a.topology.longest_side


def nearest_vertex_map(a: Simulation, b: Simulation) -> NDArray[np.int64]:
    """Return for every particle of a the particle of b that is nearest to it on the undeformed cloth, (N,).

    Grids of different resolution can be compared, and dragged together, to within half a cell.
    """
    flat = b.topology.flat
    found = [((flat - point) ** 2).sum(axis=1).argmin() for point in a.topology.flat]
    return np.array(found, np.int64)


# -- image sequence with report ----------------------------------------------------------------------------------------

REPORT = "compare.json"  # in the output folder


@dataclass(eq=False)
class Run:
    """Measurements of one side."""

    simulation: Simulation
    draw_list: DrawList
    measures: bool = True
    """Whether errors of frames are measured."""
    ms: list[float] = field(default_factory=list)
    """Physics time of each frame [ms]."""
    strain: list[float] = field(default_factory=list)
    """Largest strain after each frame."""
    positions: list[NDArray[np.float64]] = field(default_factory=list)
    """Positions [m] after each of the first frames, each (N, 3)."""
    frame_errors: list[FrameError] = field(default_factory=list)
    """Error of every `MEASURED_EVERY`th frame; empty if its reference would take too long."""

    def __post_init__(self) -> None:
        self._meter: FrameErrorMeter | None = None
        if self.measures:
            with suppress(UsageError):  # too many substeps
                self._meter = FrameErrorMeter(self.simulation.scene, self.simulation.requested_layout)

    def advance(self, kept: int) -> None:
        """Simulate and measure one frame. Positions are stored only for the first `kept` frames."""
        if self._meter and len(self.ms) % MEASURED_EVERY == MEASURED_EVERY - 1:
            found = self._meter.measure_frame(self.simulation, self._step)
            self.frame_errors.append(found)
            self.draw_list.show_error(found)
            if found.seconds > MAX_SECONDS:
                self.close()
        else:
            self._step()
        self.strain.append(self.simulation.metrics().max_strain)
        if len(self.positions) < kept:
            self.positions.append(self.simulation.positions())

    def _step(self) -> None:
        start = time.perf_counter()
        self.simulation.step()
        ti.sync()
        self.ms.append(1e3 * (time.perf_counter() - start))

    def close(self) -> None:
        """Release what measured the errors."""
        if self._meter is not None:
            self._meter.close()
        self._meter = None


def render_both(
    a: Simulation, b: Simulation, plan: RenderPlan, on_frame: Callable[[int], None], kept: int = 0, errors: bool = True
) -> tuple[Run, Run, list[float]]:
    """Run both scenes and write their images. Return both measurements and the RMS distance after each frame.

    The camera is that of a; one that the scene does not set moves back if cloth leaves the picture sideways. Both
    scenes are reset after a first frame, so that the times contain no compilation. The positions of the first `kept`
    frames are stored. `errors`: whether to measure errors of frames, of which the view `error` shows the last. Raises
    Diverged if a simulation diverges, and OSError if a file cannot be written; no PNG file is partial then.
    """
    distances: list[float] = []
    for simulation in (a, b):
        simulation.step()
        simulation.reset()
    draw_lists = DrawList(a), DrawList(b)
    runs = Run(a, draw_lists[0], errors), Run(b, draw_lists[1], errors)
    try:
        renderer = SplitRenderer(plan.width, plan.height, plan.samples)
        partner = nearest_vertex_map(a, b)
        camera = camera_for_both(a.scene, renderer.aspect)
        guards = DivergenceGuard(a), DivergenceGuard(b)
        with background_writer() as write:
            for k in range(plan.frames):
                if k % plan.every == 0:
                    if a.scene.camera == Camera():
                        camera.fit_width(np.concatenate([a.positions(), b.positions()]), renderer.aspect)
                    write(plan.path(k // plan.every), renderer.draw(draw_lists, plan.view, camera))
                for run, guard in zip(runs, guards, strict=True):
                    run.advance(kept)
                    if not guard.check_and_snapshot():
                        raise Diverged(f"{'ab'[runs.index(run)]}: {guard.roll_back()}")
                distances.append(rms_distance(a, b, partner))
                on_frame(k)
    finally:
        for draw_list in draw_lists:
            draw_list.close()
        for run in runs:
            run.close()
    return *runs, distances


def write_report(plan: RenderPlan, runs: tuple[Run, Run], distances: list[float], more: dict[str, object]) -> None:
    """Write `compare.json`: both scenes, the measurements of every frame, and `more`. Raises OSError."""
    sides = {
        name: {"scene": scene_to_toml(run.simulation.scene), "method": run.simulation.method}
        | {"physics_ms": np.round(run.ms, 3).tolist(), "max_strain": run.strain}
        | {"frame_errors": [{"frame": found.frame, **found.parts} for found in run.frame_errors]}
        for name, run in zip("ab", runs, strict=True)
    }
    with atomic_file(plan.out / REPORT) as file:
        file.write(json.dumps({"machine": machine(), **sides, "rms_distance": distances, **more}, indent=1).encode())
