"""What happens seldom, made often: hundreds of starts, thousands of simulations, many processes on one kernel cache.

Memory is the resident set of a process of its own. It may grow by what Taichi itself loses, which is measured beside.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from taichi_cloth.kernel_cache import INDEX, LOCK, index_is_sound

linux = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="no /proc to read memory from")
pytestmark = pytest.mark.long

HEAD = """
import gc, os, sys
import numpy as np, taichi as ti
from taichi_cloth import runtime
from taichi_cloth.scene.model import Cloth, Scene, Solver
from taichi_cloth.simulation import Simulation

def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20  # [MiB]

def scene(solver="spring", rows=4, columns=8):
    return Scene(cloth=Cloth(rows=rows, columns=columns), solver=Solver(solver, substeps=4))
"""


def output_of(code: str, seconds: float = 3000, **environment: str) -> str:
    """What a program prints that must end well and say nothing on stderr."""
    command = [sys.executable, "-c", HEAD + code]
    done = subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True, timeout=seconds)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


STARTS = 200
SETTLED = 40  # starts after which pools and caches have what they need

# One kernel and one field, started as often: what Taichi loses by itself.
TAICHI_ALONE = f"""
for k in range({STARTS}):
    runtime.start("cpu", random_seed=0)
    ti.field(ti.f32, 64).fill(1.0)
    runtime.stop()
    if k == {SETTLED}:
        before = resident()
print((resident() - before) / ({STARTS} - 1 - {SETTLED}))
"""

# Simulations are dropped while their program runs, right after it, and some programs later; one of each path in turn.
WITH_SIMULATIONS = f"""
gc.{{collecting}}()
old, end = [], None
for k in range({STARTS}):
    runtime.start("cpu", random_seed=0)
    simulation = Simulation(scene(), ("list", "lanes", "gather")[k % 3])
    simulation.advance_frame()
    end = simulation.positions() if end is None else end
    assert np.abs(simulation.positions() - end).max() < 1e-5
    if k % 7 == 0:
        simulation.close()
    if k % 5:
        runtime.stop()  # else the next start does
    old.append(simulation)
    del simulation
    if len(old) > 4:
        del old[k % 4]
    if k == {SETTLED}:
        before = resident()
print((resident() - before) / ({STARTS} - 1 - {SETTLED}))
"""


@linux
@pytest.mark.parametrize("collecting", ["enable", "disable"])
def test_hundreds_of_starts_with_simulations_open(collecting: str) -> None:
    taichi = float(output_of(TAICHI_ALONE))
    ours = float(output_of(WITH_SIMULATIONS.format(collecting=collecting)))
    print(f"a start loses {taichi:.2f} MiB in Taichi alone and {ours:.2f} MiB with a simulation")
    assert taichi < 1.0
    assert ours < {"enable": 1.0, "disable": 3.0}[collecting]  # what Taichi leaves in cycles, a kernel's tree for one


MANY = """
runtime.start("cpu", random_seed=0)
sizes = [(4, 8), (5, 9), (3, 12)]
paths = ["list", "lanes"]
def one(k):
    rows, columns = sizes[k % 3]
    simulation = Simulation(scene(rows=rows, columns=columns), paths[k // 3 % 2])
    if k % 7 == 0:
        simulation.advance_frame()
    if k % 11:
        simulation.close()
    assert np.isfinite(simulation.positions()).all() if k % 11 == 0 else simulation.closed
for k in range(1000):
    one(k)
gc.collect()
before = resident()
for k in range(10_000):
    one(k)
gc.collect()
print(resident() - before)
"""


@linux
def test_thousands_of_simulations_opened_and_closed() -> None:
    growth = float(output_of(MANY))
    print(f"10,000 simulations: {growth:.1f} MiB")
    assert growth < 20.0


# Prints the places, to be compared; the cache is written when Taichi ends.
ONE_OF_MANY = """
runtime.start("cpu", random_seed=0)
for path in ("list", "lanes"):
    with Simulation(scene(), path) as simulation:
        for _ in range(3):
            simulation.advance_frame()
        print(path, simulation.positions().tobytes().hex())
runtime.stop()
"""


def started(cache: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache)}
    command = [sys.executable, "-c", HEAD + ONE_OF_MANY]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def killed_while_writing(cache: Path) -> bool:
    """Starts one more and kills it while it holds the lock of the folder. Whether that came about."""
    process = started(cache)
    while process.poll() is None:
        if any(cache.glob(f"**/{LOCK}")):
            process.send_signal(signal.SIGKILL)
            process.communicate()
            return any(cache.glob(f"**/{LOCK}"))
    process.communicate()
    return False


@pytest.mark.skipif(os.name != "posix", reason="no SIGKILL")
def test_eight_processes_on_one_kernel_cache(tmp_path: Path) -> None:
    seen = set()
    for turn in ("cold", "warm", "after one was killed", "after its lock was taken away"):
        if turn == "after one was killed":
            for kernel in tmp_path.glob("**/*.tic"):
                kernel.write_bytes(kernel.read_bytes()[:-50])  # they are compiled and written again
            assert any(killed_while_writing(tmp_path) for _ in range(20))
        if turn == "after its lock was taken away":
            for lock in tmp_path.glob(f"**/{LOCK}"):
                os.utime(lock, 2 * (time.time() - 3600,))
        for process in [started(tmp_path) for _ in range(8)]:
            out, errors = process.communicate(timeout=600)
            assert (process.returncode, errors) == (0, ""), turn
            seen.add(out)
        for index in tmp_path.glob(f"**/{INDEX}"):
            assert index_is_sound(index.read_bytes())
    assert len(seen) == 1  # the same places, to the last bit
    assert not any(tmp_path.glob(f"**/{LOCK}"))
