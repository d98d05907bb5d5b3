"""Pictures without a screen: a scene as numbered PNG files and one `run.json` that says how they were made."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BlewUp, OutputInUse, why
from ..files import whole_file
from ..guard import Guard
from ..interact.camera import OrbitCamera
from ..lock import locked
from ..machine import machine
from ..scene import scene_to_toml
from ..simulation import Simulation
from .contact_sheet import contact_sheet
from .draw_list import DrawList
from .png import Pixels, write_png
from .portrait import portrait
from .raster import Raster

SHEET_PICTURES, SHEET_COLUMNS = 12, 4
LAST_GOOD = "last_good.npz"  # beside the pictures, where the cloth blew up


@dataclass(frozen=True)
class Plan:
    """Which pictures to make. Picture i shows the cloth after `i · every` frames of 1/60 s."""

    out: Path
    frames: int  # simulated frames
    width: int = 960
    height: int = 540
    view: str = "shaded"
    every: int = 1
    samples: int = 4  # per pixel, 1 or 4
    sheet: bool = False  # also one picture of twelve moments

    @property
    def pictures(self) -> int:
        return -(-self.frames // self.every)

    def path(self, picture: int) -> Path:
        return self.out / f"frame_{picture:05d}.png"

    def settings(self) -> dict[str, Any]:
        """What decides a picture's content; a resumed run must agree in it."""
        return {k: v for k, v in asdict(self).items() if k not in ("out", "frames", "sheet")}


@dataclass
class Report:
    """What `run.json` holds."""

    scene: str
    seed: int
    scene_text: str  # the whole scene as TOML: with the settings, all that decides a picture
    settings: dict[str, Any]
    machine: dict[str, str]
    frames: list[dict[str, Any]] = field(default_factory=list)  # one for each simulated frame, as `_line` writes it
    complete: bool = False

    def write(self, out: Path) -> None:
        with whole_file(out / "run.json") as file:
            file.write(json.dumps(asdict(self), indent=1).encode())


@contextmanager
def claimed(plan: Plan, simulation: Simulation, *, force: bool, resume: bool) -> Iterator[None]:
    """The folder made ready, and within the block this run's alone.

    Raises OutputInUse, and leaves the folder as it was, where another run renders into it, where it holds frames and
    neither flag allows for them, or where `resume` is asked for and the frames there were made from something else.
    """
    if plan.out.exists() and not plan.out.is_dir():
        raise OutputInUse(f"{plan.out} is a file, not a folder")
    plan.out.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        try:
            stack.enter_context(locked(plan.out))
        except BlockingIOError:
            raise OutputInUse(f"{plan.out} is in use: another run renders into it; choose another --out") from None
        _make_ready(plan, simulation, force=force, resume=resume)
        yield


def _make_ready(plan: Plan, simulation: Simulation, *, force: bool, resume: bool) -> None:
    there = plan.out / "run.json"
    old = [path for path in (*plan.out.glob("frame_*.png"), there) if path.exists()]
    if old and resume:
        made = _told(there)
        mine = {"scene_text": scene_to_toml(simulation.scene), "settings": plan.settings()}
        for key, value in mine.items():
            if made.get(key) != value:
                what = "another scene" if key == "scene_text" else f"other settings ({made.get(key)})"
                raise OutputInUse(
                    f"{plan.out} holds frames made from {what}: it cannot be resumed; use --force to start anew"
                )
    elif old:
        if not force:
            raise OutputInUse(f"{plan.out} holds frames already: use --force to replace them or --resume to go on")
        for path in (*old, plan.out / "contact_sheet.png", plan.out / LAST_GOOD):
            path.unlink(missing_ok=True)
    for left_behind in plan.out.glob(".*.part"):  # by a run that was killed outright
        left_behind.unlink()


def _told(path: Path) -> dict[str, Any]:
    """What an older `run.json` says. Raises OutputInUse where it is none."""
    try:
        made = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError, RecursionError):  # no JSON, or no text
        made = None
    if not isinstance(made, dict):
        raise OutputInUse(f"{path} is missing or damaged: the render cannot be resumed; use --force to start anew")
    return made


def render(simulation: Simulation, plan: Plan, on_frame: Callable[[int], None]) -> Report:
    """Runs the scene and writes its pictures; files that exist are kept and their frames only simulated.

    `on_frame(k)` is called after every simulated frame. Raises BlewUp when the cloth does, and OSError
    when a file cannot be written; `run.json` then tells how far the run came, and every PNG is whole.
    """
    scene = simulation.scene
    report = Report(scene.name, scene.seed, scene_to_toml(scene), plan.settings(), machine())
    camera = OrbitCamera.from_scene(scene.camera)
    raster = Raster(plan.width, plan.height, plan.samples)
    draw_list = DrawList(simulation)
    guard = Guard(simulation)
    in_sheet = set(np.linspace(0, plan.pictures - 1, SHEET_PICTURES).round().astype(int)) if plan.sheet else set()
    sheet: list[Pixels] = []
    report.write(plan.out)
    try:
        with writing_behind() as write:
            for k in range(plan.frames):
                picture, rest = divmod(k, plan.every)
                line = _line(simulation, k)
                if rest == 0 and (picture in in_sheet or not plan.path(picture).exists()):
                    start = time.perf_counter()
                    pixels = portrait(raster, draw_list, camera, plan.view)
                    line["draw_ms"] = round(1e3 * (time.perf_counter() - start), 3)
                    if picture in in_sheet:
                        sheet.append(pixels)
                    write(plan.path(picture), pixels)
                start = time.perf_counter()
                simulation.advance_frame()
                if not guard.sound():
                    raise BlewUp(saved_before(simulation, guard, plan))
                line["physics_ms"] = round(1e3 * (time.perf_counter() - start), 3)
                report.frames.append(line)
                on_frame(k)
        if sheet:
            factor = max(1, plan.width // 320)
            write_png(plan.out / "contact_sheet.png", contact_sheet(sheet, SHEET_COLUMNS, factor))
        report.complete = True
    except BaseException:
        with suppress(OSError):  # on a full disk the older one stays, which tells of fewer frames
            report.write(plan.out)
        raise
    finally:
        draw_list.close()
    report.write(plan.out)
    return report


def saved_before(simulation: Simulation, guard: Guard, plan: Plan) -> str:
    """Saves the last good frame of a cloth that blew up, and returns the line that tells of it."""
    line = guard.restore()
    path = plan.out / LAST_GOOD
    try:
        simulation.save(path)
    except OSError as error:
        return f"{line}; frame {simulation.frame}, the last good one, could not be saved: {why(error)}"
    return f"{line}; frame {simulation.frame}, the last good one, is saved in {path}"


def _line(simulation: Simulation, frame: int) -> dict[str, Any]:
    """What there is to say of a frame before it is drawn."""
    measures = simulation.measure()
    line = {"frame": frame, "max_strain": measures.max_strain, "mean_strain": measures.mean_strain}
    return line if measures.crossings is None else {**line, "crossings": measures.crossings}


@contextmanager
def writing_behind() -> Iterator[Callable[[Path, Pixels], None]]:
    """A function that writes a PNG while the next frame is computed; at most two pictures wait.

    At the end of the block every picture handed over is on the disk. An error of an earlier picture is
    raised by a later call, or at the end.
    """
    with ThreadPoolExecutor(1, "png") as executor:
        waiting: list[Future[None]] = []

        def write(path: Path, pixels: Pixels) -> None:
            if len(waiting) == 2:
                waiting.pop(0).result()
            waiting.append(executor.submit(write_png, path, pixels))

        yield write
        for future in waiting:
            future.result()
