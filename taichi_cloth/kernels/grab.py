"""The particle that a hand holds: it has no inverse mass and is led along a straight line through the frame."""

import taichi as ti
import taichi.math as tm

from .controls import GRAB_FROM, GRAB_TO


@ti.func
def lead_held(cloth: ti.template(), held: int, controls: ti.template(), passed: float):
    """Puts the held particle where the hand is when the share `passed` of the frame is over; held < 0: no hand."""
    if held >= 0:
        start = tm.vec3(controls[GRAB_FROM], controls[GRAB_FROM + 1], controls[GRAB_FROM + 2])
        end = tm.vec3(controls[GRAB_TO], controls[GRAB_TO + 1], controls[GRAB_TO + 2])
        cloth.x[held] = start + (end - start) * passed


@ti.kernel
def set_inverse_mass(cloth: ti.template(), i: int, inverse_mass: float):
    cloth.inverse_mass[i] = inverse_mass
