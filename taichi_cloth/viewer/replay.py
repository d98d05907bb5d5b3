"""Replay of recordings, in a window or without one, and rendering a session without a window."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import taichi as ti

from ..render.draw_list import VIEWS
from ..render.image import RenderPlan, render_pixels
from ..render.image_files import AppendImage
from ..render.rasterizer import Rasterizer
from ..simulation.copies import FrameStart
from ..simulation.events import Event
from ..simulation.recording import REBUILDING, Recording, apply_recorded, hash_of
from ..simulation.rollback import RewindBuffer
from ..simulation.simulation import Simulation
from ..system.errors import UsageError, choose_from
from .capture import Exporter
from .error_process import ErrorProcess, Job, Measurer, error_lines
from .input import PAGES, SHORTCUTS
from .session import Session
from .toolkit import Refusal


class FrameByFrame(ErrorProcess):
    """Measures every frame that it runs, in this process: for images of the view `error`."""

    def __init__(self) -> None:
        super().__init__()
        self._measurer = Measurer()

    def run_frame(self, simulation: Simulation) -> None:
        """Run and measure one frame. After a refusal, frames of the same scene are not measured."""
        if simulation.scene is not self._scene:
            self._scene, self.answer = simulation.scene, None
        start = FrameStart.of(simulation)
        simulation.step()
        if not (self.answer and self.answer.refusal):
            self.answer = self._measurer.measure(Job.of(simulation, start))

    def close(self) -> None:
        """Release the copies."""
        self._measurer.close()


def session_images(session: Session, plan: RenderPlan, show: AppendImage, on_frame: Callable[[int], None]) -> int:
    """Render a session, and pass each image to `show`. Return the number of images.

    Image i shows the cloth after `i · every` frames, with the session's camera and view. `on_frame(k)` is called after
    every frame. Rendering ends early if the session freezes, because the cloth diverged. If errors cannot be measured
    for the view `error`, a line on stderr says why.
    """
    raster = Rasterizer(plan.width, plan.height, plan.samples)
    shown = 0
    with closing(FrameByFrame()) as errors:
        for k in range(plan.frames):
            is_shown = k % plan.every == 0
            if k > 0:
                session.meter = errors if is_shown and session.view == "error" else None
                session.advance(1)
            if is_shown:
                show(render_pixels(raster, session.draw_list, session.camera, session.view))
                shown += 1
            on_frame(k)
            if session.frozen:
                break
        session.meter = None
        if errors.answer and errors.answer.refusal:
            print(error_lines(errors)[0], file=sys.stderr)
    return shown


# Actions that do not change the cloth, and the one that replays again: they are allowed during replay.
VIEW_KEYS = {"freeze", "step", "reset", "view", "errors", "first_view", "screenshot", "quit"}
CAPTION_KEYS = {"freeze", "reset", "view", "quit"}  # of these, named over the picture


class ReplaySession(Session):
    """A session that replays a recording. After the recording's last frame the user controls it; a reset replays again.

    Its first image shows the start of the recording. Grabs that are active at the end of the recording are released.
    """

    def __init__(
        self,
        recording: Recording,
        out: Path = Path("out"),
        export: Exporter | None = None,
        save: Exporter | None = None,
    ) -> None:
        """Open the recording's scene, and apply the events before its first frame. `export`, `save`: as for `Session`.

        Raises UsageError if the scene does not support a recorded event. So do all methods that simulate.
        """
        self.recording = recording
        self.was_equal: bool | None = None
        """`is_equal` of the last replay that reached the end; R may have begun another."""
        super().__init__(recording.scene, recording.layout, out, export, save)
        try:
            self._begin()
        except BaseException:
            self.close()
            raise

    def _begin(self) -> None:
        """Apply the events before the first frame to the scene, which was just opened."""
        self.frames_replayed = 0
        """Number of frames replayed."""
        self.is_equal: bool | None = None
        """Whether the final positions equal the recorded ones; None before the end."""
        self._next_row = 0  # of the recording
        self.hidden, self.frozen, self.page = True, False, PAGES[0]
        self._apply_due()
        self.rewind_buffer = RewindBuffer(self.simulation)  # the recording may begin with another state than the scene

    @property
    def is_over(self) -> bool:
        """Whether the recording has ended."""
        return self.is_equal is not None

    @property
    def caption(self) -> list[str]:
        """What is replayed, and the keys that act; nothing once the panel is shown."""
        if self.is_over:
            return []
        state = "frozen" if self.frozen else "replaying"
        keys = " · ".join(f"{key.label} {key.help}" for key in SHORTCUTS if key.action in CAPTION_KEYS)
        return [f"{state}: frame {self.frames_replayed} of {self.recording.frames}", keys]

    # -- user input ----------------------------------------------------------------------------------------------------

    def is_allowed(self, action: str) -> bool:
        """Return whether an action is allowed now: during replay only those that do not change the cloth."""
        return self.is_over or action in VIEW_KEYS

    def act(self, action: str) -> None:
        """Run an action. A reset replays the recording again, after displaying a frame whose note says so."""
        if action == "reset":
            self.defer("scene", "replay", self._replay_again)
        else:
            super().act(action)

    def _replay_again(self) -> None:
        self.open_scene(self.recording.scene.name)
        self._begin()

    def on_pointer(
        self, cursor: tuple[float, float], buttons: frozenset[str], size: tuple[int, int], **more: bool
    ) -> None:
        """Process the mouse of one displayed frame. During replay the left button, which grabs, is ignored."""
        super().on_pointer(cursor, buttons if self.is_over else buttons - {"left"}, size, **more)

    # -- replay --------------------------------------------------------------------------------------------------------

    def simulate(self, frames: int) -> None:
        start = time.perf_counter()
        for k in range(frames):
            if self.is_over:
                super().simulate(frames - k)
                return
            self.replay_frame()
            self.frozen |= self.is_over
            if self.frozen:
                break
        if frames:
            ti.sync()
            self.physics_ms = 1e3 * (time.perf_counter() - start) / frames

    def replay_frame(self) -> None:
        """Replay one frame and the events after it. Raises UsageError if the scene does not support one of them."""
        self.meter.run_frame(self.simulation) if self.meter else self.simulation.step()
        if self._guard.check_and_snapshot():  # takes the snapshot for a recorded roll-back
            self.rewind_buffer.add()
        self.frames_replayed += 1
        self._apply_due()

    def _apply_due(self) -> None:
        rows = self.recording.rows
        while self._next_row < len(rows) and rows[self._next_row][0] == self.frames_replayed:
            event = rows[self._next_row][1]
            try:
                self._apply(event)
            except ValueError as error:
                raise UsageError(f"rows[{self._next_row}]: {event.name}: {error}") from None
            self._next_row += 1
        if self.frames_replayed == self.recording.frames:
            self.is_equal = self.was_equal = hash_of(self.simulation) == self.recording.positions_sha256
            for grab in self.simulation.grab_handles:  # none of them belongs to a dragger, which could release it
                grab.release()
            self.note, self.hidden = f"{self.verdict}; R replays again", False

    def _apply(self, event: Event) -> None:
        match event.name:
            case "roll_back":
                self.note = Refusal(self._guard.roll_back())
            case "view":
                self._set_view(*event.arguments)
            case "camera":
                self._set_camera(*event.arguments)
            case _:
                before = self.simulation.scene
                apply_recorded(self.simulation, event)
                if event.name == "switch_fabric" and self.simulation.scene is not before:
                    (self.fabric,) = event.arguments
        if event.name in REBUILDING:
            self.refresh()

    def _set_view(self, view: str) -> None:
        if view not in VIEWS:
            raise ValueError(f"unknown view {view!r}{choose_from(view, VIEWS)}")
        self.view = view

    def _set_camera(self, azimuth: float, elevation: float, distance: float, *target: float) -> None:
        if distance <= 0:
            raise ValueError(f"distance must be greater than 0 m, not {distance}")
        camera = self.camera
        camera.azimuth, camera.elevation, camera.distance = azimuth, elevation, distance
        camera.target = np.array(target)

    @property
    def verdict(self) -> str:
        """One line: whether the final positions of the last replay that reached them equal the recorded ones."""
        total = self.recording.frames
        if self.was_equal is None:
            return f"stopped after {self.frames_replayed} of {total} frames: final positions not compared"
        return f"{total} frames replayed: " + (
            "final positions are bit-identical" if self.was_equal else "final positions DIFFER from the recording"
        )
