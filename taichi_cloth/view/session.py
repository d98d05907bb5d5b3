"""What the window shows, and what keys, mouse and panel do to it. No toolkit here: it runs without a display."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..errors import WrongUse
from ..export.clip import snapshot
from ..guard import Guard
from ..interact.camera import OrbitCamera
from ..interact.pointer import Mouse, Pointer
from ..measure.cloth import Measures
from ..record.recorded import Recorded
from ..scene import Scene, SceneError, live_keys, load_scene, scene_names
from ..scene.leave_out import may_do_without, scene_without
from ..scene.model import PRESET_NAMES, SOLVER_NAMES
from .curves import History
from .draw_list import VIEWS, DrawList
from .keepsakes import Keepsakes
from .puller import Puller, under
from .stage_times import StageTimes, stage_times

ZOOM_RATE = 8.0  # [steps/s] while a key is held
PAN_RATE = 0.5  # [heights of the picture/s]
HOLD = {
    "zoom_in": (ZOOM_RATE, 0.0, 0.0),
    "zoom_out": (-ZOOM_RATE, 0.0, 0.0),
    "pan_left": (0.0, -PAN_RATE, 0.0),
    "pan_right": (0.0, PAN_RATE, 0.0),
    "pan_down": (0.0, 0.0, -PAN_RATE),
    "pan_up": (0.0, 0.0, PAN_RATE),
}  # held action → rates of zoom, pan right, pan up


# What runs other kernels, which are compiled first where they never ran before.
SLOW = {
    "solver": "next solver",
    "fabric": "next fabric",
    "stage": "other stages",
    "time_stages": "times of the stages",
    "next_scene": "next scene",
    "previous_scene": "previous scene",
}
PAGES = ("Sliders", "Stages", "Numbers", "Keys")
FABRICS = ("", *PRESET_NAMES)
USUAL_HAND, LARGEST_HAND = 0.02, 0.25  # radius in sides of the cloth
HAND_STEP = 1.25


def words(name: str) -> str:
    """A section's name as the user reads it."""
    return name.replace("_", "-")


