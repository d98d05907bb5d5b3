"""Measures references, two side by side where there are cores for that."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial

from .. import runtime
from ..side_by_side import side_by_side
from .catalogue import REFERENCES
from .row import Reference, Result, measure

CORES = os.cpu_count() or 1
begin = partial(runtime.start, "cpu")
BY_NUMBER = {reference.number: reference for reference in REFERENCES}
DEAREST = ("projective", "rk4", "xpbd", "lines", "spring", "verlet")  # first, so that no core waits for another long


def measure_all(pairs: Sequence[tuple[Reference, str]], on_step: Callable[[str], None]) -> list[Result]:
    """The rows of every pair, in their order; one pair in this process, more in as many as there are cores."""
    if len(pairs) == 1 or CORES == 1:
        return here(pairs, on_step)
    order = sorted(range(len(pairs)), key=lambda k: DEAREST.index(pairs[k][1]))
    jobs = {k: (pairs[k][0].number, pairs[k][1]) for k in order}
    found: dict[int, list[Result]] = {}
    with closing(side_by_side(measure_pair, jobs, min(CORES, len(pairs)), begin)) as results:
        for k, result in results:
            found[k] = result
            on_step(name_of(*pairs[k]))
    return [result for k in range(len(pairs)) for result in found[k]]


def here(pairs: Sequence[tuple[Reference, str]], on_step: Callable[[str], None]) -> list[Result]:
    begin()
    found = []
    for reference, solver in pairs:
        on_step(name_of(reference, solver))
        found += measure(reference, solver)
    return found


def measure_pair(number: str, solver: str) -> list[Result]:
    return measure(BY_NUMBER[number], solver)


def name_of(reference: Reference, solver: str) -> str:
    return f"{reference.number} {reference.name}, {solver}"
