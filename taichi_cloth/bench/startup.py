"""How long commands take from their start, and how much memory: each run is a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from .children import ChildFailed

RUNS = 5  # of what takes a fraction of a second; the median counts
# A command as it is typed; its last line tells the peak of its memory.
COMMAND = """
import json, sys
from taichi_cloth.cli import main
code = main(sys.argv[1:])
from taichi_cloth.machine import peak_bytes
print(json.dumps({"peak_bytes": peak_bytes()}))
sys.exit(code)
"""


@dataclass(frozen=True)
class Startup:
    """A command from its start to its end, the interpreter included."""

    what: str
    seconds: float  # wall time
    peak_mb: float | None = None  # memory of the process, where the system tells


RENDER = ("render", "curtain", "--frames", "1")
MEASURED = 5  # that `measure` yields


def measure(render: Sequence[str] = RENDER) -> Iterator[Startup]:
    """Python alone, importing the package, the help, and one rendered frame without and with compiled kernels."""
    plain = {
        "Python alone": ["-c", "pass"],
        "import taichi_cloth": ["-c", "import taichi_cloth"],
        "taichi-cloth --help": ["-m", "taichi_cloth", "--help"],
    }
    for what, words in plain.items():
        yield Startup(what, median(_run(words, os.environ.copy())[0] for _ in range(RUNS)))
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


def _run(words: list[str], environment: dict[str, str]) -> tuple[float, str]:
    """Seconds of a Python process, and what it printed. Raises ChildFailed."""
    start = time.perf_counter()
    done = subprocess.run([sys.executable, *words], env=environment, capture_output=True, text=True, encoding="utf-8")
    seconds = time.perf_counter() - start
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"the process ended with {done.returncode}"]
        raise ChildFailed(lines[-1])
    return seconds, done.stdout
