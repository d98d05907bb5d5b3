"""A case: what is done to the cloth, in one or more variants. Each variant is run from several starts.

    def yank(trial: Trial, way: float) -> None:
        trial.open(sheet(CELLS, pins=("top",)), far=way)
        trial.start()
        ...  # lead_pins, move_pins, act, one_frame, run
        trial.settle()

    Case(29, "yank", "a grabbed particle, and back", variants(yank, {"1 m": 1.0, "10 m": 10.0}))

- Every cloth that is opened ends with `settle()`, or with `only_frames(reason)`: one that is not judged at rest is an
  error of its case. All bounds are finite: `tell(what, value, bound)` judges, `tell(what, value)` only prints.
- `trial.random` is all that may be random: the seed of a start repeats it.
- What a variant calls, and its value, go to other processes: functions of a module, and values that can be pickled.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from .trial import Trial

Value = TypeVar("Value")


@dataclass(frozen=True)
class Variant:
    """One set of parameters of a case. `name` is printed."""

    name: str
    run: Callable[[Trial], None]


@dataclass(frozen=True)
class Case:
    """`parameters` says in one line what is varied and what is demanded besides being alive."""

    number: int
    name: str
    parameters: str
    variants: tuple[Variant, ...]
    note: str = ""  # where it differs from the usual list, and why


def variants(run: Callable[[Trial, Value], None], values: Mapping[str, Value]) -> tuple[Variant, ...]:
    """One variant for each value, which is bound to the second argument of `run`."""
    return tuple(Variant(name, partial(_with_value, run, value)) for name, value in values.items())


def _with_value(run: Callable[[Trial, Value], None], value: Value, trial: Trial) -> None:
    run(trial, value)
