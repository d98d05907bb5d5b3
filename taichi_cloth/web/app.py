"""The main loop of the web server, and the commands from pages.

The loop applies commands, advances the simulation, and publishes updates, at most 30 a second.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from queue import Empty

from ..kernels.step_params import MAX_GRABS
from ..render.camera import OrbitCamera
from ..scene import scene_names
from ..scene.parameters import parameters_of
from ..scene.schema import FRAME_SECONDS
from ..simulation.frame_clock import MAX_FRAMES, FrameClock
from ..viewer.dragging import pick_under_cursor
from ..viewer.input import COMPILING_ACTIONS, LISTS, NEIGHBORS, SPEEDS
from ..viewer.panel import GRAB_RADIUS
from ..viewer.session import Session
from .protocol import Command, MessageBuilder, PageView, ProtocolError, pack_message
from .server import WebServer

Reply = Callable[[int, dict[str, object]], None]  # sends a reply to one client, by number


def is_for_any_scene(command: Command) -> bool:
    """Return whether a command counts even if the page showed an earlier scene.

    No grab may outlive its drag, and of scenes chosen one after the other the last is shown.
    """
    return command.name == "release" or (command.name == "choose" and command.argument[0] == "scene")


class CommandHandler:
    """Applies the commands of all open pages (clients, by number), and assigns a grab to each page that drags."""

    def __init__(self, session: Session, scenes: list[str], reply: Reply) -> None:
        """`scenes`: names of the scenes that a page may open."""
        self.session = session
        self.scenes = scenes
        self._reply = reply
        self._grabs: dict[int, int] = {}  # client → number of its grab

    def release(self, client: int) -> None:
        """Release the grab of a client that disconnected or stopped dragging."""
        if client in self._grabs:
            self.session.end_drag(self.session.dragger_of(self._grabs.pop(client)))

    def apply(self, client: int, command: Command) -> None:
        """Apply a command. Raises ProtocolError for a name or feature that this scene does not have."""
        session, value = self.session, command.argument
        if (
            session.deferred
            and not is_for_any_scene(command)
            and (
                command.name in ("choose", "switch")
                or (command.name == "action" and value in {*COMPILING_ACTIONS, *NEIGHBORS})
            )
        ):
            return  # one compilation at a time: pages freeze during it, and a later command may be for another scene
        match command.name:
            case "action":
                session.request(value)
            case "set":
                self._set(*value)
            case "switch":
                self._switch(value)
            case "choose":
                self._choose(*value)
            case "press":
                self._press(client, value)
            case "move" if client in self._grabs:
                session.dragger_of(self._grabs[client]).follow(self._camera(value), value.cursor, value.size)
            case "release":
                self.release(client)
            case "pin":
                grabbed = session.dragger_of(self._grabs[client]).particle if client in self._grabs else None
                camera = self._camera(value)
                session.pin(
                    grabbed
                    if grabbed is not None
                    else pick_under_cursor(session.simulation, camera, value.cursor, value.size)
                )

    def _set(self, name: str, value: float) -> None:
        """Set a runtime parameter or the grab radius, clamped to the range of its slider."""
        session = self.session
        if name == GRAB_RADIUS:
            session.grab_radius = min(max(value, 0.0), session.max_grab_radius)
            return
        parameter = parameters_of(session.simulation.scene).get(name)
        if parameter is None:
            raise ProtocolError(f"{name!r} is not a runtime parameter of {session.simulation.scene.name}")
        clamped = min(max(value, parameter.slider_min), parameter.slider_max)
        session.simulation.params[name] = round(clamped) if parameter.is_int else clamped

    def _switch(self, features: dict[str, bool]) -> None:
        available = self.session.features
        if features.keys() - available.keys():
            raise ProtocolError(
                f"cannot switch {', '.join(features)}: the scene can switch {', '.join(available) or 'no features'}"
            )
        self.session.request_features(available | features)

    def _choose(self, kind: str, name: str) -> None:
        session = self.session
        names = self.scenes if kind == "scene" else LISTS[kind]
        if name not in names:
            raise ProtocolError(f"unknown {kind} {name!r}: {', '.join(names)}")
        if kind == "speed":
            session.speed = name
        else:
            session.choose(kind, name)

    def _press(self, client: int, view: PageView) -> None:
        """Begin a drag at the cursor with a free grab. Reply whether it grabbed the cloth."""
        self.release(client)
        free = set(range(MAX_GRABS)) - {*self._grabs.values()}
        if not free:
            self._reply(client, {"kind": "reply", "grabbed": False, "note": f"all {MAX_GRABS} grabs are in use"})
            return
        number = min(free)
        dragger = self.session.dragger_of(number)
        grabbed = self.session.begin_drag(dragger, self._camera(view), view.cursor, view.size)
        if grabbed:
            self._grabs[client] = number
        self._reply(client, {"kind": "reply", "grabbed": grabbed})

    def _camera(self, view: PageView) -> OrbitCamera:
        return view.apply_to(OrbitCamera.from_scene(self.session.simulation.scene))


SEND_EVERY = 1 / 30  # [s] between two updates
METRICS_EVERY = 0.1  # [s] between two measurements; enough for smooth charts
MEASURE_RATIO = 20  # shortest time between two measurements, in durations of the last one
IDLE_POLL = 0.05  # [s] between two checks for a page while none is open


class WebApp:
    """Runs one session for all open pages."""

    def __init__(self, session: Session, server: WebServer) -> None:
        self.session, self.server = session, server
        names = list(scene_names())
        self._scenes = names if session.simulation.scene.name in names else [*names, session.simulation.scene.name]
        self._commands = CommandHandler(
            session, self._scenes, lambda client, reply: server.send(client, pack_message(reply))
        )
        self._messages = MessageBuilder(session, 0)
        self._published: dict[str, bytes] = {}
        self._updated_at = self._measured_at = -1.0
        self._updates = 0  # since the last measurement
        self._sending_ms = 0.0

    def run(self, clock: Callable[[], float] = time.perf_counter) -> None:
        """Run the loop until an exception ends it. `clock` returns the wall time [s]."""
        frames = FrameClock(clock())
        self._publish("scene", self._messages.scene())
        while True:
            due = frames.due(clock(), SPEEDS[self.session.speed])
            self.step(clock(), min(due, self._most_frames()))
            if not self.server.clients:
                self._wait()
                frames = FrameClock(clock())
            time.sleep(max(FRAME_SECONDS - (clock() - self._step_start), 0.0))

    def step(self, now: float, due: int) -> None:
        """Run the loop once at `now` [s]: apply commands, simulate `due` frames, publish updates."""
        self._step_start = now
        self.server.stepped_at = time.monotonic()
        self.apply_commands()
        self.session.advance(due)
        self.publish_updates(now)
        if self.session.run_deferred():
            self._published.pop("panel", None)  # a choice that failed must be reset in every panel

    def _most_frames(self) -> int:
        """Return how many frames to simulate for an update: a slow scene gets more updates, not more frames in each."""
        return max(int(MAX_FRAMES * 1e3 * FRAME_SECONDS / max(self.session.physics_ms, 1e-9)), 1)

    def apply_commands(self) -> None:
        """Apply all commands for this scene, and those for any scene."""
        while True:
            try:
                client, command = self.server.inbox.get_nowait()
            except Empty:
                return
            if command is None:
                self._commands.release(client)
            elif is_for_any_scene(command) or (command.scene_id == self._messages.scene_id and self._messages.is_valid):
                try:
                    self._commands.apply(client, command)
                except ProtocolError as error:
                    self._commands.release(client)
                    self.server.disconnect(client, str(error))

    def publish_updates(self, now: float) -> None:
        """Publish what has changed, if it is due at `now` [s]."""
        start = time.perf_counter()
        is_new_scene = not self._messages.is_valid
        if is_new_scene:
            self._messages = MessageBuilder(self.session, self._messages.scene_id + 1)
            self._published.clear()
            self._publish("scene", self._messages.scene())
        if now - self._updated_at >= SEND_EVERY * 0.9:  # a loop of 1/60 s may be slightly early
            self._updated_at = now
            if self._publish("update", self._messages.update()):
                self._sending_ms = 1e3 * (time.perf_counter() - start)
                self._updates += 1
        if (
            is_new_scene
            or self.session.deferred
            or now - self._measured_at >= max(METRICS_EVERY, MEASURE_RATIO * self.session.measuring_ms / 1e3)
        ):
            rate = self._updates / (now - self._measured_at)
            self._measured_at, self._updates = now, 0
            self.session.measure()
            if "panel" not in self._published:
                self._publish("panel", self._messages.panel(self._scenes))
            self._publish("metrics", self._messages.metrics(self._sending_ms, rate, self.server.clients))
            self._publish("frameError", self._messages.frame_error())

    def _publish(self, kind: str, data: bytes) -> bool:
        """Publish a message unless it equals the last of its kind. Return whether it was published."""
        if self._published.get(kind) == data:
            return False
        self._published[kind] = data
        self.server.publish(kind, data)
        return True

    def _wait(self) -> None:
        """Pause the simulation until a page is open."""
        while not self.server.clients:
            self.server.stepped_at = time.monotonic()
            time.sleep(IDLE_POLL)
