"""Runs the measurements, each in a child process: many compile at a time, one alone is timed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from pathlib import Path
from statistics import median
from typing import Any, TypeAlias

import numpy as np

from .cases import Case, floor_of, highest_rate
from .floor import FloorTimer
from .report import Row, StageRow

CORES = os.cpu_count() or 1
HELD = 16  # children that wait at a time, compiled, for their turn to be timed

WARM_UP_FRAMES, WARM_UP_SECONDS = 60, 0.5  # the cloth moves, and the processor's clock is up
ROUNDS = 3  # floor, ours, floor, ours, floor, ours
ROUND_SECONDS = 0.5  # frames that would take longer are fewer
DEPTH_FRAMES = 480  # one sway of the curtain's ball
LEAST_SECONDS = 0.1  # of our frames: C computes at least as many, its shortest runs would tell of the clock only


class ChildFailed(RuntimeError):
    """A measurement that ended with an error; one line."""


class Child:
    """A process of `worker.py`, given its cases."""

    def __init__(self, cases: Sequence[Case], cache: Path) -> None:
        self._errors = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115
        self._process = subprocess.Popen(
            [sys.executable, "-m", "taichi_cloth.bench.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
            start_new_session=True,  # Ctrl-C is for the parent, which ends its children itself
        )
        self.tell({"cases": [asdict(case) for case in cases], "cache": str(cache)})

    def tell(self, order: dict[str, Any]) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(order) + "\n")
            self._process.stdin.flush()
        except OSError:
            raise self._failure() from None

    def answer(self) -> Any:
        """The next answer. Raises ChildFailed."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise self._failure()
        return json.loads(line)

    def frames(self, count: int, seconds: float) -> list[list[float]]:
        """Milliseconds of each frame of each case."""
        self.tell({"frames": count, "seconds": seconds})
        times: list[list[float]] = self.answer()
        return times

    def depths(self, count: int) -> list[float]:
        """The largest penetration of each case in its first frames [m]."""
        self.tell({"depth_of": count})
        found: list[float] = self.answer()
        return found

    def finish(self) -> dict[str, Any]:
        """What came out; the process ends, with its cache written."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        result: dict[str, Any] = self.answer()
        self._process.wait()
        return result

    def _failure(self) -> ChildFailed:
        code = self._process.wait()
        self._errors.seek(0)
        lines = [line.strip() for line in self._errors.read().splitlines() if line.strip()]
        return ChildFailed(lines[-1] if lines else f"the process ended with {code}")

    def kill(self) -> None:
        """Ends the process whatever it does; whoever waits for its answer gets ChildFailed."""
        self._process.kill()

    def end(self) -> None:
        """The same, and gives back what belongs to it."""
        self.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._errors):
            if stream is not None:
                with suppress(OSError):  # an order that nobody reads any more
                    stream.close()


Compiled: TypeAlias = Future[tuple[Child, list[dict[str, Any]]]]


class Bench:
    """Measures cases. `on_step(name)` is called as each of `steps(...)` begins, now and then from another thread."""

    def __init__(self, folder: Path, frames: int, on_step: Callable[[str], None]) -> None:
        self.floor = FloorTimer()
        self._folder = folder
        self._frames = -(-frames // ROUNDS)  # of a round
        self._on_step = on_step
        self._compiling = ThreadPoolExecutor(CORES)
        self._children: list[Child] = []
        self._caches = 0
        self._ended = False

    def end(self) -> None:
        """Ends all children, those too that are only just being started."""
        self._ended = True
        self._compiling.shutdown(wait=False, cancel_futures=True)
        for child in self._children:
            child.kill()
        self._compiling.shutdown()
        for child in self._children:
            child.end()

    def measure(self, cases: Sequence[Case], stages: Sequence[Case] = ()) -> tuple[list[Row], list[StageRow]]:
        """A row for each case and for each change of `stages`, all on one scene; those that fail say why."""
        together = self._compile("the curtain's stages", stages, self._cache()) if stages else None
        rows: list[Row] = []
        stage_rows: list[StageRow] = []
        for first in range(0, len(cases), HELD):
            known = {(row.solver, row.path) for row in rows if row.error is None}
            rows += self._measure_some(cases[first : first + HELD], known, together)
        if together is not None:
            stage_rows = self._time_stages(stages, together)
        return rows, stage_rows

    def _measure_some(self, cases: Sequence[Case], known: set[tuple[str, str]], together: Compiled | None) -> list[Row]:
        caches = [self._cache() for _ in cases]
        cold = [self._compile(case.name, [case], cache) for case, cache in zip(cases, caches, strict=True)]
        wait(cold if together is None else [*cold, together])
        rows: list[Row] = []
        warm: dict[int, Compiled] = {}
        for case, compiled in zip(cases, cold, strict=True):
            self._on_step(case.name)
            try:
                child, [told] = compiled.result()
                rows.append(self._time(case, child, told))
            except ChildFailed as error:
                rows.append(Row.failed(case, str(error)))
        for index, (case, row) in enumerate(zip(cases, rows, strict=True)):
            code = (row.solver, row.path)
            if row.error is None and code not in known:  # on other grids the code is the same
                known.add(code)
                warm[index] = self._compile(f"{case.name} again", [case], caches[index])
        for index, compiled in warm.items():
            child, [told] = compiled.result()
            child.end()
            rows[index] = replace(rows[index], warm_s=told["compile_s"])
        return rows

    def _compile(self, name: str, cases: Sequence[Case], cache: Path) -> Compiled:
        """A child that has compiled and waits, with what it tells; as many are at work at a time as there are cores."""

        def start() -> tuple[Child, list[dict[str, Any]]]:
            self._on_step(f"{name}, compiling")
            child = Child(cases, cache)
            self._children.append(child)
            if self._ended:
                child.kill()
            return child, child.answer()

        return self._compiling.submit(start)

    def _cache(self) -> Path:
        self._caches += 1
        cache = self._folder / str(self._caches)
        cache.mkdir()
        return cache

    def _time(self, case: Case, child: Child, compiled: dict[str, Any]) -> Row:
        substeps, springs = compiled["substeps"], compiled["springs"]
        [before] = child.frames(WARM_UP_FRAMES, WARM_UP_SECONDS)
        count = max(1, min(self._frames, int(1e3 * ROUND_SECONDS / median(before))))
        grid = (case.rows, case.columns, substeps, case.iterations)
        many = max(count, int(1e3 * LEAST_SECONDS / median(before)))
        programs = floor_of(case)
        ms: list[float] = []
        over_c: list[float] = []
        under_javascript: list[float] = []
        for _ in range(ROUNDS):
            in_c = self.floor.median_ms(programs.in_c, *grid, many) if programs.in_c else None
            in_javascript = (
                self.floor.median_ms(programs.in_javascript, *grid, count) if programs.in_javascript else None
            )
            [ours] = child.frames(count, 2 * ROUND_SECONDS)
            ms += ours
            over_c += [] if in_c is None else [median(ours) / in_c]
            under_javascript += [] if in_javascript is None else [in_javascript / median(ours)]
        result = child.finish()
        [outcome] = result["cases"]
        if outcome["max_strain"] is None:
            raise ChildFailed("the cloth blew up")
        stretch = outcome["max_strain"] - outcome["static_strain"]
        p95 = float(np.percentile(ms, 95))
        return Row(
            scene=case.scene,
            solver=case.solver,
            path=compiled["path"],
            columns=case.columns,
            rows=case.rows,
            substeps=substeps,
            iterations=case.iterations,
            springs=springs,
            frames=len(ms),
            median_ms=median(ms),
            p95_ms=p95,
            fits=highest_rate(p95),
            ns_per_spring=1e6 * median(ms) / (substeps * case.iterations * springs),
            over_c=median(over_c) if over_c else None,
            under_javascript=median(under_javascript) if under_javascript else None,
            cold_s=compiled["compile_s"],
            peak_mb=result["peak_bytes"] / 1e6 if result["peak_bytes"] else None,
            state_mb=outcome["state_bytes"] / 1e6,
            max_strain=outcome["max_strain"],
            stretch=None if np.isnan(stretch) else stretch,
        )

    def _time_stages(self, cases: Sequence[Case], together: Compiled) -> list[StageRow]:
        """Frame by frame in turn; the first case is the one that others are compared with."""
        self._on_step("the curtain's stages")
        try:
            child, compiled = together.result()
            child.frames(WARM_UP_FRAMES, WARM_UP_SECONDS)
            times = [median(ms) for ms in child.frames(ROUNDS * self._frames, ROUNDS * ROUND_SECONDS)]
            depths = child.depths(DEPTH_FRAMES)
            child.finish()
        except ChildFailed as error:
            return [StageRow(change="", error=str(error))]
        return [
            StageRow(case.change, told["compile_s"], ms, ms - times[0], 1e3 / ms, depth)
            for case, told, ms, depth in zip(cases, compiled, times, depths, strict=True)
        ]


def steps(cases: Sequence[Case], stages: Sequence[Case]) -> int:
    """How often `on_step` is called: each case compiles and is timed, and each path compiles again with its cache."""
    return 2 * len(cases) + len({(case.solver, case.path) for case in cases}) + 2 * bool(stages)


@contextmanager
def bench(frames: int, on_step: Callable[[str], None] = lambda name: None) -> Iterator[Bench]:
    """A bench with caches of its own; at the end of the block, however it comes, no child is left."""
    with tempfile.TemporaryDirectory(prefix="taichi_cloth_bench_", ignore_cleanup_errors=True) as folder:
        running = Bench(Path(folder), frames, on_step)
        try:
            yield running
        finally:
            running.end()
