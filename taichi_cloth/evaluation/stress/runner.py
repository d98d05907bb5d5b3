"""Selects cases, variants and settings, and runs them in one process per core."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ...solvers import SOLVERS
from ...system import taichi_runtime as runtime
from ...system.errors import UsageError, nearest_hint
from ..worker_pool import run_parallel
from . import case_catalog
from .causes import Cause, cause_of
from .setup import SETTINGS, Setting
from .store import Store
from .unit import (
    PROCESS_ENDED,
    SLOW,
    Case,
    Failure,
    Key,
    Result,
    Starts,
    Unit,
    repeat_starts,
    result_of,
    run_unit,
)


def select_units(
    only: str | None = None,
    variant: str | None = None,
    setting: str | None = None,
    *,
    long: bool = False,
    tear: float | None = None,
) -> list[Unit]:
    """Return a unit for every variant with every setting, or for one case (number or name), variant or setting.

    `long` selects the long run of a million frames instead of case 32. `tear` is the strain at which springs tear; only
    settings whose solver supports tearing are used. Raises UsageError for an unknown case or variant, for `long` with
    another case, and for a setting that cannot tear.
    """
    cases = [case for case in case_catalog.CASES if only is None or only in (str(case.number), case.name)]
    if not cases:
        allowed = ", ".join(f"{case.number} {case.name}" for case in case_catalog.CASES)
        hint = nearest_hint(only, [case.name for case in case_catalog.CASES])
        raise UsageError(f"unknown case {only!r}; allowed: {allowed}{hint}")
    if long:
        if [case.number for case in cases] != [case_catalog.LONG.number]:
            raise UsageError(f"--soak requires --filter {case_catalog.LONG.number}, the long run")
        cases = [case_catalog.LONG]
    if variant is not None:
        cases = [of_variant(cases, variant)]
    return [Unit(case, one, with_it) for with_it in settings(setting, tear) for case in cases for one in case.variants]


def of_variant(cases: Iterable[Case], name: str) -> Case:
    """Return the single case with only this variant. Raises UsageError for several cases and for an unknown variant."""
    case, *others = cases
    if others:
        raise UsageError("--variant requires --filter with a single case")
    found = tuple(variant for variant in case.variants if variant.name == name)
    if not found:
        names = [variant.name for variant in case.variants]
        raise UsageError(f"{case.name} has no variant {name!r}; allowed: {', '.join(names)}{nearest_hint(name, names)}")
    return replace(case, variants=found)


def settings(name: str | None, tear: float | None) -> list[Setting]:
    """Return one setting or all; with `tear`, those that can tear at that strain. Raises UsageError if none can."""
    found = [one for one in SETTINGS.values() if name in (None, one.name)]
    if tear is None:
        return found
    able = [one for one in SETTINGS.values() if not SOLVERS[one.solver.name].info.grid_only]
    tearing = [one.tearing(tear) for one in found if one in able]
    if not tearing:
        others = ", ".join(one.name for one in able)
        raise UsageError(f"{name} needs complete grid rows, which tearing breaks: use {others}")
    return tearing


# Cores that this process may use: a container may allow fewer than there are. macOS does not tell.
CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


# One thread: more do not make cloth of this size faster, and the order of summation is the same on every machine.
begin = partial(runtime.start, "cpu", cpu_max_num_threads=1)


def fix_linear_algebra() -> None:
    """Give worker processes one thread of NumPy each, and the same sums on every processor.

    OpenBLAS has other kernels for processors with AVX-512. They add in another order, and the last bits of a result,
    which a repeated run compares, would depend on the processor.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    simd = np.show_config(mode="dicts")["SIMD Extensions"]
    if not {"AVX2", "X86_V3"}.isdisjoint([*simd["baseline"], *simd["found"]]):  # its name depends on NumPy's version
        os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")


def dearest_first(units: Sequence[Unit], seconds: Mapping[Key, float]) -> list[Unit]:
    """Return the units by decreasing cost, so that all cores finish at about the same time.

    Units without a measured time [s] come first, ordered by the cost of their setting; the units of one setting stay
    together, because they share compiled kernels.
    """
    return sorted(units, key=lambda unit: (-seconds.get(unit.key, 1e9), -unit.setting.cost))


