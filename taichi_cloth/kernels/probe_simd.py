"""A small kernel on slots that stay whole, to see whether this Taichi compiles it right."""

import numpy as np
import taichi as ti

from .internals import SIMD, usable
from .places import COMPONENTS, LANES
from .whole import kept_whole, placed, whole_field

numbers = ti.types.ndarray(dtype=ti.f32, ndim=2)


@ti.kernel
def probe(field: ti.template(), given: numbers, out: numbers):
    """out = 2·given, by way of a slot."""
    ti.loop_config(serialize=True)
    for i in range(1):
        slot = ti.Matrix.zero(ti.f32, COMPONENTS, LANES)
        for k in range(LANES):
            for c in range(COMPONENTS):
                slot[c, k] = given[c, k]
        field[i] = slot
        field[i] = field[i] * 2.0
        slot = field[i]
        for k in range(LANES):
            for c in range(COMPONENTS):
                out[c, k] = slot[c, k]


def gives_right_numbers() -> bool:
    """Whether the probe does."""
    field = placed(lambda: whole_field((COMPONENTS, LANES), ti.f32, 1))
    given = np.arange(COMPONENTS * LANES, dtype=np.float32).reshape(COMPONENTS, LANES)
    out = np.zeros_like(given)
    with kept_whole(True):
        probe(field, given, out)
    return bool((out == 2 * given).all())


def simd_works() -> bool:
    """Whether cloth can be worked on eight particles at a time."""
    return usable(SIMD, gives_right_numbers)
