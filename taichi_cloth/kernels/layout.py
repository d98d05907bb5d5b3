"""Into the layout in which a frame is worked on, and back."""

import taichi as ti
import taichi.math as tm

from .places import LANES


@ti.func
def load(work: ti.template(), cloth: ti.template(), stages: ti.template()):
    """Particles into strips; nothing to do where the particles themselves are worked on."""
    if ti.static(work.in_lanes):
        pitch, columns = work.pitch[None], work.columns[None]
        for slot in range(work.slot_count[None]):
            row, place = slot // pitch, slot % pitch
            for k in range(LANES):
                column = place + k * pitch
                if column < columns:
                    i = row * columns + column
                    work.inverse_mass[slot][k] = cloth.inverse_mass[i]
                    for c in range(3):
                        work.x[slot][c, k] = cloth.x[i][c]
                        if ti.static(stages.own_velocity):
                            work.velocity[slot][c, k] = cloth.velocity[i][c]
                        else:
                            work.x_prev[slot][c, k] = cloth.x_prev[i][c]
                else:  # an empty column: held at the origin, where nothing pulls at it
                    work.inverse_mass[slot][k] = 0.0
                    for c in range(3):
                        work.x[slot][c, k] = 0.0
                        work.x_prev[slot][c, k] = 0.0
                        work.velocity[slot][c, k] = 0.0


@ti.func
def store(work: ti.template(), cloth: ti.template(), stages: ti.template()):
    """Strips back into particles."""
    if ti.static(work.in_lanes):
        pitch, columns = work.pitch[None], work.columns[None]
        for slot in range(work.slot_count[None]):
            row, place = slot // pitch, slot % pitch
            for k in range(LANES):
                column = place + k * pitch
                if column < columns:
                    i = row * columns + column
                    for c in range(3):
                        cloth.x[i][c] = work.x[slot][c, k]
                        if ti.static(stages.own_velocity):
                            cloth.velocity[i][c] = work.velocity[slot][c, k]
                        else:
                            cloth.x_prev[i][c] = work.x_prev[slot][c, k]


@ti.func
def at(cloth: ti.template(), field: ti.template(), place: int):
    """A vector of one particle; in strips its place is slot·8 + lane."""
    if ti.static(cloth.in_lanes):
        slot, lane = place // LANES, place % LANES
        return tm.vec3(field[slot][0, lane], field[slot][1, lane], field[slot][2, lane])
    else:
        return field[place]


@ti.func
def put_at(cloth: ti.template(), field: ti.template(), place: int, vector: tm.vec3):
    """Sets a vector of one particle."""
    if ti.static(cloth.in_lanes):
        for c in range(3):
            field[place // LANES][c, place % LANES] = vector[c]
    else:
        field[place] = vector


@ti.func
def inverse_mass_at(cloth: ti.template(), place: int):
    if ti.static(cloth.in_lanes):
        return cloth.inverse_mass[place // LANES][place % LANES]
    else:
        return cloth.inverse_mass[place]


@ti.func
def slot_of(cloth: ti.template(), field: ti.template(), i: int):
    """What a field by place holds for the particle, or the eight particles, of slot i."""
    if ti.static(cloth.in_lanes):
        return ti.Matrix([[field[i * LANES + k][c] for k in ti.static(range(LANES))] for c in ti.static(range(3))])
    else:
        return field[i]
