"""Runs the code of a case without simulating frames, and collects what it opens, starts, sets and checks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import chain, repeat
from typing import Any

import numpy as np
import pytest

from taichi_cloth.evaluation.stress import changes, contact, extremes, layered_cloth, loads, setup, trial
from taichi_cloth.evaluation.stress.invariants import Violation
from taichi_cloth.evaluation.stress.setup import Setting
from taichi_cloth.evaluation.stress.trial import Trial, close
from taichi_cloth.scene import Scene
from taichi_cloth.scene.schema import Solver
from taichi_cloth.simulation.events import Event

CELLS = 8
SETTING = Setting("xpbd", Solver("xpbd", 2, 1))
CASE_MODULES = (changes, contact, extremes, layered_cloth, loads, setup)
STATIC = 0.02  # replaces the static strain


def padded(values: Sequence[float], count: int) -> list[float]:
    """Return at least `count` values, by repeating the last one."""
    return [*values, *[values[-1]] * (count - len(values))]


class Walk(Trial):
    """A trial whose frames do not advance. The monitor has the given strains and speeds in turn, then the last of them.

    Violated bounds do not end it: `broken` collects their names.
    """

    def __init__(
        self,
        seed: int = 0,
        *,
        setting: Setting = SETTING,
        strains: Sequence[float] = (0.0,),
        speeds: Sequence[float] = (0.0,),
    ) -> None:
        super().__init__(setting, seed)
        self.scenes: list[Scene] = []
        self.started: list[np.ndarray] = []
        self.pins: list[np.ndarray] = []
        self.sets: list[tuple[str, Any]] = []
        self.grabs: list[np.ndarray] = []
        self.limits: list[float] = []
        self.far: list[float] = []
        self.rest: list[float | None] = []
        self.rest_scenes: list[Scene | None] = []
        self.rest_speeds: list[float | None] = []
        self.settled = self.frames = 0
        self.broken: list[str] = []
        last = (strains[-1], speeds[-1])
        self._seen = chain(zip(padded(strains, len(speeds)), padded(speeds, len(strains)), strict=True), repeat(last))

    def open(self, scene: Scene, **how: Any) -> np.ndarray:
        x = super().open(scene, **how)
        self.scenes.append(scene)
        self.far.append(how.get("far", 0.0))
        self.rest.append(how.get("rest_strain"))
        self.rest_scenes.append(how.get("rest"))
        self.simulation.listeners[:] = [self._on_event]
        return x

    def _on_event(self, event: Event) -> None:
        if event.name == "set_param":
            name, value = event.arguments
            self.sets.append((name, value))
        elif event.name == "move_grab":
            _, *target = event.arguments
            self.grabs.append(np.array(target))

    def start(self, positions: np.ndarray | None = None, *args: Any, **how: Any) -> None:
        super().start(positions, *args, **how)
        self.started.append(self.simulation.positions())

    def frame_limit_ms(self, ms: float, reason: str) -> None:
        super().frame_limit_ms(ms, reason)
        self.limits.append(ms)

    def change_scene(self, scene: Scene) -> None:
        super().change_scene(scene)
        self.scenes.append(scene)

    def one_frame(self, **how: Any) -> None:
        self.frames += 1
        self.times.append(0.0)
        self.simulation.set_frame(self.simulation.frame + 1)
        self.watch.strain, self.watch.speed = next(self._seen)

    def set_pins(self, positions: np.ndarray) -> None:
        super().set_pins(positions)
        self.pins.append(positions)

    def settle(self, **how: Any) -> None:
        self.settled += 1
        self.rest_speeds.append(how.get("max_speed"))
        self.watch.strain, self.watch.speed = next(self._seen)
        self._needs_rest_check = False
        if (after_frame := how.get("after_frame")) is not None:
            after_frame()

    def check(self, what: str, value: float, bound: float) -> None:
        if not value <= bound:
            self.broken.append(what)


def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use sheets of few cells, and do not compute their static strain."""
    few_cells(monkeypatch)
    for module in (trial, *CASE_MODULES):
        for name in ("static_strain", "taut_strain"):
            if hasattr(module, name):
                monkeypatch.setattr(module, name, lambda *scene: STATIC)


def few_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in CASE_MODULES:
        if hasattr(module, "CELLS"):
            monkeypatch.setattr(module, "CELLS", CELLS)


def walk(run: Callable[[Trial], object], seed: int = 0, **how: Any) -> Walk:
    found = Walk(seed, **how)
    try:
        run(found)
        found.require_rest_check()
    finally:
        close()
    return found


def breaks(run: Callable[[Trial], object], what: str) -> None:
    """Run a real trial, which must violate this bound."""
    try:
        with pytest.raises(Violation, match=what):
            run(Trial(SETTING, 0))
    finally:
        close()
