"""Whether a cloth is still one, and a copy of it while it is."""

import taichi as ti

from .forces import velocity_of

EXPONENT = 0x7F800000  # all its bits set: infinite, or not a number


@ti.func
def is_finite(number: float) -> int:
    """By its bits: fast arithmetic takes it for granted that comparisons see numbers."""
    return int((ti.bit_cast(number, ti.i32) & EXPONENT) != EXPONENT)


@ti.func
def keep_one(cloth: ti.template(), stages: ti.template(), copy: ti.template(), i: int, h: float, most: float) -> int:
    """Copies what moves of a particle; 1 if its place is finite and it is not faster than `most` [m/s]."""
    x, speed = cloth.x[i], velocity_of(cloth, stages, i, h).norm()
    copy.x[i], copy.x_prev[i], copy.velocity[i] = x, cloth.x_prev[i], cloth.velocity[i]
    finite = is_finite(x.x) * is_finite(x.y) * is_finite(x.z) * is_finite(speed)
    return ti.select(speed > most, 0, finite)


@ti.kernel
def keep(
    cloth: ti.template(), stages: ti.template(), copy: ti.template(), threads: ti.template(), h: float, most: float
) -> int:
    """Copies all that moves; 1 if every particle is sound. One thread, where a second would cost more than it saves."""
    sound = 1
    if ti.static(threads):
        for i in range(cloth.slot_count[None]):
            ti.atomic_min(sound, keep_one(cloth, stages, copy, i, h, most))
    else:
        ti.loop_config(serialize=True)
        for _ in range(1):
            for i in range(cloth.slot_count[None]):
                sound = ti.min(sound, keep_one(cloth, stages, copy, i, h, most))
    return sound


@ti.kernel
def bring_back(cloth: ti.template(), copy: ti.template()):
    for i in range(cloth.slot_count[None]):
        cloth.x[i], cloth.x_prev[i], cloth.velocity[i] = copy.x[i], copy.x_prev[i], copy.velocity[i]
