"""The unit of work: one variant of a case with one setting, from all its starts. And what came of it."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from .case import Case, Variant
from .picture import draw
from .setting import Setting
from .trial import Figure, TooSlow, Trial, close
from .watch import Broken

ALIVE, FAILED, SLOW = "alive", "failed", "too slow"
PROCESS_ENDED = "times that its process ended"

Key = tuple[int, str, str]  # of a unit: number of the case, variant, setting


@dataclass(frozen=True)
class Unit:
    case: Case
    variant: Variant
    setting: Setting

    @property
    def key(self) -> Key:
        return self.case.number, self.variant.name, self.setting.name

    @property
    def name(self) -> str:
        return f"{self.case.number} {self.case.name}, {self.variant.name}, {self.setting.name}"

    def starts(self, count: int) -> list[tuple[int, int]]:
        """Number and seed of each."""
        return [(k, seed_of(self.case.number, self.variant.name, k)) for k in range(count)]


def seed_of(case: int, variant: str, start: int) -> int:
    """The same on every machine and for every setting."""
    return int.from_bytes(hashlib.blake2b(f"{case}/{variant}/{start}".encode(), digest_size=4).digest(), "big")


@dataclass(frozen=True)
class Failure:
    """Which bound broke, when, and by how much."""

    start: int
    seed: int
    frame: int
    what: str
    value: float
    bound: float


@dataclass(frozen=True)
class Result:
    """What came of a unit. Numbers are the worst of all starts that ran. The rest were skipped after a failure."""

    case: int
    name: str
    parameters: str
    about: str  # the note of the case
    variant: str
    setting: str
    starts: int  # that were asked for
    ran: int = 0
    failure: Failure | None = None
    slow_ms: float | None = None  # a frame, where that is over the limit
    frames: int = 0
    ms: float = 0.0  # median of a frame
    seconds: float = 0.0  # that the unit took
    energy: float = 0.0  # as in `watch.Worst`
    strain: float = 0.0
    speed: float = 0.0
    penetration: float = 0.0
    figures: list[Figure] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    picture: str = ""
    origin: str = ""  # fingerprint of what it was made with
    date: str = ""
    machine: str = ""  # and on which

    @property
    def key(self) -> Key:
        return self.case, self.variant, self.setting

    @property
    def state(self) -> str:
        return FAILED if self.failure else ALIVE if self.slow_ms is None else SLOW


def result_of(unit: Unit, starts: int, **found: Any) -> Result:
    case = unit.case
    who = case.number, case.name, case.parameters, case.note, unit.variant.name, unit.setting.name
    return Result(*who, starts, **found)


def run_unit(unit: Unit, starts: Sequence[tuple[int, int]], pictures: Path | None) -> Result:
    """Each start, until one fails. A picture shows the frame in which it did."""
    began = time.perf_counter()
    trials: list[Trial] = []
    failure, slow, shown = None, None, ""
    try:
        for start, seed in starts:
            trial = Trial(unit.setting, seed)
            trials.append(trial)
            try:
                unit.variant.run(trial)
                trial.check_judged()
            except TooSlow as too_slow:
                slow = too_slow.ms
                break
            except Broken as broken:
                failure = Failure(start, seed, trial.frame, broken.what, float(broken.value), float(broken.bound))
                shown = picture_of(unit, trial, start, pictures)
                break
            except Exception as error:  # of the case or of the program: the others must go on
                line = f"{type(error).__name__}: {error}".splitlines()[0]
                failure = Failure(start, seed, trial.frame, line, 1, 0)
                break
    finally:
        close()
    worst = [trial.worst for trial in trials]
    times = [ms for trial in trials for ms in trial.times]
    return result_of(
        unit,
        len(starts),
        ran=len(trials),
        failure=failure,
        slow_ms=slow,
        frames=max(trial.frame for trial in trials),
        ms=median(times) if times else 0.0,
        seconds=time.perf_counter() - began,
        energy=max(one.energy for one in worst),
        strain=max(one.strain for one in worst),
        speed=max(one.speed for one in worst),
        penetration=max(one.penetration for one in worst),
        figures=worst_figures(trials),
        notes=list(dict.fromkeys(note for trial in trials for note in trial.notes)),
        picture=shown,
    )


def worst_figures(trials: Sequence[Trial]) -> list[Figure]:
    """The largest of each number that the case tells."""
    worst: dict[str, Figure] = {}
    for figure in (figure for trial in trials for figure in trial.figures):
        if figure.what not in worst or not figure.value <= worst[figure.what].value:  # NaN is the worst
            worst[figure.what] = figure
    return list(worst.values())


def picture_of(unit: Unit, trial: Trial, start: int, folder: Path | None) -> str:
    """Draws where it failed. Returns the path, if there is anything to see."""
    if folder is None or not hasattr(trial, "simulation"):
        return ""
    words = f"{unit.case.number:02d} {unit.case.name} {unit.variant.name} {unit.setting.name} {start}"
    path = folder / ("".join(c if c.isalnum() or c in "-.+" else "_" for c in words) + ".png")
    return str(path) if draw(trial, path) else ""
