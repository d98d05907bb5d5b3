"""Measurements in child processes. Several compile at a time, but only one is timed at a time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np

from .bench_report import FeatureRow, Row
from .cases import Case, NativeTimer, highest_rate, native_programs_of

CORES = os.cpu_count() or 1
MAX_WAITING = 16  # largest number of compiled children that wait to be timed

WARM_UP_FRAMES, WARM_UP_SECONDS = 60, 0.5  # until the cloth moves and the processor has reached its clock rate
ROUNDS = 3  # native programs and taichi_cloth are timed alternately, this many times each
ROUND_SECONDS = 0.5  # fewer frames are timed if a round would take longer
DEPTH_FRAMES = 480  # one oscillation of the curtain's sphere
MIN_C_SECONDS = 0.1  # C runs at least as many frames as we do in this time: shorter runs cannot be timed


class ChildFailed(RuntimeError):
    """A child process ended with an error. The text is one line."""


class Child:
    """A process of `worker.py` with its cases."""

    def __init__(self, cases: Sequence[Case], cache: Path) -> None:
        self._errors = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115
        self._process = subprocess.Popen(
            [sys.executable, "-m", "taichi_cloth.evaluation.bench.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
            start_new_session=True,  # Ctrl-C reaches the parent only, which ends its children
        )
        self.send({"cases": [asdict(case) for case in cases], "cache": str(cache)})

    def send(self, request: dict[str, Any]) -> None:
        """Send a request to the process. Raises ChildFailed."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
        except OSError:
            raise self._failure() from None

    def receive(self) -> Any:
        """Wait for the next response and return it. Raises ChildFailed."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise self._failure()
        return json.loads(line)

    def frames(self, count: int, seconds: float) -> list[list[float]]:
        """Return the time of each frame of each case [ms]."""
        self.send({"frames": count, "seconds": seconds})
        times: list[list[float]] = self.receive()
        return times

    def depths(self, count: int) -> list[float]:
        """Return the largest penetration of each case in its first `count` frames [m]."""
        self.send({"depth_of": count})
        depths: list[float] = self.receive()
        return depths

    def finish(self) -> dict[str, Any]:
        """Return the final results; the process writes its cache and ends."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        result: dict[str, Any] = self.receive()
        self._process.wait()
        return result

    def _failure(self) -> ChildFailed:
        code = self._process.wait()
        self._errors.seek(0)
        lines = [line.strip() for line in self._errors.read().splitlines() if line.strip()]
        return ChildFailed(lines[-1] if lines else f"the process ended with exit code {code}")

    def kill(self) -> None:
        """Kill the process. A thread that waits for its response gets ChildFailed."""
        self._process.kill()

    def end(self) -> None:
        """Kill the process and close its streams."""
        self.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._errors):
            if stream is not None:
                with suppress(OSError):  # a request that was never read
                    stream.close()


Compiled: TypeAlias = Future[tuple[Child, list[dict[str, Any]]]]