class Session:
    """One running scene with its camera and the user's hand. `act` takes the actions named in `keys.KEYS`."""

    def __init__(self, scene: Scene, path: str | None = None, out: Path = Path("out")) -> None:
        """`path` is that of `Simulation`; screenshots and clips go into a folder of the scene's name in `out`."""
        self.running = True
        self.frozen = False
        self.hidden = False
        self.view = VIEWS[0]
        self.page = PAGES[0]
        self.curves = False
        self.physics_ms = 0.0  # [ms] of one frame, mean over the last picture's frames
        self.measuring_ms = 0.0  # [ms] of the last measurement
        self.note = ""  # one line for the user
        self.size = (1280, 720)  # [pixels] of the last picture
        self.pointer = Pointer()
        self._asked: list[Callable[[], None]] = []
        self.keepsakes = Keepsakes(out)
        self._first = scene
        self._path = path
        self._out = out.absolute()  # the window works in another folder
        self._open(scene)

    def _open(self, scene: Scene) -> None:
        self.simulation = Recorded(scene, self._path)
        self._whole = scene  # with all its stages
        self.fabric = ""  # a shipped one, or the scene's own
        self.history = History()
        self.stage_times: StageTimes | None = None
        self._cursor: tuple[tuple[float, float], tuple[int, int]] | None = None
        try:
            self.draw_list = DrawList(self.simulation)
        except BaseException:
            self.simulation.close()
            raise
        self.camera = OrbitCamera.from_scene(scene.camera)
        self.puller = Puller(self.simulation)
        self.pullers = {0: self.puller}  # hands by number; the first is that of the window's mouse
        self.note = ""
        self._guard = Guard(self.simulation)
        self.radius = self.usual_radius
        self.measure()

    def _renew(self) -> None:
        """What is drawn and watched follows a simulation that was opened anew."""
        self.stage_times = None
        self.draw_list.close()
        self.draw_list = DrawList(self.simulation)
        self._guard = Guard(self.simulation)

    def _change(self, change: Callable[[], None]) -> None:
        """A change that opens the simulation anew; the note tells why where it cannot be."""
        self.note = ""
        try:
            change()
        except (WrongUse, SceneError) as error:
            self.note = str(error)
        self._renew()

    def finish(self) -> str:
        """Ends a clip, and waits until it is drawn. Returns a line where there was one."""
        line = self.keepsakes.end_clip(self.simulation, self.size)
        return self.keepsakes.wait() or line

    def close(self) -> None:
        """Gives back what the scene holds. Clips that are not drawn yet never will be: see `finish`."""
        self.keepsakes.close()
        self._close_scene()

    def _close_scene(self) -> None:
        self.draw_list.close()
        self.simulation.close()

    # -- keys and buttons ----------------------------------------------------------------------------------

    def obeys(self, action: str) -> bool:
        """Whether the user may do it now."""
        return True

    def ask(self, action: str) -> None:
        """`act`, at once or, where the picture will stand still for it, when the note that says so is on the screen."""
        if action in SLOW and self.obeys(action):
            self.wait(SLOW[action], partial(self.act, action))
        else:
            self.act(action)

    def ask_to_switch(self, stages: dict[str, bool]) -> None:
        """`switch`, likewise."""
        if self.obeys("stage"):
            self.wait(SLOW["stage"], partial(self.switch, stages))

    def wait(self, what: str, do: Callable[[], None]) -> None:
        """Does it when a picture has told `what` the user waits for."""
        self.note = f"{what}: compiling; the first time the picture stands still for some seconds"
        self._asked.append(do)

    @property
    def waits(self) -> bool:
        """Whether anything waits for a picture to be shown."""
        return bool(self._asked)

    def do_asked(self) -> bool:
        """What waited for a picture to be shown; whether anything did."""
        asked, self._asked = self._asked, []
        for do in asked:
            self.note = ""
            do()
        return bool(asked)

    def act(self, action: str) -> None:
        """Does what a key or button stands for."""
        if not self.obeys(action):
            return
        match action:
            case "freeze":
                self.frozen = not self.frozen
                self.note = ""
            case "step":
                self.frozen = True
                self._simulate(1)
            case "reset":
                self._let_all_go()
                self._change(self.simulation.reset)
            case "wind":
                self.simulation.set("wind", not self.simulation.get("wind"))
            case "view":
                self.view = VIEWS[(VIEWS.index(self.view) + 1) % len(VIEWS)]
            case "solver":
                self._next_solver()
            case "fabric":
                self.change_fabric(FABRICS[(FABRICS.index(self.fabric) + 1) % len(FABRICS)])
            case "stage":
                self._next_stage_off()
            case "time_stages":
                self._time_stages()
            case "pin":
                self._pin()
            case "smaller_hand":
                self.radius = self.radius / HAND_STEP if self.radius > self.usual_radius / 2 else 0.0
            case "larger_hand":
                self.radius = min(max(self.radius * HAND_STEP, self.usual_radius / 2), self.largest_radius)
            case "own_values":
                self.radius = self.usual_radius
                for key in live_keys(self.simulation.scene).values():
                    self.simulation.set(key.name, key.value)
            case "curves":
                self.curves = not self.curves
            case "page":
                self.page = PAGES[(PAGES.index(self.page) + 1) % len(PAGES)]
            case "previous_scene":
                self._turn_to(-1)
            case "next_scene":
                self._turn_to(1)
            case "export":
                self.note = snapshot(self.simulation, self._out)
            case "first_view":
                self.camera.reset()
            case "screenshot":
                self._look()
                self.note = self.keepsakes.screenshot(
                    self.simulation, self.draw_list, self.camera, self.view, self.size
                )
            case "clip":
                if self.keepsakes.clip_is_on:
                    self._end_clip()
                else:
                    self._record_anew()
                    self.note = self.keepsakes.begin_clip()
            case "hide":
                self.hidden = not self.hidden
            case "quit":
                self.running = False
            case _:
                raise ValueError(f"no such action: {action!r}")

    def hold(self, action: str, seconds: float) -> None:
        """Goes on with the action of a key that is held down, for so much wall time."""
        zoom, right, up = HOLD[action]
        self.camera.zoom(zoom * seconds)
        self.camera.pan(right * seconds, up * seconds)

    def _turn_to(self, step: int) -> None:
        """The shipped scene before or after this one; the scene the session began with is one of the round."""
        names = list(scene_names())
        if self._first.name not in names:
            names.append(self._first.name)
        name = names[(names.index(self.simulation.scene.name) + step) % len(names)]
        self.open_scene(name)

    def open_scene(self, name: str) -> None:
        """Closes the scene and opens a shipped one, or that which the session began with."""
        scene = self._first if name == self._first.name else load_scene(name)
        self._let_all_go()
        self._end_clip()
        note = self.note
        self._close_scene()
        self._open(scene)
        self.note = note

    def _record_anew(self) -> None:
        self.simulation.begin_anew()
        self._guard = Guard(self.simulation)  # what is repeated from here on knows no earlier good frame

    def _end_clip(self) -> None:
        self.note = self.keepsakes.end_clip(self.simulation, self.size)

    def _look(self) -> None:
        """Adds to what is recorded how the user looks at it."""
        camera, take = self.camera, self.simulation.take
        take.look("view", self.view)
        take.look("camera", camera.azimuth, camera.elevation, camera.distance, *camera.target.tolist())

    def change_fabric(self, name: str) -> None:
        """`Simulation.change_fabric`; the note tells why where it cannot be."""
        self.fabric = name
        self._change(lambda: self.simulation.change_fabric(name))

    def change_solver(self, name: str) -> None:
        """`Simulation.change_solver`, likewise; the hands keep what they hold."""
        self._change(lambda: self.simulation.change_solver(name))

    def _next_solver(self) -> None:
        """Goes on with the next method that the scene can have; the hand keeps what it holds."""
        next_one = SOLVER_NAMES.index(self.simulation.solver.name) + 1
        self.note = ""
        for name in SOLVER_NAMES[next_one:] + SOLVER_NAMES[: next_one - 1]:
            try:
                self.simulation.change_solver(name)
                break
            except WrongUse as error:
                self.note = str(error)
        self._renew()

    # -- stages ----------------------------------------------------------------------------------------

    @property
    def stages(self) -> dict[str, bool]:
        """Stages that the scene names and can do without, and whether each is on. The wind has a switch of its own."""
        return {
            name: bool(getattr(self.simulation.scene, name)) for name in may_do_without(self._whole) if name != "wind"
        }

    def switch(self, stages: dict[str, bool]) -> None:
        """Switches stages on and off. What never ran together is compiled first, which takes seconds."""
        off = scene_without(self._whole, [name for name, on in stages.items() if not on])
        sections: dict[str, Any] = {name: getattr(off, name) for name in stages}
        self._change(lambda: self.simulation.change(replace(self.simulation.scene, **sections)))

    def _next_stage_off(self) -> None:
        """The first stage off, then the next one instead, and after the last all are on."""
        names = list(self.stages)
        off = [k for k, name in enumerate(names) if not self.stages[name]]
        next_one = off[-1] + 1 if off else 0
        self.switch({name: k != next_one for k, name in enumerate(names)})
        if not self.note and next_one < len(names):
            self.note = f"without {words(names[next_one])}"

    def _time_stages(self) -> None:
        try:
            self.stage_times = stage_times(self.simulation, self._path)
        except WrongUse as error:
            self.note = str(error)

    # -- the mouse -------------------------------------------------------------------------------------

    def point(
        self,
        cursor: tuple[float, float],
        held: frozenset[str],
        size: tuple[int, int],
        *,
        on_panel: bool,
        widget_changed: bool,
    ) -> None:
        """Takes one displayed frame's mouse: its screen point in a window of `size` pixels, the buttons held."""
        self.size = size
        mouse = Mouse(cursor[0] * size[0] / size[1], cursor[1], held)
        self._cursor = None if on_panel else (cursor, size)
        gesture = self.pointer.update(mouse, on_panel=on_panel, widget_changed=widget_changed)
        self.camera.orbit(*gesture.orbit)
        self.camera.zoom(gesture.zoom)
        if gesture.press:
            self._grab(cursor, size)
        if gesture.release:
            self._let_go()
        self.puller.follow(self.camera, cursor, size)

    @property
    def usual_radius(self) -> float:
        """A hand [m] that takes one particle of a coarse cloth and a patch of a fine one."""
        return USUAL_HAND * self.simulation.topology.side

    @property
    def largest_radius(self) -> float:
        """[m] That of the slider."""
        return LARGEST_HAND * self.simulation.topology.side

    def _grab(self, cursor: tuple[float, float], size: tuple[int, int]) -> None:
        if not self.puller.take(self.camera, cursor, size, self.radius):
            self.pointer.miss()

    def _pin(self) -> None:
        """Pins what is held, or what is under the cursor; a pin is let go."""
        index = self.simulation.grabbed
        if index is None and self._cursor is not None:
            index = under(self.simulation, self.camera, *self._cursor)
        self.pin(index)

    def pin(self, index: int | None) -> None:
        """Pins a particle, or lets a pin go."""
        if index is None:
            self.note = "no cloth under the cursor to pin"
            return
        self._change(lambda: self.simulation.pin(index, on=not self.simulation.topology.pinned[index]))

    def follow(self, other: Session, partner: NDArray[np.int64]) -> None:
        """Holds what another session holds, by the same hand: here it is the `partner` of each particle there, (N,)."""
        self.puller.join(other.puller, partner, other.radius)

    def hand(self, number: int) -> Puller:
        """One of the hands; it is empty where it was never asked for since the scene opened."""
        return self.pullers.setdefault(number, Puller(self.simulation, number))

    def _let_go(self) -> None:
        self.puller.let_go()
        self.pointer.miss()

    def _let_all_go(self) -> None:
        for puller in self.pullers.values():
            puller.let_go()
        self.pointer.miss()

    # -- time ------------------------------------------------------------------------------------------

    def advance(self, frames: int) -> None:
        """Moves the cloth on by so many frames, unless it is frozen. Called once for each picture."""
        self.note = self.keepsakes.news() or self.note
        if not self.frozen:
            self._simulate(frames)

    def _simulate(self, frames: int) -> None:
        if frames == 0:
            return
        self._look()
        start = time.perf_counter()
        for k in range(frames):
            for puller in self.pullers.values():
                puller.lead((k + 1) / frames)
            self.simulation.advance_frame()
            if not self._guard.sound():
                self._restore()
                self._let_all_go()
                self.frozen = True
                break
        ti.sync()
        self.physics_ms = 1e3 * (time.perf_counter() - start) / frames
        for puller in self.pullers.values():
            puller.arrive()
        if self.simulation.take.is_long and not self.keepsakes.clip_is_on:
            self._record_anew()

    def _restore(self) -> None:
        self.note = self._guard.restore()
        self.simulation.take.add("restore")

    def measure(self) -> Measures:
        """Measures the cloth, for the figures and the curves."""
        start = time.perf_counter()
        self.measures = self.simulation.measure()
        self.measuring_ms = 1e3 * (time.perf_counter() - start)
        self.history.add(self.simulation.seconds, self.measures)
        return self.measures
