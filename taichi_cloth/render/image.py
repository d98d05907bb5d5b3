"""Images of a running simulation, rendered without a display: one image, or numbered PNG files with a report.

Single images are for Python scripts and notebooks, sequences for `taichi-cloth render`; `run.json` reports the run.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from copy import copy
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from ..scene import Camera, scene_to_toml
from ..scene.reader import check_keys
from ..simulation.copies import FrameErrorMeter, FrameStart, median_parts
from ..simulation.parameter_values import check_frames, check_image_size
from ..simulation.rollback import DivergenceGuard, guarded_frames
from ..simulation.running_cloth import check_simulation
from ..simulation.simulation import Simulation
from ..system.errors import Diverged, OutputConflict, UsageError, choose_from, error_text
from ..system.files import atomic_file, folder_lock
from ..system.taichi_runtime import check_thread, machine, running_arch
from .camera import OrbitCamera, camera_of
from .colors import draw_legend
from .draw_list import VIEWS, DrawList
from .image_files import Pixels, background_writer, check_format, contact_sheet, encode_png, open_video, write_png
from .rasterizer import Rasterizer


def render_pixels(raster: Rasterizer, draw_list: DrawList, camera: OrbitCamera, view: str) -> Pixels:
    """Return an image of the current frame, uint8 (height, width, 3); with the color scale of the view if it has one.

    The target is in the center: `camera.view_shift`, which makes room for a panel, is ignored.
    """
    pixels = render_without_scale(raster, draw_list, camera, view)
    scale = draw_list.scale(view)
    return draw_legend(pixels, scale) if scale else pixels


def render_without_scale(raster: Rasterizer, draw_list: DrawList, camera: OrbitCamera, view: str) -> Pixels:
    """Return the same image without a color scale."""
    camera = copy(camera)
    camera.view_shift = 0.0
    mesh = draw_list.update(view, camera.eye)
    return raster.draw(mesh, camera.view_projection(raster.width / raster.height))


@dataclass(frozen=True, eq=False)
class Image:
    """An image. Notebooks display it."""

    pixels: Pixels
    """Red, green and blue, uint8 (height, width, 3), top row first."""

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a PNG file, and make a missing folder. Raises UsageError for a name not ending in .png, and OSError.

        A partial file never remains.
        """
        if Path(path).suffix.lower() != ".png":
            raise UsageError(f"{os.fspath(path)}: images are saved as PNG files: the name must end in .png")
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        write_png(path, self.pixels)

    def __repr__(self) -> str:
        height, width, _ = self.pixels.shape
        return f"<Image {width}×{height}>"

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.pixels, dtype, copy=copy)

    def _repr_png_(self) -> bytes:
        return encode_png(self.pixels)


def render_image(
    simulation: Simulation,
    size: tuple[int, int] = (640, 360),
    view: str = "shaded",
    *,
    eye: ArrayLike | None = None,
    target: ArrayLike | None = None,
    fov: float | None = None,
) -> Image:
    """Return an image of the current frame. `size`: width and height [pixels].

    `view`: "shaded", "strain", "error" (if it was measured), "wireframe" or "particles". `eye` and `target`: positions
    of the camera, and of what it looks at [m]; `fov`: its vertical angle of view [degrees]; without one, that of the
    scene's camera. If the scene has none, the camera frames the cloth and the colliders near it at their start, and
    moves back where the cloth would leave the picture. With an `eye` and a `target` it does not move.

    Needs neither a display nor a window. Raises ValueError for a size that is not two integers from 1 to 8192, an
    unknown view, and a camera that a scene does not allow: a position not of three numbers, an angle out of range, or
    one that looks straight up or down. Raises UsageError for the view "error" of a frame without a measured error.
    """
    with _camera_on(simulation, size, view, {"eye": eye, "target": target, "fov": fov}) as image:
        return Image(image())


