"""The simulation of a server: it does what pages say, goes on, and tells them, thirty times a second at most."""

from __future__ import annotations

import time
from collections.abc import Callable
from queue import Empty

from ..scene import scene_names
from ..scene.model import FRAME_SECONDS
from ..view.clock import FrameClock
from ..view.session import Session
from .hub import Hub
from .telling import Telling, packed
from .visitors import Visitors
from .words import Malformed

SEND_EVERY = 1 / 30  # [s]
FIGURES_EVERY = 0.1  # [s] as often as curves need it to be smooth
MEASURING = 20  # times as long as a measurement took lies between two
IDLE = 0.05  # [s] between two looks whether somebody has come


class Serving:
    """One session, and everybody who looks at it."""

    def __init__(self, session: Session, hub: Hub) -> None:
        self.session, self.hub = session, hub
        names = list(scene_names())
        self._scenes = names if session.simulation.scene.name in names else [*names, session.simulation.scene.name]
        self._visitors = Visitors(session, self._scenes, lambda who, told: hub.tell(who, packed(told)))
        self._telling = Telling(session, 0)
        self._published: dict[str, bytes] = {}
        self._sent_at = self._told_at = -1.0
        self._sent = 0  # moments since the last figures
        self._sending_ms = 0.0

    def run(self, clock: Callable[[], float] = time.perf_counter) -> None:
        """Goes on for ever."""
        frames = FrameClock(clock())
        self._publish("scene", self._telling.scene())
        while True:
            self.turn(clock(), frames.due(clock()))
            if not self.hub.visitors:
                self._wait()
                frames = FrameClock(clock())
            time.sleep(max(FRAME_SECONDS - (clock() - self._turned), 0.0))

    def turn(self, now: float, due: int) -> None:
        """What pages said, `due` frames, and what pages are told at `now` [s]."""
        self._turned = now
        self.hub.turned_at = time.monotonic()
        self.hear()
        self.session.advance(due)
        self.tell(now)
        if self.session.do_asked():
            self._published.pop("panel", None)  # what could not be had is not chosen

    def hear(self) -> None:
        """Does all that pages said of this scene; a hand that opened while it changed lets go all the same."""
        while True:
            try:
                visitor, said = self.hub.inbox.get_nowait()
            except Empty:
                return
            if said is None:
                self._visitors.left(visitor)
            elif said.what == "lift" or (said.of == self._telling.number and self._telling.holds):
                try:
                    self._visitors.do(visitor, said)
                except Malformed as wrong:
                    self._visitors.left(visitor)
                    self.hub.turn_out(visitor, str(wrong))

    def tell(self, now: float) -> None:
        """What is new, if it is time."""
        start = time.perf_counter()
        another = not self._telling.holds
        if another:
            self._telling = Telling(self.session, self._telling.number + 1)
            self._published.clear()
            self._publish("scene", self._telling.scene())
        if now - self._sent_at >= SEND_EVERY * 0.9:  # a turn of 1/60 s may come a little early
            self._sent_at = now
            if self._publish("moment", self._telling.moment()):
                self._sending_ms = 1e3 * (time.perf_counter() - start)
                self._sent += 1
        if another or now - self._told_at >= max(FIGURES_EVERY, MEASURING * self.session.measuring_ms / 1e3):
            rate = self._sent / (now - self._told_at)
            self._told_at, self._sent = now, 0
            self.session.measure()
            if "panel" not in self._published:
                self._publish("panel", self._telling.panel(self._scenes))
            self._publish("figures", self._telling.figures(self._sending_ms, rate, self.hub.visitors))

    def _publish(self, kind: str, data: bytes) -> bool:
        """Sends what differs from the last of its kind; whether it did."""
        if self._published.get(kind) == data:
            return False
        self._published[kind] = data
        self.hub.publish(kind, data)
        return True

    def _wait(self) -> None:
        """Nobody looks: the cloth stands still until somebody comes."""
        while not self.hub.visitors:
            self.hub.turned_at = time.monotonic()
            time.sleep(IDLE)
