"""Walks through a case without simulating it: what it opens, starts, sets and demands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import chain, repeat
from typing import Any

import numpy as np
import pytest

from taichi_cloth.scene import Scene
from taichi_cloth.scene.model import Solver
from taichi_cloth.stress import changes, friction, layers, loads, overlaps, rates, shots, sizes, springs, starts, trial
from taichi_cloth.stress.setting import Setting
from taichi_cloth.stress.trial import Trial, close
from taichi_cloth.stress.watch import Broken

CELLS = 8
SETTING = Setting("xpbd", Solver("xpbd", 2, 1))
ROWS = (changes, friction, layers, loads, overlaps, rates, shots, sizes, springs, starts)
STATIC = 0.02  # what stands for the static strain


def padded(values: Sequence[float], count: int) -> list[float]:
    """At least so many: the last one again and again."""
    return [*values, *[values[-1]] * (count - len(values))]


class Walk(Trial):
    """Frames do not advance; the watch sees the strains and speeds that it is handed, and the last of them for ever.

    Demands are collected, and hold: `broken` names those that did not.
    """

    def __init__(self, seed: int = 0, *, strains: Sequence[float] = (0.0,), speeds: Sequence[float] = (0.0,)) -> None:
        super().__init__(SETTING, seed)
        self.scenes: list[Scene] = []
        self.started: list[np.ndarray] = []
        self.pins: list[np.ndarray] = []
        self.sets: list[tuple[str, Any]] = []
        self.grabs: list[np.ndarray] = []
        self.far: list[float] = []
        self.rest: list[float | None] = []
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
        self.simulation.set = self._set  # type: ignore[method-assign]
        self.simulation.grab = self._grab  # type: ignore[method-assign]
        return x

    def _set(self, name: str, value: Any) -> None:
        type(self.simulation).set(self.simulation, name, value)
        self.sets.append((name, value))

    def _grab(self, index: int, target: np.ndarray) -> None:
        type(self.simulation).grab(self.simulation, index, target)
        self.grabs.append(np.array(target))

    def start(self, places: np.ndarray | None = None, *args: Any, **how: Any) -> None:
        super().start(places, *args, **how)
        self.started.append(self.simulation.positions())

    def change_scene(self, scene: Scene) -> None:
        super().change_scene(scene)
        self.scenes.append(scene)

    def one_frame(self, **how: Any) -> None:
        self.frames += 1
        self.times.append(0.0)
        self.simulation.frame += 1
        self.watch.strain, self.watch.speed = next(self._seen)

    def lead_pins(self, places: np.ndarray) -> None:
        super().lead_pins(places)
        self.pins.append(places)

    def settle(self, **how: Any) -> None:
        self.settled += 1
        self.rest_speeds.append(how.get("most_speed"))
        self.watch.strain, self.watch.speed = next(self._seen)
        self._unjudged = False

    def demand(self, what: str, value: float, bound: float) -> None:
        if not value <= bound:
            self.broken.append(what)


def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sheets of few cells, whose static strain is not computed."""
    few_cells(monkeypatch)
    for module in (trial, *ROWS):
        for name in ("static_strain", "taut_strain"):
            if hasattr(module, name):
                monkeypatch.setattr(module, name, lambda *scene: STATIC)


def few_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ROWS:
        if hasattr(module, "CELLS"):
            monkeypatch.setattr(module, "CELLS", CELLS)
    monkeypatch.setattr(friction, "TABLE_CELLS", 4)
    for cells in ("LAYER_CELLS", "MANY_CELLS"):
        monkeypatch.setattr(layers, cells, 2)


def walk(run: Callable[[Trial], object], seed: int = 0, **how: Any) -> Walk:
    found = Walk(seed, **how)
    try:
        run(found)
        found.check_judged()
    finally:
        close()
    return found


def breaks(run: Callable[[Trial], object], what: str) -> None:
    """With a real trial: this bound does not hold."""
    try:
        with pytest.raises(Broken, match=what):
            run(Trial(SETTING, 0))
    finally:
        close()