def render_video(
    simulation: Simulation,
    path: str | os.PathLike[str],
    frames: SupportsIndex,
    size: tuple[int, int] = (640, 360),
    view: str = "shaded",
    *,
    every: SupportsIndex = 1,
    eye: ArrayLike | None = None,
    target: ArrayLike | None = None,
    fov: float | None = None,
    on_frame: Callable[[int], object] | None = None,
) -> None:
    """Run some frames, and write an image before every `every`-th of them to a video, an .mp4 or .webp file.

    The video plays in real time, with 60/`every` images per second. `size`, `view`, `eye`, `target` and `fov`: as in
    `render_image`, but the camera does not move. `on_frame(k)` is called after step k, 0 first, when the cloth is that
    of the frame k + 1. It may move grabs and change parameters, but not step, reset or change the scene (UsageError).
    An .mp4 file has even width and height, one pixel less than an odd one.

    An existing file is replaced, and a missing folder is made. Raises UsageError for another suffix, for the view
    "error", and with the command that installs it if ffmpeg is missing, or Pillow for .webp. Raises ValueError as
    `render_image` does and for numbers that are not integers from 1, Diverged if the cloth blows up, and OSError; a
    partial file never remains.
    """
    check_simulation(simulation)
    file, count, step = Path(path), check_frames(frames, "frames", 1), check_frames(every, "every", 1)
    if view == "error":
        raise UsageError(
            "the view 'error' measures each frame: use `taichi-cloth render SCENE --view error --video FILE`"
        )
    check_format(file)
    with _camera_on(simulation, size, view, {"eye": eye, "target": target, "fov": fov}) as image:
        file.parent.mkdir(parents=True, exist_ok=True)
        with open_video(file, check_image_size(size), step) as show:
            for k in guarded_frames(simulation, range(count), on_frame or (lambda _: None)):
                if k % step == 0:
                    show(image())


@contextmanager
def _camera_on(
    simulation: Simulation, size: tuple[int, int], view: str, keys: Mapping[str, Any]
) -> Iterator[Callable[[], Pixels]]:
    """Yield a function that returns an image of the cloth as it is then.

    `keys`: of the camera, or None. Arguments and errors: of `render_image`.
    """
    check_thread()
    check_simulation(simulation)
    if view not in VIEWS:
        raise ValueError(f"unknown view {view!r}{choose_from(view, VIEWS)}")
    size = check_image_size(size)
    scene = simulation.scene
    keys = {name: value for name, value in keys.items() if value is not None}
    seen = replace(scene, camera=replace(camera_of(scene), **keys))
    check_keys(seen)
    camera = OrbitCamera.from_scene(seen)
    if scene.camera == Camera() and not keys:
        camera.move_back(simulation.positions(), size[0] / size[1])
    error = getattr(simulation, "frame_error", None)  # of `tc.Simulation` only
    if view == "error" and error is None:
        reason = "call step(measure_error=True) before; simulation.warnings says if its reference has not converged"
        raise UsageError(f"the view 'error' needs the error of the last frame: {reason}")
    raster = Rasterizer(*size)
    draw_list = DrawList(simulation)
    draw_list.show_error(error, is_of_this_frame=True)
    try:
        yield lambda: render_pixels(raster, draw_list, camera, view)
    finally:
        draw_list.close()


# -- image sequences ---------------------------------------------------------------------------------------------------

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
    def median_error(self) -> dict[str, float | None]:
        """The medians of the error of frames and its parts [m] (`copies.median_parts`)."""
        return median_parts(entry["frame_error"] for entry in self.frames if "frame_error" in entry)

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


def render(
    simulation: Simulation, plan: RenderPlan, meter: FrameErrorMeter | None, on_frame: Callable[[int], None]
) -> RenderReport:
    """Run the scene, write its images, and return the report. `meter`: of the errors that the plan needs.

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
                    entry["frame_error"] = found.parts
                    draw_list.show_error(found, is_of_this_frame=plan.view == "error")
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
