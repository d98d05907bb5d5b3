"""Everybody who looks at the scene: what a page says is done to the session, as the window would do it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from ..interact.camera import OrbitCamera
from ..kernels.controls import MOST_HANDS
from ..scene.live import live_keys
from ..scene.model import PRESET_NAMES, SOLVER_NAMES
from ..view.puller import under
from ..view.session import SLOW, Session
from .words import Look, Malformed, Said

Tell = Callable[[int, dict[str, Any]], None]  # tells one visitor something


class Visitors:
    """All pages that are open, by number, and whose hand is whose."""

    def __init__(self, session: Session, scenes: list[str], tell: Tell) -> None:
        """`scenes` are those that a page may open."""
        self.session = session
        self.scenes = scenes
        self._tell = tell
        self._hands: dict[int, int] = {}  # visitor → number of the hand

    def left(self, visitor: int) -> None:
        """One has gone, or is silent: the hand lets go."""
        if visitor in self._hands:
            self.session.hand(self._hands.pop(visitor)).let_go()

    def do(self, visitor: int, said: Said) -> None:
        """Does what one of them asks for. Raises Malformed for what this scene does not have."""
        session, value = self.session, said.value
        if session.waits and (said.what in ("choose", "switch") or (said.what == "do" and value in SLOW)):
            return  # one at a time: pages stand still for it, and what is asked next may be of another scene
        match said.what:
            case "do":
                session.ask(value)
            case "set":
                self._set(*value)
            case "switch":
                self._switch(value)
            case "choose":
                self._choose(*value)
            case "press":
                self._press(visitor, value)
            case "move" if visitor in self._hands:
                session.hand(self._hands[visitor]).follow(self._camera(value), value.cursor, value.size)
            case "lift":
                self.left(visitor)
            case "pin":
                held = session.simulation.grabbed_by(self._hands.get(visitor, -1))
                camera = self._camera(value)
                session.pin(held if held is not None else under(session.simulation, camera, value.cursor, value.size))

    def _set(self, name: str, value: float) -> None:
        """A slider, within its ends."""
        session = self.session
        if name == "hand":
            session.radius = min(max(value, 0.0), session.largest_radius)
            return
        key = live_keys(session.simulation.scene).get(name)
        if key is None:
            raise Malformed(f"{name!r} is not a live parameter of {session.simulation.scene.name}")
        within = min(max(value, key.low), key.high)
        session.simulation.set(name, round(within) if key.is_int else within)

    def _switch(self, stages: dict[str, bool]) -> None:
        have = self.session.stages
        if stages.keys() - have.keys():
            raise Malformed(f"{', '.join(stages)}: the scene has {', '.join(have) or 'no'} stages to switch")
        self.session.ask_to_switch(have | stages)

    def _choose(self, what: str, name: str) -> None:
        session = self.session
        names = {"scene": self.scenes, "solver": SOLVER_NAMES, "fabric": ("", *PRESET_NAMES)}[what]
        if name not in names:
            raise Malformed(f"{name!r} is no {what}: {', '.join(names)}")
        do = {"scene": session.open_scene, "solver": session.change_solver, "fabric": session.change_fabric}[what]
        session.wait(name or "the scene's own fabric", partial(do, name))

    def _press(self, visitor: int, look: Look) -> None:
        """Takes the cloth there with a hand that is free."""
        self.left(visitor)
        free = set(range(MOST_HANDS)) - {*self._hands.values()}
        if not free:
            self._tell(visitor, {"kind": "told", "took": False, "note": f"all {MOST_HANDS} hands hold something"})
            return
        number = min(free)
        took = self.session.hand(number).take(self._camera(look), look.cursor, look.size, self.session.radius)
        if took:
            self._hands[visitor] = number
        self._tell(visitor, {"kind": "told", "took": took})

    def _camera(self, look: Look) -> OrbitCamera:
        return look.through(OrbitCamera.from_scene(self.session.simulation.scene.camera))
