"""Jobs in worker processes."""

import signal
import subprocess
import sys
import time
from multiprocessing import active_children
from pathlib import Path

import pytest

from taichi_cloth.evaluation.worker_pool import ignore_interrupts, run_parallel

# A parent process with two jobs of an hour; each prints a line when it runs.
PARENT = """
import os
import time
from taichi_cloth.evaluation.worker_pool import run_parallel

def job(number):
    os.write(1, b"runs\\n")  # at once: two processes write
    time.sleep(3600)

def begin():
    pass

if __name__ == "__main__":
    list(run_parallel(job, {0: (0,), 1: (1,)}, 2, begin))
"""


def test_results_are_yielded_as_they_complete() -> None:
    found = dict(run_parallel(pow, {3: (2, 3), 5: (2, 5)}, 2, int))
    assert found == {3: 8, 5: 32}


def test_closing_terminates_the_processes() -> None:
    results = run_parallel(time.sleep, {0: (0.0,), 1: (3600.0,)}, 2, int)
    assert next(results) == (0, None)
    results.close()
    assert active_children() == []


def test_jobs_end_with_their_parent_process(tmp_path: Path) -> None:
    """A killed parent cannot stop its jobs. They hold its stdout open until the last of them ends."""
    path = tmp_path / "parent.py"
    path.write_text(PARENT, encoding="utf-8")
    parent = subprocess.Popen([sys.executable, str(path)], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    assert [parent.stdout.readline() for _ in range(2)] == ["runs\n", "runs\n"]
    parent.kill()
    left, _ = parent.communicate(timeout=60)
    assert left == ""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not pass signals to children")
def test_jobs_ignore_ctrl_c() -> None:
    ask = [sys.executable, "-c", "import signal; print(signal.getsignal(signal.SIGINT) is signal.SIG_IGN)"]
    before = signal.getsignal(signal.SIGINT)
    with ignore_interrupts():
        assert subprocess.check_output(ask, text=True) == "True\n"
    assert signal.getsignal(signal.SIGINT) is before
    assert subprocess.check_output(ask, text=True) == "False\n"
