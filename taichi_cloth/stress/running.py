"""Runs cases, all starts of one with one setting after another, and two of them side by side."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

from .. import runtime
from .catalogue import Case
from .picture import draw
from .setting import Setting
from .trial import Figure, OutOfTime, Trial, close
from .watch import Broken

CORES = os.cpu_count() or 1


@dataclass(frozen=True)
class Failure:
    """Which bound broke, when, and by how much."""

    frame: int
    what: str
    value: float
    bound: float


@dataclass(frozen=True)
class Outcome:
    """One start."""

    start: int
    failure: Failure | None
    frames: int
    cut: bool  # it was as many as its substeps allow
    ms: float  # of a frame
    energy: float  # worst, as in `watch.Worst`
    strain: float
    speed: float
    penetration: float
    figures: list[Figure]
    picture: str = ""


@dataclass(frozen=True)
class Result:
    """All starts of a case with a setting."""

    case: Case
    setting: str
    outcomes: list[Outcome] = field(default_factory=list)

    @property
    def failed(self) -> list[Outcome]:
        return [outcome for outcome in self.outcomes if outcome.failure]

    @property
    def name(self) -> str:
        """Number and name of the case."""
        return f"{self.case.number} {self.case.name}"

    @property
    def reason(self) -> str:
        """Why it fails, where that is known."""
        return self.case.beyond.get(self.setting, "") if self.failed else ""

    @property
    def alive(self) -> bool:
        return not self.failed


def run_start(case: Case, setting: Setting, number: int, pictures: Path | None) -> Outcome:
    trial = Trial(setting, number)
    failure, cut, shown = None, False, ""
    try:
        case.run(trial)
    except Broken as broken:
        failure = Failure(trial.frame, broken.what, float(broken.value), float(broken.bound))
        if pictures:
            path = pictures / f"{case.number:02d}_{case.name}_{setting.name}_{number}.png".replace(" ", "_")
            shown = str(path) if draw(trial, path) else ""
    except OutOfTime:
        cut = True
    worst = trial.worst
    return Outcome(
        start=number,
        failure=failure,
        frames=trial.frame,
        cut=cut,
        ms=1e3 * trial.seconds / max(trial.frame - 1, 1),
        energy=worst.energy,
        strain=worst.strain,
        speed=worst.speed,
        penetration=worst.penetration,
        figures=trial.figures,
        picture=shown,
    )


def run_case(case: Case, setting: Setting, starts: int, pictures: Path | None) -> Result:
    """Every start. A picture shows the first that fails."""
    result = Result(case, setting.name)
    try:
        for number in range(starts):
            result.outcomes.append(run_start(case, setting, number, None if result.failed else pictures))
    finally:
        close()
    return result


@contextmanager
def deaf_children() -> Iterator[None]:
    """Processes that begin meanwhile do not hear Ctrl-C, nor print what it broke off: it is for us, who end them."""
    before = None
    with suppress(ValueError):  # not in the main thread, which alone is interrupted
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        if before is not None:
            signal.signal(signal.SIGINT, before)


def run_all(
    pairs: Sequence[tuple[Case, Setting]], starts: int, pictures: Path | None, on_step: Callable[[str], None]
) -> list[Result]:
    """A result for each pair, in their order. Two or more run in as many processes as there are cores, the dearest
    settings first: so no core waits for the other long.

    Where a process ends before its time, what was done stays done. Those that may have ended it run again, each in a
    process of its own; one that ends that too has failed.
    """
    if len(pairs) == 1:
        [(case, setting)] = pairs
        on_step(f"{case.number} {case.name}, {setting.name}")
        runtime.start("cpu")
        return [run_case(case, setting, starts, pictures)]
    found: dict[int, Result] = {}

    def done(k: int, result: Result) -> None:
        found[k] = result
        on_step(f"{result.name}, {result.setting}")

    def run(some: Sequence[int], processes: int) -> list[int]:
        """Those that are not done when a process has ended."""
        jobs = {k: (*pairs[k], starts, pictures) for k in some}
        with suppress(BrokenProcessPool), closing(in_processes(jobs, processes)) as results:
            for k, result in results:
                done(k, result)
        return [k for k in some if k not in found]

    left = run(sorted(range(len(pairs)), key=lambda k: -pairs[k][1].cost), CORES)
    while left:
        for k in left[: CORES + 1]:  # the pool hands them out in this order, one more than there are processes
            for lost in run([k], 1):
                done(lost, process_ended(*pairs[lost]))
        left = run([k for k in left if k not in found], CORES)
    return [found[k] for k in range(len(pairs))]


def in_processes(jobs: Mapping[int, tuple[Any, ...]], processes: int) -> Generator[tuple[int, Result], None, None]:
    """Results of `run_case` with these arguments as they come. Raises BrokenProcessPool."""
    with ProcessPoolExecutor(processes, get_context("spawn"), partial(runtime.start, "cpu")) as pool:
        try:
            with deaf_children():
                waiting = {pool.submit(run_case, *job): k for k, job in jobs.items()}
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in active_children():  # a case may have minutes to go
                child.terminate()
            raise


def process_ended(case: Case, setting: Setting) -> Result:
    """What is told of a case that took its process with it."""
    failure = Failure(0, "times that its process ended", 2, 0)
    return Result(case, setting.name, [Outcome(0, failure, 0, False, 0.0, 0.0, 0.0, 0.0, 0.0, [])])


def by_setting(results: Sequence[Result]) -> Iterator[tuple[str, list[Result]]]:
    for setting in dict.fromkeys(result.setting for result in results):
        yield setting, [result for result in results if result.setting == setting]
