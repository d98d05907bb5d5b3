"""Restarts of Taichi while objects of the previous program exist: no crash, and no memory is freed twice.

Each runs in its own process, so that a crash fails the test instead of ending the worker.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]

HEAD = """
import gc, weakref
import numpy as np, taichi as ti
from taichi_cloth.system import taichi_runtime as runtime
from taichi_cloth.scene.schema import Cloth, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.taichi_compat import DeviceArray

def scene(solver="explicit"):
    return Scene(cloth=Cloth(rows=4, columns=4), solver=Solver(solver, substeps=10))

def mapped(address):
    with open("/proc/self/maps") as maps:
        spans = (line.split()[0].split("-") for line in maps)
        return any(int(a, 16) <= address < int(b, 16) for a, b in spans)

def addresses(arrays):
    program = ti.lang.impl.get_runtime().prog
    return [program.get_ndarray_data_ptr_as_int(array.arr) for array in arrays]
"""


reads_maps = pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs /proc/self/maps")


@pytest.fixture
def survives(program: Run) -> Callable[[str], None]:
    """survives(code): checks that the program exits normally, not by a signal."""

    def check(code: str) -> None:
        done = program("-c", HEAD + code)
        assert (done.returncode, done.stderr) == (0, "")

    return check


@reads_maps
@pytest.mark.parametrize("new", ["serial", "parallel"])
@pytest.mark.parametrize("collecting", ["enable", "disable"])
def test_a_program_that_ends_while_simulations_are_open(
    survives: Callable[[str], None], new: str, collecting: str
) -> None:
    """The pool of SIMD layouts is used in the first program and late in the second: no fields of the first may remain.

    Arrays are allocated between those of the simulations, so that addresses may coincide.
    """
    survives(f"""
gc.{collecting}()
runtime.start("cpu", random_seed=0)
old = [DeviceArray((100,)) for _ in range(150)]
Simulation(scene(), "simd").close()
simulation = Simulation(scene(), "parallel")
simulation.step()
old += [DeviceArray((100,)) for _ in range(150)]
runtime.stop()
runtime.start("cpu", random_seed=0)
new = [DeviceArray((100,)) for _ in range(50)]
other = Simulation(scene(), "{new}")
other.step()
new += [DeviceArray((100,)) for _ in range(250)]
x = other.positions()
at = addresses(new)
old.clear()
del simulation
Simulation(scene(), "simd").close()
gc.collect()
assert all(map(mapped, at))
assert (other.positions() == x).all()
other.set_state(x)
other.step()
assert np.isfinite(other.positions()).all()
""")


ARRAYS = """
runtime.start("cpu", offline_cache=False)
old = [DeviceArray((100,)) for _ in range(200)]
{end}
new = [DeviceArray((100,)) for _ in range(200)]
at = addresses(new)
assert sum(map(mapped, at)) == 200
deleted = []
Program = type(ti.lang.impl.get_runtime().prog)
delete = Program.delete_ndarray
Program.delete_ndarray = lambda program, array: deleted.append(array)
old.clear()
gc.collect()
assert deleted == []  # these addresses may belong to other arrays now
Program.delete_ndarray = delete
assert sum(map(mapped, at)) == 200
for array in new:
    array.from_numpy(np.ones(100, np.float32))
    assert (array.to_numpy() == 1).all()
"""


@reads_maps
@pytest.mark.parametrize(
    "end",
    [
        'runtime.stop(); runtime.start("cpu", offline_cache=False)',
        'runtime.start("cpu", offline_cache=False)',
        "ti.reset(); ti.init(ti.cpu, offline_cache=False, log_level=ti.ERROR)",
    ],
)
def test_arrays_that_outlive_their_program_free_nothing_of_the_next(survives: Callable[[str], None], end: str) -> None:
    survives(ARRAYS.format(end=end))


@pytest.mark.parametrize("layout", ["serial", "simd", "parallel"])
@pytest.mark.parametrize("end", ["runtime.stop()", 'runtime.start("cpu")', "ti.reset()"])
def test_a_simulation_whose_program_has_ended_raises(survives: Callable[[str], None], layout: str, end: str) -> None:
    survives(f"""
runtime.start("cpu")
simulation = Simulation(scene(), "{layout}")
simulation.step()
assert not simulation.closed
{end}
assert simulation.closed
changes = [simulation.step, simulation.reset, lambda: simulation.pin(7),
           lambda: simulation.set_state(simulation.topology.start)]
for use in (*changes, simulation.positions, simulation.metrics, lambda: simulation.save("a")):
    try:
        use()
    except RuntimeError as error:
        assert str(error).startswith("Taichi was stopped or restarted"), error
    else:
        raise AssertionError(use)
simulation.close()
simulation.close()
del simulation
runtime.start("cpu")
with Simulation(scene(), "{layout}") as simulation:
    simulation.step()
""")


@reads_maps
def test_a_closed_simulation_frees_its_arrays_at_once(survives: Callable[[str], None]) -> None:
    survives("""
gc.disable()
runtime.start("cpu")
simulation = Simulation(scene(), "parallel")
simulation.step()
runner = weakref.ref(simulation.solver.runner)
at = addresses(array for array, _ in simulation.solver.runner._arrays.values())
assert len(at) == 2 and all(map(mapped, at))
simulation.close()
assert runner() is None
assert not any(map(mapped, at))
""")


@pytest.mark.parametrize(
    ("keep", "named"),
    [
        ("kept = ti.lang.impl.get_runtime().prog", "__main__: kept"),
        ("kept = [ti.lang.impl.get_runtime().prog]", "a builtins.list"),
        (
            "class Keeper: pass\nkept = Keeper(); kept.program = ti.lang.impl.get_runtime().prog",
            "a __main__.Keeper",
        ),
    ],
)
@pytest.mark.parametrize("end", ["runtime.stop()", 'runtime.start("cpu")'])
def test_the_error_names_what_refers_to_an_ended_program(
    survives: Callable[[str], None], keep: str, named: str, end: str
) -> None:
    survives(f"""
runtime.start("cpu")
{keep}
for _ in range(2):  # refused until the reference is gone
    try:
        {end}
    except RuntimeError as error:
        assert str(error) == "Taichi's program has ended but is still referenced by {named}", error
    else:
        raise AssertionError("no error was raised")
del kept
runtime.start("cpu")
runtime.stop()
""")
