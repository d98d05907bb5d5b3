"""Into the layout in which a frame is worked on, and back."""

import taichi as ti

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
                    for c in ti.static(range(3)):
                        work.x[slot][c, k] = cloth.x[i][c]
                        if ti.static(stages.own_velocity):
                            work.velocity[slot][c, k] = cloth.velocity[i][c]
                        else:
                            work.x_prev[slot][c, k] = cloth.x_prev[i][c]
                else:  # an empty column: held at the origin, where nothing pulls at it
                    work.inverse_mass[slot][k] = 0.0
                    for c in ti.static(range(3)):
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
                    for c in ti.static(range(3)):
                        cloth.x[i][c] = work.x[slot][c, k]
                        if ti.static(stages.own_velocity):
                            cloth.velocity[i][c] = work.velocity[slot][c, k]
                        else:
                            cloth.x_prev[i][c] = work.x_prev[slot][c, k]
