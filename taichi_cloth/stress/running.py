"""Runs units side by side, in as many processes as there are cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, suppress
from functools import partial
from pathlib import Path

from .. import runtime
from ..side_by_side import side_by_side
from .causes import Cause, cause_of
from .unit import PROCESS_ENDED, Failure, Key, Result, Unit, result_of, run_unit

CORES = os.cpu_count() or 1

Starts = Sequence[tuple[int, int]]  # number and seed of each

# One thread: frames of such cloths are no faster with more, and the order of sums is the same everywhere.
begin = partial(runtime.start, "cpu", cpu_max_num_threads=1)


def one_thread_each() -> None:
    """NumPy's threads would take each other's cores."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def dearest_first(units: Sequence[Unit], seconds: Mapping[Key, float]) -> list[Unit]:
    """So no core waits for another long. Measured times come first, then settings by their cost, each in one piece:
    its kernels are used again.
    """
    return sorted(units, key=lambda unit: (-seconds.get(unit.key, 1e9), -unit.setting.cost))


def run_all(
    units: Sequence[Unit],
    starts: Callable[[Unit], Starts],
    pictures: Path | None,
    on_result: Callable[[Result], None],
) -> None:
    """Hands over a result for each unit as it comes, in the order given as far as processes allow.

    Where a process ends before its time, what was done stays done. Those that may have ended it run again, each in a
    process of its own; one that ends that too has failed.
    """
    one_thread_each()
    if len(units) == 1:
        begin()
        on_result(run_unit(units[0], starts(units[0]), pictures))
        return
    found: set[int] = set()

    def done(k: int, result: Result) -> None:
        found.add(k)
        on_result(result)

    def run(some: Sequence[int], processes: int) -> list[int]:
        """Those that are not done when a process has ended."""
        jobs = {k: (units[k], starts(units[k]), pictures) for k in some}
        with suppress(BrokenProcessPool), closing(side_by_side(run_unit, jobs, processes, begin)) as results:
            for k, result in results:
                done(k, result)
        return [k for k in some if k not in found]

    left = run(range(len(units)), CORES)
    while left:
        for k in left[: CORES + 1]:  # the pool hands them out in this order, one more than there are processes
            for lost in run([k], 1):
                done(lost, process_ended(units[lost], starts(units[lost])))
        left = run([k for k in left if k not in found], CORES)


def explain_all(failed: Sequence[tuple[Unit, Failure]], on_cause: Callable[[Unit, Cause], None]) -> None:
    """Hands over what experiments show about each, as it comes. One that ends its process ends them all: those that are
    left stay unexplained.
    """
    one_thread_each()
    with suppress(BrokenProcessPool), closing(side_by_side(cause_of, dict(enumerate(failed)), CORES, begin)) as causes:
        for k, cause in causes:
            on_cause(failed[k][0], cause)


def process_ended(unit: Unit, starts: Starts) -> Result:
    """What is told of a unit that took its process with it."""
    start, seed = starts[0]
    return result_of(unit, len(starts), ran=1, failure=Failure(start, seed, 0, PROCESS_ENDED, 2, 0))
