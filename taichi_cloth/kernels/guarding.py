"""Whether a cloth is still one, and a copy of it while it is."""

import taichi as ti

from .forces import velocity_of

EXPONENT = 0x7F800000  # all its bits set: infinite, or not a number


@ti.func
def is_finite(number: float) -> int:
    """By its bits: fast arithmetic takes it for granted that comparisons see numbers."""
    return int((ti.bit_cast(number, ti.i32) & EXPONENT) != EXPONENT)


@ti.kernel
def keep_if_sound(cloth: ti.template(), stages: ti.template(), good: ti.template(), h: float, most: float) -> int:
    """1 where every place is finite and no particle faster than `most` [m/s]; then copies all that moves to `good`."""
    sound = 1
    for i in range(cloth.slot_count[None]):
        x, speed = cloth.x[i], velocity_of(cloth, stages, i, h).norm()
        fine = is_finite(x.x) * is_finite(x.y) * is_finite(x.z) * is_finite(speed)
        if fine == 0 or speed > most:
            ti.atomic_min(sound, 0)
    for i in range(cloth.slot_count[None]):
        if sound == 1:
            good.x[i], good.x_prev[i], good.velocity[i] = cloth.x[i], cloth.x_prev[i], cloth.velocity[i]
    return sound


@ti.kernel
def bring_back(cloth: ti.template(), good: ti.template()):
    for i in range(cloth.slot_count[None]):
        cloth.x[i], cloth.x_prev[i], cloth.velocity[i] = good.x[i], good.x_prev[i], good.velocity[i]
