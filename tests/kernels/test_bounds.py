"""`make bounds` runs the tests of kernels and contact with every index checked: the check must really be on."""

import os
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
import taichi as ti

from taichi_cloth import runtime
from taichi_cloth.kernels.whole import kept_whole, placed, whole_field
from taichi_cloth.scene import load_scene
from taichi_cloth.simulation import Simulation

row = ti.types.ndarray(dtype=ti.f32, ndim=1)


@ti.kernel
def of_field(field: ti.template(), i: ti.i32) -> ti.f32:
    return field[i]


@ti.kernel
def of_array(array: row, i: ti.i32) -> ti.f32:
    return array[i]


@ti.kernel
def of_slots(field: ti.template(), i: ti.i32) -> ti.f32:
    slot = field[i]
    return slot[0]


def reads() -> list[Callable[[int], float]]:
    field, slots = ti.field(ti.f32, 4), placed(lambda: whole_field((8,), ti.f32, 4))

    def of_whole(i: int) -> float:
        with kept_whole(True):
            return float(of_slots(slots, i))

    return [lambda i: of_field(field, i), lambda i: of_array(np.zeros(4, np.float32), i), of_whole]


@pytest.fixture
def checked() -> Iterator[None]:
    """Taichi as `make bounds` has it."""
    if os.environ.get("TI_DEBUG") != "1":
        runtime.start("cpu", debug=True)
        yield
        runtime.start("cpu", random_seed=0)
    else:
        yield


@pytest.mark.usefixtures("checked")
def test_an_index_out_of_range_is_an_error() -> None:
    for read in reads():
        assert read(3) == 0
        for index in (4, -1):
            with pytest.raises(RuntimeError, match=rf"(indices \({index}\)|indices \[{index}\])"):
                read(index)


@pytest.mark.skipif(os.environ.get("TI_DEBUG") != "1", reason="make bounds runs it")
@pytest.mark.parametrize("bend", [0.0, 1.0], ids=["two slots", "four"])
@pytest.mark.parametrize(("solver", "rows", "columns"), [("lines", 40, 8), ("lines", 2, 40), ("spring", 40, 8)])
def test_strips_stay_within_their_fields(solver: str, rows: int, columns: int, bend: float) -> None:
    """`lines` in strips has the most slots behind its fields."""
    scene = load_scene("curtain", rows=rows, columns=columns, solver=solver, substeps=2)
    scene = replace(scene, fabric=replace(scene.fabric, bend=bend))
    with Simulation(replace(scene, wind=None, spheres=(), ground=None), "lanes") as simulation:
        simulation.advance_frame()
        assert simulation.measure().finite
