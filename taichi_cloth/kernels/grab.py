"""Particles that are led: they have no inverse mass, and are where a hand or a grip is."""

import taichi as ti
import taichi.math as tm

from .controls import BODY_FROM, BODY_TO, BODY_TURN, HANDS
from .layout import put_at
from .poses import posed, vector_at


@ti.func
def lead(cloth: ti.template(), stages: ti.template(), place: int, x: tm.vec3, velocity: tm.vec3):
    put_at(cloth, cloth.x, place, x)
    if ti.static(stages.own_velocity):
        put_at(cloth, cloth.velocity, place, velocity)


@ti.func
def lead_held(cloth: ti.template(), stages: ti.template(), now: ti.template(), steps: float):
    """Puts pins that move, and what hands hold, where they are after so many substeps of the frame.

    Forces see their velocity. A hand goes straight on; it wins over a grip.
    """
    share, seconds = steps / now.substeps, now.h * now.substeps
    if ti.static(stages.grips):
        for n in range(cloth.grips.count[None]):
            row = ti.static(stages.bodies) + cloth.grips.body[n]
            center, axes = posed(now.bodies, row, share)
            away = axes @ cloth.grips.local[n]
            travel = vector_at(now.bodies, row, BODY_TO) - vector_at(now.bodies, row, BODY_FROM)
            velocity = (travel + vector_at(now.bodies, row, BODY_TURN).cross(away)) / seconds
            lead(cloth, stages, cloth.grips.place[n], center + away, velocity)
    controls = ti.static(now.controls)
    for n in range(now.held):
        hand = HANDS + 6 * cloth.held.hand[n]
        gone = tm.vec3(controls[hand], controls[hand + 1], controls[hand + 2])
        way = tm.vec3(controls[hand + 3], controls[hand + 4], controls[hand + 5]) - gone
        # From where it was taken, and not from the hand: while the hand is still no bit of it changes.
        lead(cloth, stages, cloth.held.place[n], cloth.held.taken[n] + (gone + way * share), way / seconds)
