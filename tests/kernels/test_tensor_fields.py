"""Tensor fields: they return what was stored, and formulas give the same for each of eight particles as for one."""

from types import SimpleNamespace

import numpy as np
import pytest
import taichi as ti
import taichi.math as tm

from taichi_cloth.kernels import constraint_math as maths
from taichi_cloth.kernels import vec
from taichi_cloth.kernels.layout import read, write
from taichi_cloth.kernels.tensor_fields import is_tensor_field, materialized, scalar_dtype
from taichi_cloth.state import field_pool as fields
from taichi_cloth.system.taichi_compat import no_scalarization

pytestmark = pytest.mark.bounds

SIMD = SimpleNamespace(is_simd=True)
out = ti.types.ndarray(dtype=ti.f32, ndim=2)


def make() -> tuple[ti.Field, ti.Field, ti.Field]:
    return (
        fields.vector_field(5, simd=True),
        fields.scalar_field(5, simd=True),
        fields.scalar_field(5, simd=True, dtype=ti.i32),
    )


@ti.kernel
def read_back(x: ti.template(), w: ti.template(), pins: ti.template(), into: out):
    for i in range(5 * vec.LANES):
        vector = read(SIMD, x, i)
        for c in ti.static(range(3)):
            into[i, c] = vector[c]
        number, pin = w[i // vec.LANES], pins[i // vec.LANES]
        into[i, 3] = number[i % vec.LANES]
        into[i, 4] = float(pin[i % vec.LANES])


def test_vectors_and_scalars_are_stored_in_every_lane() -> None:
    x, w, pins = materialized(make)
    assert [is_tensor_field(field) for field in (x, w, pins)] == [True] * 3
    assert (scalar_dtype(w), scalar_dtype(pins)) == (ti.f32, ti.i32)
    random = np.random.default_rng(0)
    given, numbers, whole = random.normal(size=(4, 3, 8)), random.normal(size=(5, 8)), random.integers(-9, 9, (5, 8))
    fields.upload_all((x, given), (w, numbers), (pins, whole))

    @ti.kernel
    def move():
        write(SIMD, x, 17, tm.vec3(1.0, 2.0, 3.0))

    found = np.zeros((40, 5), np.float32)
    with no_scalarization(True):
        move()
        read_back(x, w, pins, found)
    wanted = np.zeros((5, 8, 3))
    wanted[:4] = given.transpose(0, 2, 1)
    wanted[2, 1] = 1.0, 2.0, 3.0  # packet 2, lane 1
    assert (found[:, :3] == wanted.reshape(-1, 3).astype(np.float32)).all()
    assert (found[:, 3] == numbers.ravel().astype(np.float32)).all()
    assert (found[:, 4] == whole.ravel()).all()


@ti.func
def formulas(a, b, number):
    """Use all functions of `vec.py` and the formulas of `constraint_math.py`."""
    gap = vec.select(number > 0.0, b - a, vec.neg(a))
    gap = gap + vec.cross(a, b) * 0.5 + vec.broadcast(tm.vec3(1.0, -2.0, 3.0), a)
    gap += maths.project_distance(gap, number * number + 1.0, vec.abs_(number), 0.5)
    shift, _change = maths.project_distance_xpbd(gap, number * number, 0.1, 3.0, number, 0.5, 0.01)
    gap += shift + maths.friction_correction(shift, b, 0.3) + maths.push_out_of_box(a, b, b * b, 0.2)
    gap += maths.wind_force(a, b, 0.6, 1.1, 0.7) + vec.scale(gap, maths.parabolic_wave(number))
    return gap + maths.push_out_of_sphere(gap, b, 2.0)


def test_eight_particles_at_once_match_one_by_one() -> None:
    a, b, result = materialized(lambda: [fields.vector_field(1, simd=True) for _ in range(3)])
    w = materialized(lambda: fields.scalar_field(1, simd=True))
    random = np.random.default_rng(2)
    one, other, number = (random.normal(size=shape).astype(np.float32) for shape in ((3, 8), (3, 8), (8,)))
    fields.upload_all((a, one[None]), (b, other[None]), (w, number[None]))

    @ti.kernel
    def at_once():
        for i in range(1):
            result[i] = formulas(a[i], b[i], w[i])

    @ti.kernel
    def one_by_one(a: out, b: out, w: ti.types.ndarray(dtype=ti.f32, ndim=1), into: out):
        for k in range(8):
            found = formulas(tm.vec3(a[0, k], a[1, k], a[2, k]), tm.vec3(b[0, k], b[1, k], b[2, k]), w[k])
            for c in ti.static(range(3)):
                into[k, c] = found[c]

    wanted, found = np.zeros((8, 3), np.float32), np.zeros((40, 5), np.float32)
    with no_scalarization(True):
        at_once()
    one_by_one(one, other, number, wanted)
    filler = materialized(make)

    @ti.kernel
    def copy():
        for i in range(1):
            filler[0][i] = result[i]

    with no_scalarization(True):
        copy()
        read_back(*filler, found)
    assert np.abs(wanted).min() > 0.0
    np.testing.assert_allclose(found[:8, :3], wanted, rtol=2e-6)


@pytest.mark.parametrize("lane", [*range(vec.LANES), None])
def test_a_number_within_the_bound_is_found_in_every_lane(lane: int | None) -> None:
    w = materialized(lambda: fields.scalar_field(1, simd=True))
    numbers = np.full((1, vec.LANES), 1.5)
    if lane is not None:
        numbers[0, lane] = 1.0  # the bound itself counts

    @ti.kernel
    def find() -> int:
        return vec.any_at_most(w[0], 1.0)

    fields.upload_all((w, numbers))
    with no_scalarization(True):
        assert find() == (lane is not None)
