"""The particle that a hand holds: it has no inverse mass and is led along a straight line through the frame."""

import taichi as ti
import taichi.math as tm

from .controls import GRAB_FROM, GRAB_TO


@ti.func
def lead_held(cloth: ti.template(), stages: ti.template(), now: ti.template(), steps: float):
    """Puts the held particle where the hand is after so many substeps of the frame; forces see the hand's velocity."""
    controls = ti.static(now.controls)
    held = now.held
    if held >= 0:
        start = tm.vec3(controls[GRAB_FROM], controls[GRAB_FROM + 1], controls[GRAB_FROM + 2])
        end = tm.vec3(controls[GRAB_TO], controls[GRAB_TO + 1], controls[GRAB_TO + 2])
        place = start + (end - start) * (steps / now.substeps)
        velocity = (end - start) / (now.h * now.substeps)
        if ti.static(cloth.in_lanes):
            columns, pitch = cloth.columns[None], cloth.pitch[None]
            column = held % columns
            slot = held // columns * pitch + column % pitch
            for c in ti.static(range(3)):
                cloth.x[slot][c, column // pitch] = place[c]
                if ti.static(stages.own_velocity):
                    cloth.velocity[slot][c, column // pitch] = velocity[c]
        else:
            cloth.x[held] = place
            if ti.static(stages.own_velocity):
                cloth.velocity[held] = velocity


@ti.kernel
def set_inverse_mass(cloth: ti.template(), i: int, inverse_mass: float):
    cloth.inverse_mass[i] = inverse_mass
