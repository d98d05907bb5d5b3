"""`make bounds` runs the tests of kernels and contact with index checks: these must really be on."""

import os
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
import taichi as ti

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.kernels.tensor_fields import materialized, tensor_field
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system import taichi_runtime as runtime
from taichi_cloth.system.taichi_compat import no_scalarization

pytestmark = pytest.mark.bounds

row = ti.types.ndarray(dtype=ti.f32, ndim=1)


@ti.kernel
def of_field(field: ti.template(), i: ti.i32) -> ti.f32:
    return field[i]


@ti.kernel
def of_array(array: row, i: ti.i32) -> ti.f32:
    return array[i]


@ti.kernel
def of_packets(field: ti.template(), i: ti.i32) -> ti.f32:
    packet = field[i]
    return packet[0]


def reads() -> list[Callable[[int], float]]:
    field, packets = ti.field(ti.f32, 4), materialized(lambda: tensor_field((8,), ti.f32, 4))

    def of_tensor_field(i: int) -> float:
        with no_scalarization(True):
            return float(of_packets(packets, i))

    return [lambda i: of_field(field, i), lambda i: of_array(np.zeros(4, np.float32), i), of_tensor_field]


@pytest.fixture
def checked() -> Iterator[None]:
    """Run Taichi as `make bounds` does."""
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
@pytest.mark.parametrize("bend", [0.0, 1.0], ids=["two packets", "four"])
@pytest.mark.parametrize(("solver", "rows", "columns"), [("lines", 40, 8), ("lines", 2, 40), ("explicit", 40, 8)])
def test_the_simd_layout_stays_within_its_fields(solver: str, rows: int, columns: int, bend: float) -> None:
    """`lines` has the largest halo behind its fields."""
    scene = load_scene("curtain", rows=rows, columns=columns, solver=solver, substeps=2)
    scene = replace(scene, fabric=replace(scene.fabric, bend_spring=bend))
    with Simulation(replace(scene, wind=None, spheres=(), ground=None), "simd") as simulation:
        simulation.step()
        assert simulation.metrics().finite
