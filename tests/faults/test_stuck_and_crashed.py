"""A test run ends at once and names the test if a test crashes its process or never ends."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

CRASHES = """
import os, signal

def test_before():
    pass

def test_that_crashes():
    os.kill(os.getpid(), signal.SIGSEGV)

def test_behind():
    pass
"""

STUCK = """
import taichi as ti

@ti.kernel
def endless(x: ti.template()):
    ti.loop_config(serialize=True)
    for _ in range(1):
        while x[None] != 1:  # never true: x stays even
            x[None] = x[None] * 1664525 + 1013904224

def test_before():
    pass

def test_that_never_ends():
    endless(ti.field(ti.i32, ()))

def test_behind():
    pass
"""


def run(folder: Path, content: str, *options: str) -> tuple[str, float]:
    """Run pytest on a test file with this project's settings. Return its output and time [s]. It must fail."""
    shutil.copy(ROOT / "tests" / "conftest.py", folder)
    (folder / "test_file.py").write_text(content)
    command = [sys.executable, "-m", "pytest", "-c", str(ROOT / "pyproject.toml"), "--rootdir", str(folder)]
    command += ["-p", "no:cacheprovider", *options, str(folder / "test_file.py")]
    start = time.monotonic()
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)
    assert done.returncode != 0
    return done.stdout + done.stderr, time.monotonic() - start


@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_crashed_worker_ends_the_run(tmp_path: Path, workers: str) -> None:
    output, seconds = run(tmp_path, CRASHES, "-n", workers)
    assert "crashed while running 'test_file.py::test_that_crashes'" in output
    assert "1 failed, 1 passed" in output  # no worker replaces it: xdist has been seen to wait for one forever
    assert seconds < 60


@pytest.mark.parametrize("workers", ["0", "2"])
def test_a_kernel_that_never_ends_is_stopped(tmp_path: Path, workers: str) -> None:
    output, seconds = run(tmp_path, STUCK, "-n", workers, "-o", "faulthandler_timeout=5")
    assert "Timeout (0:00:05)!" in output
    assert "in test_that_never_ends" in output
    if workers != "0":
        assert "crashed while running 'test_file.py::test_that_never_ends'" in output
    assert seconds < 60


def test_the_time_limit_of_a_test_is_minutes(pytestconfig: pytest.Config) -> None:
    assert pytestconfig.getini("faulthandler_exit_on_timeout") is True
    assert float(pytestconfig.getini("faulthandler_timeout")) >= 600
