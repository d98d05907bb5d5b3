"""Measures references, two side by side where there are cores for that."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import active_children, get_context

from .. import runtime
from .catalogue import REFERENCES
from .row import Reference, Result, measure

CORES = os.cpu_count() or 1
BY_NUMBER = {reference.number: reference for reference in REFERENCES}
DEAREST = ("projective", "rk4", "xpbd", "lines", "spring", "verlet")  # first, so that no core waits for another long


def measure_all(pairs: Sequence[tuple[Reference, str]], on_step: Callable[[str], None]) -> list[Result]:
    """The rows of every pair, in their order; one pair in this process, more in as many as there are cores."""
    if len(pairs) == 1 or CORES == 1:
        return here(pairs, on_step)
    found: dict[int, list[Result]] = {}
    order = sorted(range(len(pairs)), key=lambda k: DEAREST.index(pairs[k][1]))
    with ProcessPoolExecutor(min(CORES, len(pairs)), get_context("spawn"), begin) as pool:
        try:
            waiting = {pool.submit(measure_pair, pairs[k][0].number, pairs[k][1]): k for k in order}
            for future in as_completed(waiting):
                k = waiting[future]
                found[k] = future.result()
                on_step(name_of(*pairs[k]))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in active_children():  # a reference may have minutes to go
                child.terminate()
            raise
    return [result for k in range(len(pairs)) for result in found[k]]


def here(pairs: Sequence[tuple[Reference, str]], on_step: Callable[[str], None]) -> list[Result]:
    runtime.start("cpu")
    found = []
    for reference, solver in pairs:
        on_step(name_of(reference, solver))
        found += measure(reference, solver)
    return found


def begin() -> None:
    """A process of its own: Ctrl-C is for the one that ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    runtime.start("cpu")


def measure_pair(number: str, solver: str) -> list[Result]:
    return measure(BY_NUMBER[number], solver)


def name_of(reference: Reference, solver: str) -> str:
    return f"{reference.number} {reference.name}, {solver}"
