"""Keeps particles out of spheres, boxes and the ground by moving them to the surface, with friction."""

import taichi as ti
import taichi.math as tm

from ..kernels.controls import (
    BOX_CENTER,
    BOX_FRICTION,
    BOX_HALF,
    BOX_MARGIN,
    GROUND_FRICTION,
    GROUND_HEIGHT,
    SPHERE_FRICTION,
    SPHERE_FROM,
    SPHERE_REACH,
    SPHERE_TO,
)
from ..kernels.maths import friction_slide, out_of_box, out_of_sphere
from ..kernels.motion import put_right
from ..kernels.places import join, part, spread, times


@ti.func
def vector_at(table: ti.template(), row: int, column: int) -> tm.vec3:
    """Three neighbouring columns of a table as a vector."""
    return tm.vec3(table[row, column], table[row, column + 1], table[row, column + 2])


@ti.func
def push_out(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """Moves every free particle out of the scene's colliders, one collider after another."""
    if ti.static(cloth.gathers):  # one parallel loop for each collider: in a loop over them they would race
        for s in ti.static(range(stages.spheres)):
            out_of_one_sphere(cloth, stages, now, s)
        for s in ti.static(range(stages.boxes)):
            out_of_one_box(cloth, stages, now, s)
    else:
        if ti.static(stages.spheres > 0):
            for s in range(now.spheres.shape[0]):
                out_of_one_sphere(cloth, stages, now, s)
        if ti.static(stages.boxes > 0):
            for s in range(now.boxes.shape[0]):
                out_of_one_box(cloth, stages, now, s)
    if ti.static(stages.ground):
        for i in range(cloth.slot_count[None]):
            x = cloth.x[i]
            up = ti.max(now.ground[0, GROUND_HEIGHT] - part(x, 1), 0.0)
            push = join(up * 0.0, up, up * 0.0, x)
            follow(cloth, stages, now, i, push, tm.vec3(0.0), now.ground[0, GROUND_FRICTION])


@ti.func
def out_of_one_sphere(cloth: ti.template(), stages: ti.template(), now: ti.template(), s: int):
    """A sphere travels in a straight line from its first to its last place of the frame."""
    travel = vector_at(now.spheres, s, SPHERE_TO) - vector_at(now.spheres, s, SPHERE_FROM)
    center = vector_at(now.spheres, s, SPHERE_FROM) + travel * ((now.s + 1.0) / now.substeps)
    reach, friction = now.spheres[s, SPHERE_REACH], now.spheres[s, SPHERE_FRICTION]
    for i in range(cloth.slot_count[None]):
        x = cloth.x[i]
        push = out_of_sphere(x, spread(center, x), reach)
        follow(cloth, stages, now, i, push, travel * (now.lasts / now.substeps), friction)


@ti.func
def out_of_one_box(cloth: ti.template(), stages: ti.template(), now: ti.template(), s: int):
    center, half = vector_at(now.boxes, s, BOX_CENTER), vector_at(now.boxes, s, BOX_HALF)
    for i in range(cloth.slot_count[None]):
        x = cloth.x[i]
        push = out_of_box(x, spread(center, x), spread(half, x), now.boxes[s, BOX_MARGIN])
        follow(cloth, stages, now, i, push, tm.vec3(0.0), now.boxes[s, BOX_FRICTION])


@ti.func
def follow(
    cloth: ti.template(), stages: ti.template(), now: ti.template(), i: int, push, travel: tm.vec3, friction: float
):
    """Moves a free particle by a push out of a surface, and against sliding on it.

    `travel` is how far the surface moved in this substep [m].
    """
    free = ti.select(cloth.inverse_mass[i] > 0.0, 1.0, 0.0)
    move = push
    if friction > 0.0:
        slid = cloth.x[i] + push - cloth.x_prev[i] - spread(travel, push)
        move += friction_slide(push, slid, friction)
    put_right(cloth, stages, now, i, times(move, free))
