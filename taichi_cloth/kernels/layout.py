"""Into the layout in which a frame is worked on, and back."""

from typing import Any

import taichi as ti
import taichi.math as tm

from .places import COMPONENTS, LANES, in_kind


def kept_by(layout: Any, stages: Any) -> Any:
    """The field that says how particles move."""
    return layout.velocity if stages.own_velocity else layout.x_prev


@ti.func
def load(work: ti.template(), cloth: ti.template(), stages: ti.template()):
    """Particles into strips; nothing to do where the particles themselves are worked on."""
    if ti.static(work.in_lanes):
        pitch, columns = work.pitch[None], work.columns[None]
        motion, motion_there = ti.static(kept_by(cloth, stages), kept_by(work, stages))
        for slot in range(work.slot_count[None]):
            row, place = slot // pitch, slot % pitch
            # An empty column is held at the origin, where nothing pulls at it.
            free, x = ti.Vector.zero(ti.f32, LANES), ti.Matrix.zero(ti.f32, COMPONENTS, LANES)
            moving = ti.Matrix.zero(ti.f32, COMPONENTS, LANES)  # velocity, or where it was
            for k in range(LANES):
                column = place + k * pitch
                if column < columns:
                    i = row * columns + column
                    free[k] = cloth.inverse_mass[i]
                    for c in range(3):
                        x[c, k] = cloth.x[i][c]
                        moving[c, k] = motion[i][c]
            work.inverse_mass[slot], work.x[slot] = free, x
            motion_there[slot] = moving


@ti.func
def store(work: ti.template(), cloth: ti.template(), stages: ti.template()):
    """Strips back into particles."""
    if ti.static(work.in_lanes):
        pitch, columns = work.pitch[None], work.columns[None]
        motion, motion_there = ti.static(kept_by(cloth, stages), kept_by(work, stages))
        for slot in range(work.slot_count[None]):
            row, place = slot // pitch, slot % pitch
            x, moving = work.x[slot], motion_there[slot]
            for k in range(LANES):
                column = place + k * pitch
                if column < columns:
                    i = row * columns + column
                    for c in range(3):
                        cloth.x[i][c] = x[c, k]
                        motion[i][c] = moving[c, k]


@ti.func
def at(cloth: ti.template(), field: ti.template(), place: int):
    """A vector of one particle; in strips its place is slot·8 + lane."""
    if ti.static(cloth.in_lanes):
        slot, lane = field[place // LANES], place % LANES
        return tm.vec3(slot[0, lane], slot[1, lane], slot[2, lane])
    else:
        return field[place]


@ti.func
def put_at(cloth: ti.template(), field: ti.template(), place: int, vector: tm.vec3):
    """Sets a vector of one particle."""
    if ti.static(cloth.in_lanes):
        slot = field[place // LANES]
        for c in ti.static(range(3)):
            slot[c, place % LANES] = vector[c]
        field[place // LANES] = slot
    else:
        field[place] = vector


@ti.func
def inverse_mass_at(cloth: ti.template(), place: int):
    if ti.static(cloth.in_lanes):
        slot = cloth.inverse_mass[place // LANES]
        return slot[place % LANES]
    else:
        return cloth.inverse_mass[place]


@ti.func
def slot_of(cloth: ti.template(), field: ti.template(), i: int):
    """What a field by place holds for the particle, or the eight particles, of slot i, as floats."""
    if ti.static(cloth.in_lanes):
        return ti.Matrix(
            [
                [float(field[i * LANES + k][c]) if ti.static(c < 3) else 0.0 for k in ti.static(range(LANES))]
                for c in ti.static(range(COMPONENTS))
            ]
        )
    else:
        return in_kind(field[i], ti.f32)