class Bench:
    """Measures cases. `on_step(name)` is called as each of `steps(...)` begins, sometimes from another thread."""

    def __init__(self, folder: Path, frames: int, on_step: Callable[[str], None]) -> None:
        self.floor = NativeTimer()
        self._folder = folder
        self._frames = -(-frames // ROUNDS)  # in a round
        self._on_step = on_step
        self._compiling = ThreadPoolExecutor(CORES)
        self._children: list[Child] = []
        self._caches = 0
        self._ended = False

    def end(self) -> None:
        """End all children, including those that are still starting."""
        self._ended = True
        self._compiling.shutdown(wait=False, cancel_futures=True)
        for child in self._children:
            child.kill()
        self._compiling.shutdown()
        for child in self._children:
            child.end()

    def measure(self, cases: Sequence[Case], features: Sequence[Case] = ()) -> tuple[list[Row], list[FeatureRow]]:
        """Return a row for each case, and one for each case of `features`; a case that failed has an error text.

        All `features` run in one child, where their frames are timed in turn.
        """
        features_compiled = self._compile("the curtain's features", features, self._cache()) if features else None
        rows: list[Row] = []
        feature_rows: list[FeatureRow] = []
        for first in range(0, len(cases), MAX_WAITING):
            compiled_before = {(row.solver, row.layout) for row in rows if row.error is None}
            rows += self._measure_batch(cases[first : first + MAX_WAITING], compiled_before, features_compiled)
        if features_compiled is not None:
            feature_rows = self._time_features(features, features_compiled)
        return rows, feature_rows

    def _measure_batch(
        self, cases: Sequence[Case], compiled_before: set[tuple[str, str]], features_compiled: Compiled | None
    ) -> list[Row]:
        """Compile all cases, time them one by one, then compile each new solver and layout again with its cache."""
        caches = [self._cache() for _ in cases]
        cold = [self._compile(case.name, [case], cache) for case, cache in zip(cases, caches, strict=True)]
        wait(cold if features_compiled is None else [*cold, features_compiled])
        rows: list[Row] = []
        warm: dict[int, Compiled] = {}
        for case, compiled in zip(cases, cold, strict=True):
            self._on_step(case.name)
            try:
                child, [first_frame] = compiled.result()
                rows.append(self._time(case, child, first_frame))
            except ChildFailed as error:
                rows.append(Row.failed(case, str(error)))
        for index, (case, row) in enumerate(zip(cases, rows, strict=True)):
            code = (row.solver, row.layout)
            if row.error is None and code not in compiled_before:  # other grids run the same code
                compiled_before.add(code)
                warm[index] = self._compile(f"{case.name} again", [case], caches[index])
        for index, compiled in warm.items():
            child, [first_frame] = compiled.result()
            child.end()
            rows[index] = replace(rows[index], warm_s=first_frame["compile_s"])
        return rows

    def _compile(self, name: str, cases: Sequence[Case], cache: Path) -> Compiled:
        """Start a child, and return it with its first response once it has compiled and waits.

        As many children compile at a time as there are cores.
        """

        def start() -> tuple[Child, list[dict[str, Any]]]:
            self._on_step(f"{name}, compiling")
            child = Child(cases, cache)
            self._children.append(child)
            if self._ended:
                child.kill()
            return child, child.receive()

        return self._compiling.submit(start)

    def _cache(self) -> Path:
        """Return a new, empty folder for compiled kernels."""
        self._caches += 1
        cache = self._folder / str(self._caches)
        cache.mkdir()
        return cache

    def _time(self, case: Case, child: Child, compiled: dict[str, Any]) -> Row:
        """Time a compiled case against the native programs, in alternating rounds. Raises ChildFailed."""
        substeps, springs = compiled["substeps"], compiled["springs"]
        [warm_up] = child.frames(WARM_UP_FRAMES, WARM_UP_SECONDS)
        count = max(1, min(self._frames, int(1e3 * ROUND_SECONDS / median(warm_up))))
        size = (case.rows, case.columns, substeps, case.iterations)
        count_in_c = max(count, int(1e3 * MIN_C_SECONDS / median(warm_up)))
        programs = native_programs_of(case)
        ms: list[float] = []
        ratio_to_c: list[float] = []
        speedup_over_javascript: list[float] = []
        for _ in range(ROUNDS):
            in_c = self.floor.median_ms(programs.in_c, *size, count_in_c) if programs.in_c else None
            in_javascript = (
                self.floor.median_ms(programs.in_javascript, *size, count) if programs.in_javascript else None
            )
            [ours] = child.frames(count, 2 * ROUND_SECONDS)
            ms += ours
            ratio_to_c += [] if in_c is None else [median(ours) / in_c]
            speedup_over_javascript += [] if in_javascript is None else [in_javascript / median(ours)]
        result = child.finish()
        [outcome] = result["cases"]
        if outcome["max_strain"] is None:
            raise ChildFailed("the cloth blew up")
        stretch = outcome["max_strain"] - outcome["static_strain"]
        p95 = float(np.percentile(ms, 95))
        return Row(
            scene=case.scene,
            solver=case.solver,
            layout=compiled["layout"],
            columns=case.columns,
            rows=case.rows,
            substeps=substeps,
            iterations=case.iterations,
            springs=springs,
            frames=len(ms),
            median_ms=median(ms),
            p95_ms=p95,
            max_frame_rate=highest_rate(p95),
            ns_per_spring=1e6 * median(ms) / (substeps * case.iterations * springs),
            ratio_to_c=median(ratio_to_c) if ratio_to_c else None,
            speedup_over_javascript=median(speedup_over_javascript) if speedup_over_javascript else None,
            cold_s=compiled["compile_s"],
            peak_mb=result["peak_bytes"] / 1e6 if result["peak_bytes"] else None,
            state_mb=outcome["state_bytes"] / 1e6,
            max_strain=outcome["max_strain"],
            stretch=None if np.isnan(stretch) else stretch,
            frame_error=outcome["frame_error"],
        )

    def _time_features(self, cases: Sequence[Case], features_compiled: Compiled) -> list[FeatureRow]:
        """Time the frames of all cases in turn, and return their rows. Others are compared with the first case."""
        self._on_step("the curtain's features")
        try:
            child, compiled = features_compiled.result()
            child.frames(WARM_UP_FRAMES, WARM_UP_SECONDS)
            times = [median(ms) for ms in child.frames(ROUNDS * self._frames, ROUNDS * ROUND_SECONDS)]
            depths = child.depths(DEPTH_FRAMES)
            child.finish()
        except ChildFailed as error:
            return [FeatureRow(change="", error=str(error))]
        return [
            FeatureRow(case.change, first_frame["compile_s"], ms, ms - times[0], 1e3 / ms, depth)
            for case, first_frame, ms, depth in zip(cases, compiled, times, depths, strict=True)
        ]


def steps(cases: Sequence[Case], features: Sequence[Case]) -> int:
    """Return how often `on_step` is called: each case compiles and is timed, and each layout compiles a second time."""
    return 2 * len(cases) + len({(case.solver, case.layout) for case in cases}) + 2 * bool(features)


@contextmanager
def bench(frames: int, on_step: Callable[[str], None] = lambda name: None) -> Iterator[Bench]:
    """Return a `Bench` with its own kernel caches. When the block ends, also by an error, all children are ended."""
    with tempfile.TemporaryDirectory(prefix="taichi_cloth_bench_", ignore_cleanup_errors=True) as folder:
        running = Bench(Path(folder), frames, on_step)
        try:
            yield running
        finally:
            running.end()


RUNS = 5  # the median of these counts
# Runs a command line, and prints its peak memory in the last line.
COMMAND = """
import json, sys
from taichi_cloth.__main__ import main
code = main(sys.argv[1:])
from taichi_cloth.system.taichi_runtime import peak_bytes
print(json.dumps({"peak_bytes": peak_bytes()}))
sys.exit(code)
"""


@dataclass(frozen=True)
class Startup:
    """Run time of a command, including the interpreter's start."""

    what: str
    seconds: float
    """Wall time [s]."""
    peak_mb: float | None = None
    """Peak memory of the process [MB]; None if the system does not report it."""


RENDER = ("render", "curtain", "--frames", "1")
MEASURED = 5  # number of results of `measure`


def measure(render: Sequence[str] = RENDER) -> Iterator[Startup]:
    """Measure Python alone, `import taichi_cloth`, `--help`, and one rendered frame without and with compiled kernels.

    Raises ChildFailed.
    """
    without_frames = {
        "Python alone": ["-c", "pass"],
        "import taichi_cloth": ["-c", "import taichi_cloth"],
        "taichi-cloth --help": ["-m", "taichi_cloth", "--help"],
    }
    for what, args in without_frames.items():
        yield Startup(what, median(_run(args, os.environ.copy())[0] for _ in range(RUNS)))
    with TemporaryDirectory(prefix="taichi_cloth_startup_", ignore_cleanup_errors=True) as folder:
        environment = {**os.environ, "TI_OFFLINE_CACHE_FILE_PATH": str(Path(folder) / "cache")}
        runs = []
        for run in range(1 + RUNS):
            command = ["-c", COMMAND, *render, "--out", str(Path(folder) / str(run))]
            seconds, out = _run(command, environment)
            peak = json.loads(out.splitlines()[-1])["peak_bytes"]
            runs.append((seconds, None if peak is None else peak / 1e6))
        yield Startup("first frame, cache empty", *runs[0])
        peaks = [peak for _, peak in runs[1:] if peak is not None]
        yield Startup("first frame, cache filled", median(s for s, _ in runs[1:]), max(peaks, default=None))


def _run(args: list[str], environment: dict[str, str]) -> tuple[float, str]:
    """Run a Python process. Return its wall time [s] and what it printed. Raises ChildFailed."""
    start = time.perf_counter()
    run = subprocess.run([sys.executable, *args], env=environment, capture_output=True, text=True, encoding="utf-8")
    seconds = time.perf_counter() - start
    if run.returncode:
        lines = run.stderr.strip().splitlines() or [f"the process ended with exit code {run.returncode}"]
        raise ChildFailed(lines[-1])
    return seconds, run.stdout
