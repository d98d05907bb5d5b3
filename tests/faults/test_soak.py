"""Rare events, repeated: hundreds of starts, thousands of simulations, many processes with one kernel cache.

Memory is the resident set of a separate process. It may grow by what Taichi itself leaks, which is measured too.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from taichi_cloth.system.taichi_runtime import INDEX, LOCK, is_index_consistent

linux = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="no /proc to read memory from")
pytestmark = pytest.mark.long

HEAD = """
import gc, os, sys
import numpy as np, taichi as ti
from taichi_cloth.system import taichi_runtime as runtime
from taichi_cloth.scene.schema import Cloth, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation

def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20  # [MiB]

def scene(solver="explicit", rows=4, columns=8):
    return Scene(cloth=Cloth(rows=rows, columns=columns), solver=Solver(solver, substeps=4))
"""


def output_of(code: str, seconds: float = 3000, **environment: str) -> str:
    """Return the stdout of a program, which must exit with 0 and print nothing on stderr."""
    command = [sys.executable, "-c", HEAD + code]
    done = subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True, timeout=seconds)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


STARTS = 200
SETTLED = 40  # starts after which pools and caches are filled

# One kernel and one field, started as often: what Taichi itself leaks.
TAICHI_ALONE = f"""
for k in range({STARTS}):
    runtime.start("cpu", random_seed=0)
    ti.field(ti.f32, 64).fill(1.0)
    runtime.stop()
    if k == {SETTLED}:
        before = resident()
print((resident() - before) / ({STARTS} - 1 - {SETTLED}))
"""

# Simulations are dropped while their program runs, right after it, and some programs later; layouts in turn.
WITH_SIMULATIONS = f"""
gc.{{collecting}}()
old, end = [], None
for k in range({STARTS}):
    runtime.start("cpu", random_seed=0)
    simulation = Simulation(scene(), ("serial", "simd", "parallel")[k % 3])
    simulation.step()
    end = simulation.positions() if end is None else end
    assert np.abs(simulation.positions() - end).max() < 1e-5
    if k % 7 == 0:
        simulation.close()
    if k % 5:
        runtime.stop()  # otherwise the next start stops it
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
    print(f"a start leaks {taichi:.2f} MiB in Taichi alone and {ours:.2f} MiB with a simulation")
    assert taichi < 1.0
    assert (
        ours < {"enable": 1.0, "disable": 3.0}[collecting]
    )  # Taichi leaves reference cycles, such as the tree of a kernel


MANY = """
runtime.start("cpu", random_seed=0)
sizes = [(4, 8), (5, 9), (3, 12)]
layouts = ["serial", "simd", "parallel"]
def one(k):
    rows, columns = sizes[k % 3]
    simulation = Simulation(scene(rows=rows, columns=columns), layouts[k // 3 % 3])
    if k % 7 == 0:
        simulation.step()
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


# Prints the positions, to be compared; the cache is written when Taichi ends.
ONE_OF_MANY = """
runtime.start("cpu", random_seed=0)
for layout in ("serial", "simd"):
    with Simulation(scene(), layout) as simulation:
        for _ in range(3):
            simulation.step()
        print(layout, simulation.positions().tobytes().hex())
runtime.stop()
"""


def started(cache: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache)}
    command = [sys.executable, "-c", HEAD + ONE_OF_MANY]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def killed_while_writing(cache: Path) -> bool:
    """Start a process and kill it while it holds the lock of the folder. Return whether that succeeded."""
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
    for turn in ("cold", "warm", "after one was killed", "after its lock became stale"):
        if turn == "after one was killed":
            for kernel in tmp_path.glob("**/*.tic"):
                kernel.write_bytes(kernel.read_bytes()[:-50])  # they are compiled and written again
            assert any(killed_while_writing(tmp_path) for _ in range(20))
        if turn == "after its lock became stale":
            for file in (*tmp_path.glob(f"**/{LOCK}"), *tmp_path.glob("**/*.tic")):
                os.utime(file, 2 * (time.time() - 3600,))
        for process in [started(tmp_path) for _ in range(8)]:
            out, errors = process.communicate(timeout=600)
            assert (process.returncode, errors) == (0, ""), turn
            seen.add(out)
        for index in tmp_path.glob(f"**/{INDEX}"):
            assert is_index_consistent(index.read_bytes())
    assert len(seen) == 1  # the same positions, to the last bit
    assert not any(tmp_path.glob(f"**/{LOCK}"))
