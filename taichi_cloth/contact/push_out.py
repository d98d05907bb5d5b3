"""Keeps particles out of the scene's colliders by moving them to the surface, with friction.

A body that is `swept` also stops what would be through it or past it by the end of a substep.
"""

import taichi as ti

from ..kernels.controls import (
    BODY_FRICTION,
    BODY_FROM,
    BODY_SIZE,
    BODY_SWEPT,
    BODY_TO,
    BODY_TURN,
)
from ..kernels.maths import friction_slide
from ..kernels.motion import put_right
from ..kernels.places import choose, cross, dot, spread, times
from ..kernels.poses import margin_at, posed, vector_at
from ..scene.model import PROJECTION
from .responses import reflect
from .shapes import SHAPES, back, into
from .sweeps import MEETINGS
from .table import rows_of
from .triangles import push_triangles_out

KINDS = tuple(SHAPES)
THIN = 1e-4  # [m] within the margin: what lies on it begins outside, however it is rounded


@ti.func
def push_out(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """Moves every free particle out of the colliders that project, one after another, then triangles; the velocities of
    what others reflect are turned round.
    """
    for k in ti.static(range(len(KINDS))):
        if ti.static(cloth.gathers):  # one parallel loop for each collider: in a loop over them they would race
            for s in ti.static(range(*rows_of(stages, PROJECTION, k))):
                out_of_one(cloth, stages, now, k, s)
        elif ti.static(getattr(stages, KINDS[k]) > 0):
            for s in range(ti.static(rows_of(stages, PROJECTION, k)[0]), ti.static(rows_of(stages, PROJECTION, k)[1])):
                out_of_one(cloth, stages, now, k, s)
    push_triangles_out(cloth, stages, now)
    if ti.static(now.pushes):
        reflect(cloth, stages, now)


@ti.func
def out_of_one(cloth: ti.template(), stages: ti.template(), now: ti.template(), k: ti.template(), s: int):
    """Within a frame a body goes straight on and turns about one axis."""
    out_of = ti.static(SHAPES[KINDS[k]])
    table = ti.static(now.bodies)
    travel, turn = vector_at(table, s, BODY_TO) - vector_at(table, s, BODY_FROM), vector_at(table, s, BODY_TURN)
    reached, share = (now.s + 1.0) / now.substeps, now.lasts / now.substeps
    center, axes = posed(table, s, reached)
    size, margin, friction = vector_at(table, s, BODY_SIZE), margin_at(table, s, reached), table[s, BODY_FRICTION]
    center_before, axes_before = center, axes
    if ti.static(stages.swept):
        center_before, axes_before = posed(table, s, reached - share)
    for i in range(cloth.slot_count[None]):
        x = cloth.x[i]
        away = x - spread(center, x)
        push = out_of(stages, axes, size, margin, away)
        if ti.static(stages.swept):  # noqa: SIM102 (of the two only this one is known while compiling)
            if table[s, BODY_SWEPT] > 0.0:
                begun = into(axes_before, cloth.x_prev[i] - spread(center_before, x))
                way = into(axes, away) - begun
                time, normal = ti.static(MEETINGS[KINDS[k]])(stages, size, margin - THIN, begun, way)
                along = way - times(normal, dot(normal, way))  # at the surface it can only go on along it
                stopped = back(axes, begun + times(way, time) + times(along, 1.0 - time))
                push = choose(time <= 1.0, stopped - away + out_of(stages, axes, size, margin, stopped), push)
        move = push
        if ti.static(now.pushes) and friction > 0.0:
            surface = spread(travel * share, x) + cross(spread(turn * share, x), away + push)
            move += friction_slide(push, x + push - cloth.x_prev[i] - surface, friction)
            if ti.static(stages.swept):  # across a long push, and so perhaps into the body
                move += out_of(stages, axes, size, margin, away + move)
        free = ti.select(cloth.inverse_mass[i] > 0.0, 1.0, 0.0)
        put_right(cloth, stages, now, i, times(move, free))
