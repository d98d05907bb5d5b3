"""Taichi works in one thread only: others are refused before anything breaks."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

import taichi_cloth as tc
from taichi_cloth.system import taichi_runtime
from taichi_cloth.system.taichi_runtime import check_thread

SCENE = {"cloth": {"rows": 5, "columns": 6}}
LINE = (
    "Taichi works only in the thread that started it: open and use simulations in one thread, or in processes;"
    " tc.init() starts it anew in this thread, and ends the simulations of the other"
)


@pytest.fixture(scope="module")
def pool() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(1) as executor:
        yield executor


@pytest.fixture
def simulation() -> Iterator[tc.Simulation]:
    with tc.Simulation(SCENE, "serial") as opened:
        yield opened


CALLS: dict[str, Callable[[tc.Simulation], object]] = {
    "open": lambda simulation: tc.Simulation(SCENE, "serial"),
    "open a new grid": lambda simulation: tc.Simulation({"cloth": {"rows": 7}}, "serial"),
    "step": lambda simulation: simulation.step(),
    "positions": lambda simulation: simulation.positions(),
    "metrics": lambda simulation: simulation.metrics(),
    "grab": lambda simulation: simulation.grab(3),
    "params": lambda simulation: simulation.params.update(gravity=1.0),
    "set_state": lambda simulation: simulation.set_state(simulation.topology.start),
    "reset": lambda simulation: simulation.reset(),
    "pin": lambda simulation: simulation.pin(3),
    "switch_solver": lambda simulation: simulation.switch_solver("xpbd"),
    "image": lambda simulation: tc.render_image(simulation, (32, 18)),
    "image of another size": lambda simulation: tc.render_image(simulation, (64, 36), "strain"),
}


@pytest.mark.parametrize("name", CALLS)
def test_another_thread_is_refused_and_changes_nothing(
    pool: ThreadPoolExecutor, simulation: tc.Simulation, name: str
) -> None:
    grab = simulation.grab(20)
    simulation.step(2)
    with pytest.raises(tc.UsageError) as caught:
        pool.submit(CALLS[name], simulation).result()
    assert str(caught.value) == LINE
    assert grab.active
    simulation.step(2)
    with tc.Simulation(SCENE, "serial") as again:
        again.grab(20)
        again.step(4)
        assert (simulation.positions() == again.positions()).all()


def test_a_simulation_may_be_closed_by_another_thread(pool: ThreadPoolExecutor, simulation: tc.Simulation) -> None:
    pool.submit(simulation.close).result()
    assert simulation.closed
    with tc.Simulation(SCENE, "serial") as again:
        again.step()


def test_a_later_thread_is_another_even_if_it_gets_the_same_id(
    simulation: tc.Simulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = threading.Thread(target=simulation.positions)
    assert taichi_runtime._started is not None
    monkeypatch.setattr(taichi_runtime, "_started", (taichi_runtime._started[0], first))
    monkeypatch.setattr(first, "_ident", threading.get_ident())  # as if it had ended, and this one had its id
    with pytest.raises(tc.UsageError) as caught:
        check_thread()
    assert str(caught.value) == LINE


def test_the_check_takes_less_than_a_microsecond_of_a_frame() -> None:
    from timeit import repeat

    assert min(repeat(check_thread, number=1000, repeat=5)) / 1000 < 1e-6  # [s]; a frame makes a few


FIRST_USE_IN_THREADS = f"""
import io
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stdout
from threading import Barrier
import taichi_cloth as tc
together = Barrier(4)

def run(rows):
    together.wait()
    try:
        with tc.Simulation({{"cloth": {{"rows": rows, "columns": 5}}}}, "serial") as simulation:
            simulation.step()
            return "stepped"
    except tc.UsageError as error:
        return str(error)

with ThreadPoolExecutor(4) as pool:
    found = sorted(pool.map(run, range(5, 9)))
assert found == [{LINE!r}] * 3 + ["stepped"], found
tc.init()  # moves Taichi to this thread
with tc.Simulation({SCENE!r}, "serial") as simulation:
    simulation.step()

def restarted_by_its_own_means():
    import taichi as ti
    ti.reset()
    with redirect_stdout(io.StringIO()):
        ti.init(arch=ti.cpu)
    with tc.Simulation({SCENE!r}, "serial") as simulation:
        simulation.step()

with ThreadPoolExecutor(1) as pool:
    pool.submit(restarted_by_its_own_means).result()
"""


def test_of_threads_that_use_it_first_at_the_same_time_one_works() -> None:
    done = subprocess.run([sys.executable, "-c", FIRST_USE_IN_THREADS], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout + done.stderr == ""


IMAGE_FIRST_IN_A_THREAD = f"""
from concurrent.futures import ThreadPoolExecutor
import taichi_cloth as tc
scene = tc.load_scene("drape15", rows=6, columns=7)  # its colliders are drawn
with tc.Simulation(scene) as simulation, ThreadPoolExecutor(1) as pool:
    simulation.step()
    try:
        pool.submit(tc.render_image, simulation).result()
    except tc.UsageError as error:
        assert str(error) == {LINE!r}
    simulation.step()
    with tc.Simulation({SCENE!r}) as other:
        other.step()
    tc.render_image(simulation)
"""


def test_a_first_image_in_another_thread_changes_nothing() -> None:
    done = subprocess.run([sys.executable, "-c", IMAGE_FIRST_IN_A_THREAD], capture_output=True, text=True)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


FORKED = f"""
import multiprocessing, sys, warnings
import taichi_cloth as tc
warnings.simplefilter("ignore", DeprecationWarning)  # Python 3.12 warns of a fork while threads run

def job(known, answers):
    try:
        if known:
            simulation.step()
        else:
            tc.Simulation({SCENE!r}, "serial")
    except tc.UsageError as error:
        answers.put(str(error))
    else:
        answers.put("")

simulation = tc.Simulation({SCENE!r}, "serial")
simulation.step()
context = multiprocessing.get_context("fork")
for known in (True, False):
    answers = context.SimpleQueue()
    child = context.Process(target=job, args=(known, answers))
    child.start()
    assert answers.get().startswith("Taichi does not work in a process forked from one that used it"), known
    child.join(60)
simulation.step()
simulation.close()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows has no fork")
def test_a_process_forked_after_a_simulation_has_run_is_refused_and_does_not_hang() -> None:
    done = subprocess.run([sys.executable, "-c", FORKED], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")
