"""Slots that stay whole: what goes in comes out, and formulas give for each of eight what they give for one."""

from types import SimpleNamespace

import numpy as np
import taichi as ti
import taichi.math as tm

from taichi_cloth.kernels import maths, places
from taichi_cloth.kernels.layout import at, put_at
from taichi_cloth.kernels.whole import is_whole, kept_whole, kind_of, placed
from taichi_cloth.state import fields

STRIPS = SimpleNamespace(in_lanes=True)
out = ti.types.ndarray(dtype=ti.f32, ndim=2)


def make() -> tuple[ti.Field, ti.Field, ti.Field]:
    return fields.places(5, lanes=True), fields.numbers(5, lanes=True), fields.numbers(5, lanes=True, kind=ti.i32)


@ti.kernel
def read(x: ti.template(), w: ti.template(), pins: ti.template(), into: out):
    for place in range(5 * places.LANES):
        vector = at(STRIPS, x, place)
        for c in ti.static(range(3)):
            into[place, c] = vector[c]
        number, pin = w[place // places.LANES], pins[place // places.LANES]
        into[place, 3] = number[place % places.LANES]
        into[place, 4] = float(pin[place % places.LANES])


def test_a_place_and_a_number_in_each_lane() -> None:
    x, w, pins = placed(make)
    assert [is_whole(field) for field in (x, w, pins)] == [True] * 3
    assert (kind_of(w), kind_of(pins)) == (ti.f32, ti.i32)
    random = np.random.default_rng(0)
    given, numbers, whole = random.normal(size=(4, 3, 8)), random.normal(size=(5, 8)), random.integers(-9, 9, (5, 8))
    fields.put_all((x, given), (w, numbers), (pins, whole))

    @ti.kernel
    def move():
        put_at(STRIPS, x, 17, tm.vec3(1.0, 2.0, 3.0))

    found = np.zeros((40, 5), np.float32)
    with kept_whole(True):
        move()
        read(x, w, pins, found)
    wanted = np.zeros((5, 8, 3))
    wanted[:4] = given.transpose(0, 2, 1)
    wanted[2, 1] = 1.0, 2.0, 3.0  # slot 2, lane 1
    assert (found[:, :3] == wanted.reshape(-1, 3).astype(np.float32)).all()
    assert (found[:, 3] == numbers.ravel().astype(np.float32)).all()
    assert (found[:, 4] == whole.ravel()).all()


@ti.func
def formulas(a, b, number):
    """All that `places.py` and the plain formulas can do, in one place."""
    gap = places.choose(number > 0.0, b - a, places.minus(a))
    gap = gap + places.cross(a, b) * 0.5 + places.spread(tm.vec3(1.0, -2.0, 3.0), a)
    gap += maths.project_distance(gap, number * number + 1.0, places.size_of(number), 0.5)
    shift, _change = maths.project_compliant(gap, number * number, 0.1, 3.0, number, 0.5, 0.01)
    gap += shift + maths.friction_slide(shift, b, 0.3) + maths.out_of_box(a, b, b * b, 0.2)
    gap += maths.air_force(a, b, 0.6, 1.1, 0.7) + places.times(gap, maths.arc_wave(number))
    return gap + maths.out_of_sphere(gap, b, 2.0)


def test_eight_at_once_are_eight_one_by_one() -> None:
    a, b, result = placed(lambda: [fields.places(1, lanes=True) for _ in range(3)])
    w = placed(lambda: fields.numbers(1, lanes=True))
    random = np.random.default_rng(2)
    one, other, number = (random.normal(size=shape).astype(np.float32) for shape in ((3, 8), (3, 8), (8,)))
    fields.put_all((a, one[None]), (b, other[None]), (w, number[None]))

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
    with kept_whole(True):
        at_once()
    one_by_one(one, other, number, wanted)
    filler = placed(make)

    @ti.kernel
    def copy():
        for i in range(1):
            filler[0][i] = result[i]

    with kept_whole(True):
        copy()
        read(*filler, found)
    assert np.abs(wanted).min() > 0.0
    np.testing.assert_allclose(found[:8, :3], wanted, rtol=2e-6)
