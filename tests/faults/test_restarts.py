"""Taichi is ended and started anew while things of the last program are there: no crash, and no memory freed twice.

Each runs in a process of its own: a crash is then a failed test and not a dead worker.
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
from taichi_cloth import runtime
from taichi_cloth.scene.model import Cloth, Scene, Solver, Sphere
from taichi_cloth.simulation import Simulation
from taichi_cloth.state.device_array import DeviceArray

def scene(solver="spring"):
    return Scene(cloth=Cloth(rows=4, columns=4), solver=Solver(solver, substeps=10))

def mapped(address):
    with open("/proc/self/maps") as maps:
        spans = (line.split()[0].split("-") for line in maps)
        return any(int(a, 16) <= address < int(b, 16) for a, b in spans)

def addresses(arrays):
    program = ti.lang.impl.get_runtime().prog
    return [program.get_ndarray_data_ptr_as_int(array.arr) for array in arrays]
"""


reads_maps = pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="no map of memory to read")


@pytest.fixture
def survives(program: Run) -> Callable[[str], None]:
    """survives(code): it ends by itself, and not by a signal."""

    def check(code: str) -> None:
        done = program("-c", HEAD + code)
        assert (done.returncode, done.stderr) == (0, "")

    return check


@reads_maps
@pytest.mark.parametrize("new", ["list", "gather"])
@pytest.mark.parametrize("collecting", ["enable", "disable"])
def test_a_program_that_ends_while_simulations_are_open(
    survives: Callable[[str], None], new: str, collecting: str
) -> None:
    """The pool of strips is used in the first program, and late in the second: what it kept must not go only then.

    Arrays stand between the simulations' own, for addresses to meet.
    """
    survives(f"""
gc.{collecting}()
runtime.start("cpu", random_seed=0)
old = [DeviceArray((100,)) for _ in range(150)]
Simulation(scene(), "lanes").close()
simulation = Simulation(scene(), "gather")
simulation.advance_frame()
old += [DeviceArray((100,)) for _ in range(150)]
runtime.stop()
runtime.start("cpu", random_seed=0)
new = [DeviceArray((100,)) for _ in range(50)]
other = Simulation(scene(), "{new}")
other.advance_frame()
new += [DeviceArray((100,)) for _ in range(250)]
x = other.positions()
at = addresses(new)
old.clear()
del simulation
Simulation(scene(), "lanes").close()
gc.collect()
assert all(map(mapped, at))
assert (other.positions() == x).all()
other.place(x)
other.advance_frame()
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
assert deleted == []  # whatever is at these addresses now
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


@pytest.mark.parametrize("path", ["list", "lanes", "gather"])
@pytest.mark.parametrize("end", ["runtime.stop()", 'runtime.start("cpu")', "ti.reset()"])
def test_a_simulation_whose_program_has_ended_says_so(survives: Callable[[str], None], path: str, end: str) -> None:
    survives(f"""
runtime.start("cpu")
simulation = Simulation(scene(), "{path}")
simulation.advance_frame()
assert not simulation.closed
{end}
assert simulation.closed
changes = [simulation.advance_frame, simulation.reset, lambda: simulation.pin(7),
           lambda: simulation.place(simulation.topology.start)]
for use in (*changes, simulation.positions, simulation.measure, lambda: simulation.save("a")):
    try:
        use()
    except RuntimeError as error:
        assert str(error).startswith("Taichi was stopped or started anew"), error
    else:
        raise AssertionError(use)
simulation.close()
simulation.close()
del simulation
runtime.start("cpu")
with Simulation(scene(), "{path}") as simulation:
    simulation.advance_frame()
""")


@reads_maps
def test_a_closed_simulation_frees_its_arrays_at_once(survives: Callable[[str], None]) -> None:
    survives("""
gc.disable()
runtime.start("cpu")
simulation = Simulation(scene(), "gather")
simulation.advance_frame()
launches = weakref.ref(simulation.solver.launches)
at = addresses(array for array, _ in simulation.solver.launches._arrays.values())
assert len(at) == 2 and all(map(mapped, at))
simulation.close()
assert launches() is None
assert not any(map(mapped, at))
""")


@pytest.mark.parametrize(
    ("keep", "told"),
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
def test_who_keeps_an_ended_program_is_named(survives: Callable[[str], None], keep: str, told: str, end: str) -> None:
    survives(f"""
runtime.start("cpu")
{keep}
for _ in range(2):  # it stays refused until it is gone
    try:
        {end}
    except RuntimeError as error:
        assert str(error) == "Taichi's program has ended, and is still referred to by {told}", error
    else:
        raise AssertionError("nobody noticed")
del kept
runtime.start("cpu")
runtime.stop()
""")
