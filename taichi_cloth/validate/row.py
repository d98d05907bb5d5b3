"""One line of the report: a number that is known, the same number measured, and what the difference is worth."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import NamedTuple

EXCELLENT, PASS, SHORT = "excellent", "pass", "falls short"


@dataclass(frozen=True)
class Row:
    """A measured number beside the exact one. `error` is in the unit of the bounds `good` and `best`."""

    what: str  # set-up and quantity, with its unit: "free fall from rest, 1 s: drop [m]"
    exact: float
    measured: float
    error: float  # relative, or in the words of `what`
    good: float  # largest error that passes
    best: float  # largest that is excellent

    @property
    def verdict(self) -> str:
        if not isfinite(self.error) or self.error > self.good:
            return SHORT
        return EXCELLENT if self.error <= self.best else PASS


def relative(what: str, exact: float, measured: float, good: float, best: float) -> Row:
    """A row whose error is a share of the exact number."""
    return Row(what, exact, measured, abs(measured - exact) / abs(exact), good, best)


def at_most(what: str, measured: float, good: float, best: float) -> Row:
    """A row of something that should be 0."""
    return Row(what, 0.0, measured, abs(measured), good, best)


class Known(NamedTuple):
    """Why rows may fall short, and the largest error that this explains."""

    reason: str
    most: float


@dataclass(frozen=True)
class Reference:
    """A set-up with known answers. `run` measures it with a solver, and yields a row for each answer."""

    number: str  # in the list of references: "A1.1"
    name: str
    source: str
    run: Callable[[str], Iterator[Row]]
    solvers: tuple[str, ...]  # those that have what it asks for
    beyond: Mapping[str, Known] = field(default_factory=dict)  # by solver: of which rows no more is claimed than that


@dataclass(frozen=True)
class Result:
    """A row with where it belongs."""

    reference: Reference
    solver: str
    row: Row

    @property
    def verdict(self) -> str:
        return self.row.verdict

    @property
    def reason(self) -> str:
        """Why it falls short, where that is known and is enough."""
        known = self.reference.beyond.get(self.solver)
        return known.reason if known and self.verdict == SHORT and self.row.error <= known.most else ""

    @property
    def broken(self) -> bool:
        """Whether it should pass and does not."""
        return self.verdict == SHORT and not self.reason


def measure(reference: Reference, solver: str) -> list[Result]:
    """All rows of a reference with a solver."""
    return [Result(reference, solver, row) for row in reference.run(solver)]
