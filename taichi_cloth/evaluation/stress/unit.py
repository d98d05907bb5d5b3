"""A stress case: what it does to the cloth, in one or more variants. Each variant runs from several random starts.

    def yank(trial: Trial, distance: float) -> None:
        trial.open(sheet(CELLS, pins=("top",)), far=distance)
        trial.start()
        ...  # set_pins, move_pins, change, one_frame, run
        trial.settle()

    Case(29, "yank", "a grabbed particle, and back", variants(yank, {"1 m": 1.0, "10 m": 10.0}))

- A case that opens a scene must call `settle()` or `skip_rest_check(reason)` for it: a cloth that is not checked at
  rest without a reason is an error of the case. All bounds are finite: `record(what, value, bound)` records a value and
  checks it, `record(what, value)` only records it.
- `trial.random` is the only source of random numbers, so the seed of a start reproduces the start.
- Variants are sent to worker processes: they must be functions of a module, and their values must be picklable.

A unit of work is one variant of a case with one setting and all its starts.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any, TypeAlias, TypeVar

import numpy as np

from ...render.image import render_image
from .invariants import Violation
from .setup import Setting
from .trial import Measurement, TooSlow, Trial, UntimedTrial, add_worst, close

Value = TypeVar("Value")
Starts: TypeAlias = Sequence[tuple[int, int]]  # number and seed of each start


@dataclass(frozen=True)
class Variant:
    """One set of parameters of a case."""

    name: str
    """Printed, and part of the key of its results."""
    run: Callable[[Trial], None]


@dataclass(frozen=True)
class Case:
    """A numbered and named case with its variants."""

    number: int
    name: str
    parameters: str
    """One line: what the variants vary, and what the case requires besides being alive."""
    variants: tuple[Variant, ...]
    note: str = ""
    """Where the case differs from its specification, and why."""


def variants(run: Callable[[Trial, Value], None], values: Mapping[str, Value]) -> tuple[Variant, ...]:
    """Return one variant per value, by name. The value becomes the second argument of `run`."""
    return tuple(Variant(name, partial(_with_value, run, value)) for name, value in values.items())


def _with_value(run: Callable[[Trial, Value], None], value: Value, trial: Trial) -> None:
    run(trial, value)


WIDTH, HEIGHT = 640, 480


def draw(trial: Trial, path: Path) -> bool:
    """Write an image of the current strain of the cloth.

    Returns False, without writing, if a position is not finite or the cloth has no structural springs.
    """
    simulation = trial.simulation
    if not np.isfinite(simulation.positions()).all() or not len(simulation.topology.family("structural")):
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    render_image(simulation, (WIDTH, HEIGHT), "strain").save(path)
    return True


ALIVE, FAILED, SLOW = "alive", "failed", "too slow"
PROCESS_ENDED = "times that its process ended"

Key = tuple[int, str, str]  # of a unit: case number, variant, setting


@dataclass(frozen=True)
class Unit:
    """One variant of a case with one setting."""

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
        """Return the number and the seed of each start."""
        return [(k, seed_of(self.case.number, self.variant.name, k)) for k in range(count)]


def seed_of(case: int, variant: str, start: int) -> int:
    """Return the seed of a start, which is equal on every machine and for every setting."""
    return int.from_bytes(hashlib.blake2b(f"{case}/{variant}/{start}".encode(), digest_size=4).digest(), "big")


@dataclass(frozen=True)
class Failure:
    """The first violated bound of a start: `what`, the value and the bound, and the frame."""

    start: int
    seed: int
    frame: int
    what: str
    value: float
    bound: float


@dataclass(frozen=True)
class Result:
    """The result of a unit. Numbers are the worst of all starts that ran; starts after a failure are skipped."""

    case: int
    name: str
    parameters: str
    about: str
    """The note of the case."""
    variant: str
    setting: str
    starts: int
    """Number of starts requested."""
    ran: int = 0
    """Number of starts that ran."""
    failure: Failure | None = None
    slow_ms: float | None = None
    """Time of a frame [ms], if it is over the limit."""
    frames: int = 0
    ms: float = 0.0
    """Median time of a frame [ms]."""
    seconds: float = 0.0
    """CPU time of the unit [s]."""
    opening: float = 0.0
    """CPU time that compiled its kernels and found its static strain, where that was measured apart [s]."""
    energy: float = 0.0
    """Largest excess energy; this and the next three as in `invariants.Extremes`."""
    strain: float = 0.0
    speed: float = 0.0
    penetration: float = 0.0
    figures: list[Measurement] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    picture: str = ""
    digest: str = ""
    """Digest of the last start that ran, see `digest_of`."""
    origin: str = ""
    """Fingerprint of the program that produced or repeated it (`store.py`)."""
    repeated: str = ""
    """When this version of the program repeated the last start bit by bit; empty if it ran all starts itself."""
    date: str = ""
    machine: str = ""

    @property
    def key(self) -> Key:
        return self.case, self.variant, self.setting

    @property
    def state(self) -> str:
        """Failed, alive, or too slow."""
        return FAILED if self.failure else ALIVE if self.slow_ms is None else SLOW


def result_of(unit: Unit, starts: int, **found: Any) -> Result:
    """Return a result with the names of a unit; `found` has its other fields."""
    case = unit.case
    names = case.number, case.name, case.parameters, case.note, unit.variant.name, unit.setting.name
    return Result(*names, starts, **found)


def run_unit(unit: Unit, starts: Starts, pictures: Path | None, kind: Callable[..., Trial] = Trial) -> Result:
    """Run the starts (number and seed) of a unit, trials of this kind, until one fails or is too slow.

    An image of the frame that failed is written to the folder `pictures`, if there is one.
    """
    began = time.process_time()
    trials: list[Trial] = []
    failure, slow, image, digest = None, None, "", ""
    try:
        for start, seed in starts:
            trial = kind(unit.setting, seed)
            trials.append(trial)
            try:
                unit.variant.run(trial)
                trial.finish()
            except TooSlow as too_slow:
                slow = too_slow.ms
                break
            except Violation as broken:
                failure = Failure(start, seed, trial.frame, broken.what, float(broken.value), float(broken.bound))
                image = picture_of(unit, trial, start, pictures)
                break
            except Exception as error:  # an error of the case or the program: other units must continue
                line = f"{type(error).__name__}: {error}".splitlines()[0]
                failure = Failure(start, seed, trial.frame, line, 1, 0)
                break
        digest = digest_of(trials[-1], failure)
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
        seconds=time.process_time() - began,
        energy=max(one.energy for one in worst),
        strain=max(one.strain for one in worst),
        speed=max(one.speed for one in worst),
        penetration=max(one.penetration for one in worst),
        figures=worst_figures(trials),
        notes=list(dict.fromkeys(note for trial in trials for note in trial.notes)),
        picture=image,
        digest=digest,
    )


def repeat_starts(unit: Unit, starts: Starts, pictures: Path | None) -> Result:
    """Run starts of a unit without a limit on the time of a frame, after two frames of the first.

    The two frames compile the kernels and find the static strain, which later starts do not repeat: `seconds` is the
    time of later starts, and `opening` that of the two frames.
    """
    prepared = run_unit(unit, starts[:1], None, partial(UntimedTrial, seconds=0.0))
    return replace(run_unit(unit, starts, pictures, UntimedTrial), opening=prepared.seconds)


def digest_of(trial: Trial, failure: Failure | None) -> str:
    """Return a digest of all that a start computed, to the bit: the cloth at its end, and every value that was judged.

    12 hex digits. A version of the program that gives the same digest ran the same computation. Times do not count.
    """
    words = repr((trial.frame, trial.worst, trial.figures, trial.notes, failure))
    found = hashlib.sha256(words.encode())
    if hasattr(trial, "simulation") and not trial.simulation.closed:
        found.update(trial.simulation.positions().tobytes() + trial.simulation.velocities().tobytes())
    return found.hexdigest()[:12]


def worst_figures(trials: Sequence[Trial]) -> list[Measurement]:
    """Return the largest excess of each quantity that the trials recorded."""
    worst: list[Measurement] = []
    for figure in (figure for trial in trials for figure in trial.figures):
        add_worst(worst, figure)
    return worst


def picture_of(unit: Unit, trial: Trial, start: int, folder: Path | None) -> str:
    """Write an image of the frame that failed. Returns its path, or an empty string if there is nothing to draw."""
    if folder is None or not hasattr(trial, "simulation"):
        return ""
    name = f"{unit.case.number:02d} {unit.case.name} {unit.variant.name} {unit.setting.name} {start}"
    path = folder / ("".join(c if c.isalnum() or c in "-.+" else "_" for c in name) + ".png")
    return str(path) if draw(trial, path) else ""
