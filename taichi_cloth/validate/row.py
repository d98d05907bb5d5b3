"""One line of the report: a number that is known, the same number measured, and what the difference is worth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import isfinite, nan
from typing import NamedTuple

EXCELLENT, PASS, SHORT, TOO_SLOW = "excellent", "pass", "falls short", "too slow"


class Limit(NamedTuple):
    """What theory says that a method cannot do better than with this setting."""

    law: str  # the formula
    most: float  # its error in this row's set-up, and what the row allows


@dataclass(frozen=True)
class Row:
    """A measured number beside the exact one. `error` is in the unit of the bounds `good` and `best`."""

    what: str  # set-up and quantity, with its unit: "free fall from rest, 1 s: drop [m]"
    exact: float
    measured: float
    error: float  # relative, or in the words of `what`
    good: float  # largest error that passes
    best: float  # largest that is excellent
    limit: Limit | None = None
    seconds: float = 0.0  # of processor time, where it was stopped for having taken too long

    @property
    def verdict(self) -> str:
        if self.seconds:
            return TOO_SLOW
        if not isfinite(self.error) or self.error > self.good:
            return SHORT
        return EXCELLENT if self.error <= self.best else PASS

    @property
    def explained(self) -> bool:
        """Whether it falls short by no more than theory says it must."""
        return self.verdict == SHORT and self.limit is not None and self.error <= self.limit.most

    @property
    def unexplained(self) -> bool:
        """Whether it falls short, and no theory says by how much it must."""
        return self.verdict == SHORT and not self.explained

    @property
    def broken(self) -> bool:
        """Whether it falls short by more than theory says."""
        return self.verdict == SHORT and self.limit is not None and not self.explained

    def by_law(self, law: str, error: float | Callable[[], float], miss: float | None = None) -> Row:
        """The same row of a method whose law makes this error: it may be as far off, and miss the law by `miss`, which
        is `good` where nothing else is said.

        A law that would let the row pass explains nothing, and is left out. One that is a function is found where a row
        falls short only: some take seconds.
        """
        if callable(error):
            return self.by_law(law, error(), miss) if self.verdict == SHORT else self
        if error + (miss or 0.0) <= self.good:
            return self
        return replace(self, limit=Limit(law, error + (self.good if miss is None else miss)))


def relative(what: str, exact: float, measured: float, good: float, best: float) -> Row:
    """A row whose error is a share of the exact number."""
    return Row(what, exact, measured, abs(measured - exact) / abs(exact), good, best)


def at_most(what: str, measured: float, good: float, best: float) -> Row:
    """A row of something that should be 0."""
    return Row(what, 0.0, measured, abs(measured), good, best)


class TooSlow(Exception):
    """A set-up has taken more processor time [s] than one may."""

    def __init__(self, seconds: float) -> None:
        super().__init__(f"more than {seconds:.0f} s")
        self.seconds = seconds


def in_time(what: str, good: float, best: float, measured: Callable[[], Row]) -> Row:
    """The row that `measured` gives, or one that says that its set-up takes too long."""
    try:
        return measured()
    except TooSlow as slow:
        return Row(what, nan, nan, nan, good, best, seconds=slow.seconds)


@dataclass(frozen=True)
class Reference:
    """A set-up with known answers. `run` measures it with a solver, and yields a row for each answer."""

    number: str  # in the list of references: "A1.1"
    name: str
    source: str
    run: Callable[[str], Iterator[Row]]
    solvers: tuple[str, ...]  # those that have what it asks for


@dataclass(frozen=True)
class Result:
    """A row with where it belongs."""

    number: str
    name: str
    source: str
    solver: str
    row: Row

    @property
    def verdict(self) -> str:
        return self.row.verdict

    @property
    def reference(self) -> str:
        return f"{self.number} {self.name}"


def measure(reference: Reference, solver: str) -> list[Result]:
    """All rows of a reference with a solver; where one takes too long, those that it would have had after it as one."""
    rows = []
    try:
        for row in reference.run(solver):
            rows.append(row)
    except TooSlow as slow:
        rows.append(Row("this row and what comes after it", nan, nan, nan, nan, nan, seconds=slow.seconds))
    return [Result(reference.number, reference.name, reference.source, solver, row) for row in rows]
