"""Jobs in processes of their own."""

import signal
import subprocess
import sys
import time
from multiprocessing import active_children
from pathlib import Path

import pytest

from taichi_cloth.side_by_side import deaf_children, side_by_side

# A parent that has two jobs of an hour begun, and prints a line when each runs.
PARENT = """
import time
from taichi_cloth.side_by_side import side_by_side

def job(number):
    print("runs", flush=True)
    time.sleep(3600)

def begin():
    pass

if __name__ == "__main__":
    list(side_by_side(job, {0: (0,), 1: (1,)}, 2, begin))
"""


def test_results_come_as_they_are_done() -> None:
    found = dict(side_by_side(pow, {3: (2, 3), 5: (2, 5)}, 2, int))
    assert found == {3: 8, 5: 32}


def test_closing_ends_the_processes() -> None:
    results = side_by_side(time.sleep, {0: (0.0,), 1: (3600.0,)}, 2, int)
    assert next(results) == (0, None)
    results.close()
    assert active_children() == []


def test_jobs_end_with_the_process_that_began_them(tmp_path: Path) -> None:
    """A killed parent tells nobody. Its jobs hold its output open: it ends when the last of them has."""
    path = tmp_path / "parent.py"
    path.write_text(PARENT, encoding="utf-8")
    parent = subprocess.Popen([sys.executable, str(path)], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    assert [parent.stdout.readline() for _ in range(2)] == ["runs\n", "runs\n"]
    parent.kill()
    left, _ = parent.communicate(timeout=60)
    assert left == ""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows passes no signals on")
def test_jobs_do_not_hear_ctrl_c() -> None:
    ask = [sys.executable, "-c", "import signal; print(signal.getsignal(signal.SIGINT) is signal.SIG_IGN)"]
    before = signal.getsignal(signal.SIGINT)
    with deaf_children():
        assert subprocess.check_output(ask, text=True) == "True\n"
    assert signal.getsignal(signal.SIGINT) is before
    assert subprocess.check_output(ask, text=True) == "False\n"
