"""Ties to the pins that hold only when they are taut (Kim, Chentanez and Müller 2012, *Long range attachments*)."""

import taichi as ti

from .controls import TETHER_SLACK
from .layout import at
from .maths import TINY
from .motion import put_right
from .places import LANES, length, times


@ti.func
def tether_shift(gap, most):
    """Shift that brings a place at `gap` from a pin back to the distance `most`; 0 where it is no farther."""
    return times(gap, ti.min(most / ti.max(length(gap), TINY), 1.0) - 1.0)


@ti.func
def look_up_pins(cloth: ti.template(), ties: ti.template()):
    """Where the pins are now that the particles in strips are tied to."""
    for n in range(ties.count[None] * cloth.slot_count[None]):
        pins, places = ties.pin[n], ties.place[n]
        for k in range(LANES):
            x = at(cloth, cloth.x, pins[k])
            for c in ti.static(range(3)):
                places[c, k] = x[c]
        ties.place[n] = places


@ti.func
def pin_of(cloth: ti.template(), n: int):
    """Where the pin of tether n is."""
    if ti.static(cloth.in_lanes):
        return cloth.ties.place[n]
    else:
        return cloth.x[cloth.ties.pin[n]]


@ti.func
def pull_tethers(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """Takes every free particle back to where its tethers reach, and its leash, where the scene has some.

    Pins do not move; within a frame they do only where a hand or a grip leads them.
    """
    if ti.static(stages.tethers):
        if ti.static(cloth.in_lanes):
            if now.s == 0 or now.held > 0 or ti.static(stages.grips):
                look_up_pins(cloth, cloth.ties)
        for i in range(cloth.slot_count[None]):
            free = ti.select(cloth.inverse_mass[i] > 0.0, 1.0, 0.0)
            x, move = cloth.x[i], cloth.x[i] * 0.0
            for t in range(cloth.ties.count[None]):
                n = t * cloth.slot_count[None] + i
                gap = x + move - pin_of(cloth, n)
                move += times(tether_shift(gap, cloth.ties.reach[n] * now.controls[TETHER_SLACK]), free)
            put_right(cloth, stages, now, i, move)
    if ti.static(stages.leashes):
        for i in range(cloth.slot_count[None]):
            free = ti.select(cloth.inverse_mass[i] > 0.0, 1.0, 0.0)
            gap = cloth.x[i] - cloth.leashes.place[i]
            put_right(cloth, stages, now, i, times(tether_shift(gap, cloth.leashes.reach[i]), free))