def run_all(
    units: Sequence[Unit],
    starts: Callable[[Unit], Starts],
    pictures: Path | None,
    on_result: Callable[[Result], None],
    run_one: Callable[[Unit, Starts, Path | None], Result] = run_unit,
) -> None:
    """Run all units, each by `run_one`, and call `on_result` with each result as it completes.

    Units start in the given order.

    Processes side by side share caches and memory, so a unit that is too slow runs again when all others have ended.

    If a worker process dies, finished results are kept. Units that may have killed it run again, each in a process of
    its own; a unit whose own process dies too has failed.
    """
    fix_linear_algebra()
    found: set[int] = set()
    slow: set[int] = set()  # while others ran

    def done(k: int, result: Result) -> None:
        found.add(k)
        if result.state == SLOW and k not in slow:
            slow.add(k)
        else:
            on_result(result)

    def run(some: Sequence[int], processes: int) -> list[int]:
        """Run some units; return those without a result, if a process died."""
        jobs = {k: (units[k], starts(units[k]), pictures) for k in some}
        with suppress(BrokenProcessPool), closing(run_parallel(run_one, jobs, processes, begin)) as results:
            for k, result in results:
                done(k, result)
        return [k for k in some if k not in found]

    def run_to_the_end(some: Sequence[int], processes: int) -> None:
        remaining = run(some, processes)
        while remaining:
            for k in remaining[: processes + 1]:  # the pool starts jobs in this order, one more than it has processes
                for lost in run([k], 1):
                    done(lost, process_ended(units[lost], starts(units[lost])))
            remaining = run([k for k in remaining if k not in found], processes)

    run_to_the_end(range(len(units)), CORES)
    found -= slow
    run_to_the_end(sorted(slow), 1)


def explain_all(failed: Sequence[tuple[Unit, Failure, int]], on_cause: Callable[[Unit, Cause], None]) -> None:
    """Find the cause of every failure (`Store.untried`), and call `on_cause` with each as it is found.

    If a worker process dies, all experiments end, and the remaining failures stay unexplained.
    """
    fix_linear_algebra()
    with suppress(BrokenProcessPool), closing(run_parallel(cause_of, dict(enumerate(failed)), CORES, begin)) as causes:
        for k, cause in causes:
            on_cause(failed[k][0], cause)


def process_ended(unit: Unit, starts: Starts) -> Result:
    """Return the result of a unit whose process died."""
    start, seed = starts[0]
    return result_of(unit, len(starts), ran=1, failure=Failure(start, seed, 0, PROCESS_ENDED, 2, 0))


def recheck(stored: Store, units: Sequence[Unit]) -> None:
    """Repeat the last start of every result of an earlier version, without a limit on time, and keep those equal."""
    from ...system.console import steps_progress

    repeatable = stored.repeatable(units)
    seconds = {unit.key: stored.results[unit.key].seconds / stored.results[unit.key].ran for unit in repeatable}

    def last_start(unit: Unit) -> list[tuple[int, int]]:
        return unit.starts(stored.results[unit.key].ran)[-1:]

    with steps_progress(len(repeatable)) as on_step:

        def on_result(again: Result) -> None:
            outcome = "equal" if stored.repeat(again) else "differs"
            on_step(f"{again.case} {again.name}, {again.variant}, {again.setting}: {outcome}")

        run_all(dearest_first(repeatable, seconds), last_start, None, on_result, repeat_starts)


def explain(stored: Store, units: Sequence[Unit]) -> None:
    """Find causes of failures that were not examined earlier, of short runs first: one may interrupt the search."""
    from ...system.console import steps_progress

    failed = sorted(stored.untried(units), key=lambda one: stored.results[one[0].key].seconds)
    with steps_progress(len(failed)) as on_step:

        def on_cause(unit: Unit, cause: Cause) -> None:
            stored.explain(unit.key, cause)
            on_step(f"{unit.name}: {cause.shown or 'unexplained'}")

        explain_all(failed, on_cause)
    if remaining := len(stored.untried(units)):
        print(f"{remaining} failures were not examined: a process ended unexpectedly")
