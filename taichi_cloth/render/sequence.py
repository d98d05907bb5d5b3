"""Image sequences, rendered without a display: a scene as numbered PNG files, and a report of the run, `run.json`."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from ..scene import scene_to_toml
from ..simulation.copies import FrameErrorMeter, FrameStart
from ..simulation.rollback import DivergenceGuard
from ..simulation.simulation import Simulation
from ..system.errors import Diverged, OutputConflict, error_text
from ..system.files import atomic_file, folder_lock
from ..system.taichi_runtime import machine, running_arch
from .camera import OrbitCamera
from .draw_list import DrawList
from .image import render_pixels
from .image_files import Pixels, contact_sheet, write_png
from .rasterizer import Rasterizer

SHEET_IMAGES, SHEET_COLUMNS = 12, 4
MEASURED_EVERY = 10  # frames for each whose error is measured
LAST_GOOD = "last_good.npz"  # checkpoint in the output folder, if the simulation diverged


@dataclass(frozen=True)
class RenderPlan:
    """Which images to render. Image i shows the cloth after i · `every` frames of 1/60 s."""

    out: Path
    """Output folder."""
    frames: int
    """Number of simulated frames."""
    width: int = 960
    height: int = 540
    view: str = "shaded"
    every: int = 1
    samples: int = 4
    """Samples per pixel, 1 or 4."""
    contact_sheet: bool = False
    """Also write a contact sheet of twelve images, evenly spaced in time."""
    errors: bool = False
    """Measure the error of every `MEASURED_EVERY`th frame, or of all images in the view `error`."""

    @property
    def image_count(self) -> int:
        """Number of images."""
        return -(-self.frames // self.every)

    @property
    def images(self) -> str:
        """How many images there are, where, and of which frames, in words."""
        from ..system.console import count_noun

        frames = f" (frames 0 to {(self.image_count - 1) * self.every}, every {self.every})" if self.every > 1 else ""
        return f"{count_noun(self.image_count, 'image')} in {self.out}{frames}"

    def path(self, image: int) -> Path:
        """Return the path of image number `image`."""
        return self.out / f"frame_{image:05d}.png"

    def is_measured(self, frame: int) -> bool:
        """Return whether the error of a frame is measured; frame k leads to the image of k + 1."""
        if self.view == "error":
            return (frame + 1) % self.every == 0
        return self.errors and (frame + 1) % MEASURED_EVERY == 0

    def settings(self, simulation: Simulation) -> dict[str, object]:
        """Return the settings that determine the images; a run can only be resumed with the same.

        Layouts and archs compute in another order, so their trajectories differ.
        """
        own = {k: v for k, v in asdict(self).items() if k not in ("out", "frames", "contact_sheet", "errors")}
        return own | {"layout": simulation.solver.layout_name, "arch": running_arch()}


@dataclass
class RenderReport:
    """The contents of `run.json`."""

    scene: str
    seed: int
    scene_text: str
    """The complete scene as TOML. Together with `settings` it determines the images."""
    settings: dict[str, object]
    machine: dict[str, str]
    frames: list[dict[str, Any]] = field(default_factory=list)
    """One entry per simulated frame: `_frame_entry`, `physics_ms`, `draw_ms` if an image was rendered, and
    `frame_error` [m] if it was measured (`FrameError.parts`)."""
    complete: bool = False

    @property
    def median_error(self) -> float | None:
        """The median error of the frames that were measured with a converged reference [m], or None."""
        found = [entry["frame_error"] for entry in self.frames if "frame_error" in entry]
        errors = [parts["error"] for parts in found if parts["reference_has_converged"]]
        return median(errors) if errors else None

    def write(self, out: Path) -> None:
        """Write `run.json` to the folder `out`. Raises OSError; a partial file never remains."""
        with atomic_file(out / "run.json") as file:
            file.write(json.dumps(asdict(self), indent=1).encode())


@contextmanager
def claim_folder(plan: RenderPlan, simulation: Simulation, *, force: bool, resume: bool | None) -> Iterator[None]:
    """Prepare the output folder, and lock it for this run within the block.

    `force` deletes the frames of an earlier run; `resume` keeps them, and is None for a run that cannot. Raises
    OutputConflict, and changes nothing in the folder, if another run renders into it, if it contains frames and neither
    flag is set, or if `resume` is set and the frames were rendered from another scene or with other settings.
    """
    if plan.out.exists() and not plan.out.is_dir():
        raise OutputConflict(f"{plan.out} is a file, not a folder")
    plan.out.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        try:
            stack.enter_context(folder_lock(plan.out))
        except BlockingIOError:
            raise OutputConflict(f"{plan.out} is in use by another render; choose another --out") from None
        _prepare_folder(plan, simulation, force=force, resume=resume)
        yield


def _prepare_folder(plan: RenderPlan, simulation: Simulation, *, force: bool, resume: bool | None) -> None:
    """Delete or check the frames of an earlier run, as `claim_folder` documents."""
    report_path = plan.out / "run.json"
    existing = [path for path in (*plan.out.glob("frame_*.png"), report_path) if path.exists()]
    if existing and resume:
        previous = _read_report(report_path)
        settings = plan.settings(simulation)
        current = {"scene_text": scene_to_toml(simulation.scene), "settings": settings}
        if isinstance(stored := previous.get("settings"), dict):  # without layout and arch by an earlier version
            previous["settings"] = {key: settings[key] for key in ("layout", "arch")} | stored
        for key, value in current.items():
            if previous.get(key) != value:
                source = "another scene" if key == "scene_text" else f"other settings ({previous.get(key)})"
                raise OutputConflict(
                    f"{plan.out} contains frames from {source} and cannot be resumed; use --force to start over"
                )
    elif existing:
        if not force:
            more = "" if resume is None else ", or --resume to continue"
            raise OutputConflict(f"{plan.out} already contains frames; use --force to replace them{more}")
        for path in (*existing, plan.out / "contact_sheet.png", plan.out / LAST_GOOD):
            path.unlink(missing_ok=True)
    for partial in plan.out.glob(".*.part"):  # of a run that was killed
        partial.unlink()


def _read_report(path: Path) -> dict[str, object]:
    """Return the contents of an existing `run.json`. Raises OutputConflict if it is missing or damaged."""
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError, RecursionError):  # not JSON, or not text
        report = None
    if not isinstance(report, dict):
        raise OutputConflict(f"{path} is missing or damaged: the render cannot be resumed; use --force to start over")
    return report


def render(simulation: Simulation, plan: RenderPlan, on_frame: Callable[[int], None]) -> RenderReport:
    """Run the scene, write its images, and return the report.

    Images that exist are kept: their frames are simulated but not rendered, except those of the contact sheet.
    `on_frame(k)` is called after every simulated frame. Raises Diverged if the simulation diverges, and OSError if a
    file cannot be written. `run.json` then lists the frames that were simulated, and no PNG file is partial.
    """
    scene = simulation.scene
    report = RenderReport(scene.name, scene.seed, scene_to_toml(scene), plan.settings(simulation), machine())
    camera = OrbitCamera.from_scene(scene)
    raster = Rasterizer(plan.width, plan.height, plan.samples)
    draw_list = DrawList(simulation)
    guard = DivergenceGuard(simulation)
    in_sheet = (
        set(np.linspace(0, plan.image_count - 1, SHEET_IMAGES).round().astype(int)) if plan.contact_sheet else set()
    )
    sheet_images: list[Pixels] = []
    measures = plan.errors or plan.view == "error"
    meter = FrameErrorMeter(scene, simulation.requested_layout) if measures else None
    report.write(plan.out)
    try:
        with background_writer() as write:
            for k in range(plan.frames):
                image, rest = divmod(k, plan.every)
                entry = _frame_entry(simulation, k)
                if rest == 0 and (image in in_sheet or not plan.path(image).exists()):
                    start = time.perf_counter()
                    pixels = render_pixels(raster, draw_list, camera, plan.view)
                    entry["draw_ms"] = round(1e3 * (time.perf_counter() - start), 3)
                    if image in in_sheet:
                        sheet_images.append(pixels)
                    write(plan.path(image), pixels)
                began_with = FrameStart.of(simulation) if meter and plan.is_measured(k) else None
                start = time.perf_counter()
                simulation.step()
                if not guard.check_and_snapshot():
                    raise Diverged(save_last_good(simulation, guard, plan))
                entry["physics_ms"] = round(1e3 * (time.perf_counter() - start), 3)
                if meter and began_with:
                    found = meter.measure(began_with, simulation.positions())
                    entry["frame_error"], draw_list.errors = found.parts, found.by_particle
                report.frames.append(entry)
                on_frame(k)
        if sheet_images:
            factor, columns = max(1, plan.width // 320), min(SHEET_COLUMNS, len(sheet_images))
            write_png(plan.out / "contact_sheet.png", contact_sheet(sheet_images, columns, factor))
        report.complete = True
    except BaseException:
        with suppress(OSError):  # if the disk is full, the older report with fewer frames remains
            report.write(plan.out)
        raise
    finally:
        draw_list.close()
        if meter:
            meter.close()
    report.write(plan.out)
    return report


def save_last_good(simulation: Simulation, guard: DivergenceGuard, plan: RenderPlan) -> str:
    """Roll a diverged simulation back to its last good frame, save it, and return a message of one line about it."""
    line = guard.roll_back()
    path = plan.out / LAST_GOOD
    try:
        simulation.save(path)
    except OSError as error:
        return f"{line}; the last good frame ({simulation.frame}) could not be saved: {error_text(error)}"
    return f"{line}; the last good frame ({simulation.frame}) is saved in {path}"


def _frame_entry(simulation: Simulation, frame: int) -> dict[str, Any]:
    """Return the metrics of a frame for `run.json`. `intersections` is there with self-collision only."""
    metrics = simulation.metrics()
    entry = {"frame": frame, "max_strain": metrics.max_strain, "mean_strain": metrics.mean_strain}
    return entry if metrics.intersections is None else {**entry, "intersections": metrics.intersections}


@contextmanager
def background_writer() -> Iterator[Callable[[Path, Pixels], None]]:
    """Provide a function that writes a PNG file in a second thread, while the next frame is computed.

    At most two images wait to be written; a further call blocks. At the end of the block all files have been written.
    An error of an earlier image is raised by a later call, or at the end of the block.
    """
    with ThreadPoolExecutor(1, "png") as executor:
        pending: list[Future[None]] = []

        def write(path: Path, pixels: Pixels) -> None:
            if len(pending) == 2:
                pending.pop(0).result()
            pending.append(executor.submit(write_png, path, pixels))

        yield write
        for future in pending:
            future.result()
