"""A session: a running scene with camera, grabs, recording and the actions of keys and mouse. It needs no display."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import taichi as ti

from ..geometry.scene_loader import load_scene
from ..geometry.topology import ClothMetrics
from ..render.camera import NEAR, OrbitCamera
from ..render.draw_list import VIEWS, DrawList, marked_pins
from ..scene import Scene, SceneError, scene_names
from ..scene.overrides import removable_sections, scene_without
from ..simulation.copies import FeatureTimes, FrameError
from ..simulation.events import Event
from ..simulation.recording import Recorder
from ..simulation.rollback import DivergenceGuard, RewindBuffer
from ..simulation.simulation import Simulation
from ..system.errors import UsageError
from . import toolkit
from .capture import Capture, Exporter
from .charts import History
from .dragging import Cursor, Dragger, Size, grab_radii, nearest_eye
from .error_process import ErrorProcess
from .input import ACTIONS, COMPILING_ACTIONS, NEIGHBORS, OWN_FABRIC, PAGES, Deferred, change_to, chosen, hold, neighbor
from .toolkit import Mouse, Pointer, Progress, Refusal


class Session:
    """One running scene with its camera and grabs. `act` runs the actions that `input.SHORTCUTS` names."""

    def __init__(
        self,
        scene: Scene,
        layout: str | None = None,
        out: Path = Path("out"),
        export: Exporter | None = None,
        save: Exporter | None = None,
    ) -> None:
        """`layout`: as for `Simulation`. Screenshots and clips are written to `out`, in a folder named after the scene.
        `export` writes the mesh of a simulation to a new file in that folder, and returns its path; `save` its scene.

        Raises SceneError and UsageError as `Simulation` does.
        """
        self.running = True  # until the user quits
        self.frozen = self.hidden = self.charts = False  # `hidden`: the panel; `charts`: whether they are shown
        self.view = VIEWS[0]
        self.speed = "1"  # simulated time per wall time, by its name in `SPEEDS`
        self.page = PAGES[0]  # of the panel
        self.physics_ms = 0.0  # of one frame, mean over those of the last displayed frame; 0 before the first
        self.measuring_ms = 0.0  # of the last measurement
        self.note = ""  # one line for the user: of success, a `Progress`, or a `Refusal`
        self.size = (1280, 720)  # of the last image [pixels]
        self.pointer = Pointer()
        self.meter: ErrorProcess | None = None  # if errors of frames are measured
        self.deferred = Deferred()  # until the next frame was displayed
        self.capture = Capture(out)
        self.initial_scene, self.layout, self.export, self.save = scene, layout, export, save
        self._open(scene)

    @property
    def caption(self) -> list[str]:
        """Lines over the picture, where the panel is not shown."""
        return [self.note] if self.hidden and self.note else []

    def _open(self, scene: Scene) -> None:
        self.simulation = Simulation(scene, self.layout)
        self.simulation.listeners.append(self._on_event)
        self.recorder = Recorder(self.simulation)
        self._full_scene = scene  # with all its features
        self.fabric = ""  # name of the fabric that was chosen; empty for the scene's own
        self.history = History(self.simulation.topology)
        self.rewind_buffer = RewindBuffer(self.simulation)
        self.forget_measurements()
        if self.meter is not None:
            self.meter.before_change = None
            self.meter.by_solver.clear()
        self.cursor: tuple[Cursor, Size] | None = None  # None over the panel
        try:
            self.draw_list = DrawList(self.simulation)
        except BaseException:
            self.simulation.close()
            raise
        self.camera = OrbitCamera.from_scene(scene)
        self.dragger = Dragger(self.simulation)  # of the window's mouse
        self.draggers = {0: self.dragger}  # of all cursors, by number
        self._guard = DivergenceGuard(self.simulation)
        self.default_grab_radius, self.max_grab_radius = grab_radii(self.simulation)  # [m]
        self.grab_radius = self.default_grab_radius  # [m]
        self.measure()

    def refresh(self) -> None:
        """Update the draw list and the divergence guard after the simulation was rebuilt."""
        self.forget_measurements()
        self.draw_list.close()
        self.draw_list = DrawList(self.simulation)
        self._guard = DivergenceGuard(self.simulation)

    def _on_event(self, event: Event) -> None:
        """Forget the error of a frame that ran with another setting."""
        if event.name == "set_param" and self.meter is not None:
            self.meter.forget()

    def forget_measurements(self) -> None:
        """Forget times and errors of frames, which are not those of the cloth that runs now."""
        self.feature_times: FeatureTimes | None = None
        self.physics_ms, self._compiles = 0.0, True  # the next frame compiles, so it is not timed
        if self.meter is not None:
            self.meter.forget()

    def rebuild(self, change: Callable[[], None]) -> None:
        """Make a change that rebuilds the simulation. On failure the note says why."""
        self.note = ""
        try:
            change()
        except (UsageError, SceneError) as error:
            self.note = Refusal(error)
        self.refresh()

    def finish(self) -> str:
        """End the clip, if there is one, and wait until all clips are rendered. Return a line for the user, or ""."""
        line = self.capture.end_clip(self.recorder, self.size)
        return self.capture.wait() or line

    def close(self) -> None:
        """Release all resources. Clips that are still being rendered are dropped; `finish` waits for them."""
        self.capture.close()
        self.measure_errors(False)
        self.draw_list.close()
        self.simulation.close()

    # -- keys and buttons ----------------------------------------------------------------------------------------------

    def is_allowed(self, action: str) -> bool:
        """Return whether an action is allowed now."""
        return True

    def request(self, action: str) -> None:
        """Run an action. If it may compile for seconds, first display a frame whose note says so (`run_deferred`)."""
        if action in NEIGHBORS and self.is_allowed(action):
            kind, step = NEIGHBORS[action]
            name = neighbor(self, kind, self.deferred.wished.get(kind, chosen(self, kind)), step)
            self.choose(kind, name, step)
            self.deferred.wished[kind] = name
        elif action in COMPILING_ACTIONS and self.is_allowed(action):
            self.defer(action, COMPILING_ACTIONS[action], partial(self.act, action))
        else:
            self.act(action)

    def request_features(self, features: dict[str, bool]) -> None:
        """Switch features on and off, as `switch` does, after displaying a frame whose note says that it compiles."""
        if self.is_allowed("feature"):
            self.defer("feature", COMPILING_ACTIONS["feature"], partial(self.set_features, features))

    def defer(self, kind: str, what: str, do: Callable[[], None]) -> None:
        """Defer `do` until a frame was displayed whose note says `what` compiles. `kind` as for `Deferred`."""
        if self.deferred.add(kind, do):
            self.note = Progress(f"{what}: compiling; the first time, the display pauses for some seconds")

    def run_deferred(self) -> bool:
        """Run the deferred actions. Call it after a frame was displayed. Return whether there were any."""
        deferred = self.deferred.take()
        for do in deferred:
            self.note = ""
            do()
        return bool(deferred)

    def act(self, action: str) -> None:
        """Run the action of a key or button, if it is allowed now. Raises ValueError for an unknown action."""
        if action not in ACTIONS:
            raise ValueError(f"unknown action {action!r}")
        if self.is_allowed(action):
            ACTIONS[action](self)

    def on_key_held(self, action: str, seconds: float) -> None:
        """Continue the action of a key that is held down, for that much wall time [s]."""
        hold(self, action, seconds)

    def choose(self, kind: str, name: str, step: int = 0) -> None:
        """Change to a name of a list, after displaying a frame whose note names it. `step` as for `input.change_to`."""
        if not self.is_allowed(kind):
            return
        if kind == "view":
            self.view = name
        else:
            self.defer(kind, name or OWN_FABRIC, partial(change_to, self, kind, name, step))

    @property
    def scenes(self) -> tuple[str, ...]:
        """Names of the shipped scenes and of the initial one."""
        return tuple(dict.fromkeys([*scene_names(), self.initial_scene.name]))

    def open_scene(self, name: str) -> None:
        """Replace the scene by a shipped one, or the session's initial one, by name. On failure the note says why."""
        before = self.simulation.scene
        try:
            scene = self.initial_scene if name == self.initial_scene.name else load_scene(name)
            self.release_all()
            self.end_clip()
            self.draw_list.close()
            self.simulation.close()
            self._open(scene)
        except (UsageError, SceneError) as error:  # the requested layout does not support it, or a file has changed
            if self.simulation.closed:
                self._open(before)
            self.note = Refusal(error)

    def restart_recording(self) -> None:
        """Forget what was recorded. The recording begins with the present state."""
        self.recorder.restart()
        self._guard = DivergenceGuard(self.simulation)  # a replay cannot roll back to a frame before this one

    def end_clip(self) -> None:
        """End the clip, if there is one, and start rendering it. The note says where."""
        self.note = self.capture.end_clip(self.recorder, self.size)

    def record_view(self) -> None:
        """Record the current view and camera."""
        camera, recorder = self.camera, self.recorder
        recorder.record_view("view", self.view)
        recorder.record_view("camera", camera.azimuth, camera.elevation, camera.distance, *camera.target.tolist())

    def change_fabric(self, name: str) -> None:
        """Switch to a shipped fabric, or by the name "" to the scene's own. On failure the note says why."""
        self.rebuild(lambda: self.simulation.switch_fabric(name))
        self.fabric = self.fabric if self.note else name

    def change_solver(self, name: str) -> None:
        """Switch to another solver; grabs remain. On failure the note says why."""
        self.rebuild(lambda: self.simulation.switch_solver(name))

    # -- features ------------------------------------------------------------------------------------------------------

    @property
    def features(self) -> dict[str, bool]:
        """Optional features of the scene, and whether each is on. Wind is not among them: it has its own switch."""
        names = [name for name in removable_sections(self._full_scene) if name != "wind"]
        return {name: bool(getattr(self.simulation.scene, name)) for name in names}

    def set_features(self, features: dict[str, bool]) -> None:
        """Switch features on and off. A new combination is compiled first, which takes seconds."""
        reduced = scene_without(self._full_scene, [name for name, on in features.items() if not on])
        sections: dict[str, Any] = {name: getattr(reduced, name) for name in features}
        self.rebuild(lambda: self.simulation.switch_scene(replace(self.simulation.scene, **sections)))

    # -- mouse ---------------------------------------------------------------------------------------------------------

    def on_pointer(
        self, cursor: Cursor, buttons: frozenset[str], size: Size, *, on_panel: bool, widget_changed: bool
    ) -> None:
        """Process the mouse of one displayed frame.

        `cursor`: its screen point. `buttons`: those that are down. `size`: of the window [pixels]. `on_panel`: whether
        the cursor is inside the panel's rectangle. `widget_changed`: whether a widget of the panel has changed.
        """
        self.size, mouse = size, Mouse(cursor[0] * size[0] / size[1], cursor[1], buttons)
        self.cursor = None if on_panel else (cursor, size)
        gesture = self.pointer.update(mouse, on_panel=on_panel, widget_changed=widget_changed)
        self.camera.orbit(*gesture.orbit)
        self.zoom(gesture.zoom)
        if gesture.press and not self.begin_drag(self.dragger, self.camera, cursor, size):
            self.pointer.orbit_instead()
        if gesture.release:
            self.end_drag(self.dragger)
            self.pointer.ignore()
        self.dragger.follow(self.camera, cursor, size)

    def zoom(self, steps: float) -> None:
        """Move the eye closer by `steps`, but not through cloth, or farther away if negative."""
        self.camera.zoom(steps, nearest_eye(self.camera, self.simulation) if steps > 0 else NEAR)

    def begin_drag(self, dragger: Dragger, camera: OrbitCamera, cursor: Cursor, size: Size) -> bool:
        """Grab what is under a cursor, as `Dragger.begin` does. Return whether there is something."""
        if found := dragger.begin(camera, cursor, size, self.grab_radius):
            self.rewind_buffer.mark()
            self.note = Refusal(toolkit.FROZEN_DRAG) if self.frozen else self.note
        elif dragger.is_pinned_there:
            self.note = Refusal(toolkit.ONLY_PINS)
        return found

    def end_drag(self, dragger: Dragger) -> None:
        """Release what a cursor drags. The note says if that was a pin, which stays where it was moved."""
        if dragger.end():
            self.note = Refusal(toolkit.PIN_MOVED)

    def pin(self, index: int | None) -> None:
        """Pin a particle and those within the grab radius, or unpin them if it is pinned. None: the note says why."""
        if index is None:
            self.note = Refusal("nothing to pin: no cloth under the cursor")
            return
        self.rewind_buffer.mark()
        pinned = self.simulation.topology.pinned[index]
        self.rebuild(partial(self.simulation.unpin if pinned else self.simulation.pin, index, self.grab_radius))

    def dragger_of(self, number: int) -> Dragger:
        """Return the dragger of a cursor by number. It is created at its first use in a scene."""
        return self.draggers.setdefault(number, Dragger(self.simulation))

    def release_all(self) -> None:
        """Release all grabs."""
        for dragger in self.draggers.values():
            dragger.end()
        self.pointer.ignore()

    # -- time ----------------------------------------------------------------------------------------------------------

    def advance(self, frames: int) -> None:
        """Advance the cloth by a number of frames, unless it is frozen. Call it once for each displayed frame."""
        self.note = self.capture.status() or self.note
        if self.note in toolkit.DRAG_NOTES and not any(dragger.drag for dragger in self.draggers.values()):
            self.note = ""
        if not self.frozen:
            self.simulate(frames)
        if self.meter is not None:
            self.meter.receive()  # also while the cloth is frozen
        self.draw_list.show_error(self.frame_error)

    def simulate(self, frames: int) -> None:
        """Advance the cloth by a number of frames, also if it is frozen."""
        if frames == 0:
            return
        self.record_view()
        start = time.perf_counter()
        for k in range(frames):
            for dragger in self.draggers.values():
                dragger.interpolate((k + 1) / frames)
            self.meter.run_frame(self.simulation) if self.meter else self.simulation.step()
            if not self._guard.check_and_snapshot():
                self.note = Refusal(self._guard.roll_back())
                self.release_all()
                self.frozen = True
                break
            self.rewind_buffer.add()
        ti.sync()
        self.physics_ms = 0.0 if self._compiles else 1e3 * (time.perf_counter() - start) / frames
        self._compiles = False
        for dragger in self.draggers.values():
            dragger.arrive()
        if self.recorder.is_long and not self.capture.clip_is_on:
            self.restart_recording()

    @property
    def frame_error(self) -> FrameError | None:
        """The last error of a frame that was measured."""
        return self.meter.error if self.meter else None

    def go_back(self, seconds: float) -> None:
        """Freeze, and restore the state nearest to `seconds` [s] before the newest one."""
        if seconds != self.rewind_buffer.back and self.is_allowed("rewind"):
            self._restore(lambda: self.rewind_buffer.go_back(seconds), ("", ""))

    def undo(self) -> None:
        """Restore the state before the last pull or change of pins. The note says if there is none."""
        self._restore(self.rewind_buffer.undo, toolkit.UNDONE)

    def _restore(self, restore: Callable[[], bool], notes: tuple[str, str]) -> None:
        if self.capture.clip_is_on:
            self.note = Refusal("cannot go back in time while recording a clip: press C to stop it")
            return
        self.release_all()
        pins, sliders = self.simulation.topology.pinned, dict(self.simulation.params)
        if not restore():
            self.note = Refusal(toolkit.NOTHING_TO_UNDO)
            return
        self.frozen, self.note = True, notes[dict(self.simulation.params) != sliders]
        marked = marked_pins(self.simulation)
        if (self.simulation.topology.pinned != pins).any() or not np.array_equal(marked, self.draw_list.pins):
            self.refresh()
        self.forget_measurements()
        self.restart_recording()

    def measure_errors(self, on: bool) -> None:
        """Start or stop measuring the error of frames."""
        if self.meter is not None:
            self.meter.close()
        self.meter = ErrorProcess() if on else None

    def measure(self) -> ClothMetrics:
        """Update the metrics of the cloth, and add them to the charts. Return them."""
        start = time.perf_counter()
        self.metrics = self.simulation.metrics()
        self.measuring_ms = 1e3 * (time.perf_counter() - start)
        if self.metrics.max_strain > toolkit.TOO_FAR and len(self.simulation.grabbed):
            self.note = Refusal(toolkit.PULLED_TOO_FAR)
        self.history.add(self.simulation.seconds, self.metrics, self.physics_ms)
        return self.metrics
