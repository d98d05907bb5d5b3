"""Keeps whole triangles of the cloth out of round bodies that are `against` them: a ball smaller than a cell does not
slip between particles.

The point of a triangle that is nearest to the body is pushed out of it by moving the three corners, each by its share
in the point and its inverse mass. The strokes add up to one at that point: momentum and spin are those of a push there.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.controls import (
    BODY_FRICTION,
    BODY_FROM,
    BODY_SIZE,
    BODY_SWEPT,
    BODY_TO,
    BODY_TRIANGLES,
    BODY_TURN,
)
from ..kernels.maths import TINY, friction_slide
from ..kernels.motion import put_right
from ..kernels.poses import margin_at, posed, vector_at
from ..state.patches import COLOURS
from .nearest import NEAREST
from .shapes import axis_of, back, into

ROUND = tuple(NEAREST)  # the first kinds of the table
CORE = 0.25  # of a body's reach: a triangle that comes so near to its axis on its way is about to pass through it
STEPS = 24  # of such a test
PASSES = 4  # over all triangles after such tests: what one stroke moves may come to lie beyond the body in another


@ti.func
def passing(of: ti.template(), size: tm.vec3, core: float, a, b, c, way_a, way_b, way_c):
    """Whether a triangle on its way comes `core` [m] near to the body's axis, and if so the shares of its corners and
    the normal there. It goes on by the distance to the core, as no corner moves by more than its way.
    """
    fastest = ti.max(way_a.norm(), way_b.norm(), way_c.norm(), TINY)
    time, met = 0.0, False
    shares, away = of(size, a, b, c)
    for _ in range(STEPS):
        if time <= 1.0 and not met:
            shares, away = of(size, a + time * way_a, b + time * way_b, c + time * way_c)
            met = away.norm() < core
            time += ti.max(away.norm() - 0.8 * core, 0.0) / fastest
    return met, shares, away / ti.max(away.norm(), TINY)


@ti.func
def push_triangles_out(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """Moves every triangle out of the round bodies that are against them, where the scene has such."""
    if ti.static(stages.triangles):
        passes = ti.static(PASSES if stages.swept else 1)
        if ti.static(cloth.gathers):
            for _ in ti.static(range(passes)):
                push_each_out(cloth, stages, now)
        else:
            for _ in range(passes):
                push_each_out(cloth, stages, now)


@ti.func
def push_each_out(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """One body after another, and one triangle after another."""
    counts = ti.static((stages.spheres, stages.capsules))
    for k in ti.static(range(len(ROUND))):
        if ti.static(cloth.gathers):  # triangles of one colour share no particle
            for s in ti.static(range(sum(counts[:k]), sum(counts[: k + 1]))):
                for colour in ti.static(range(COLOURS)):
                    push_out_of_one(cloth, stages, now, k, s, colour, colour + 1)
        elif ti.static(counts[k] > 0):
            for s in range(ti.static(sum(counts[:k])), ti.static(sum(counts[: k + 1]))):
                if now.bodies[s, BODY_TRIANGLES] > 0.0:
                    push_out_of_one(cloth, stages, now, k, s, 0, COLOURS)


@ti.func
def push_out_of_one(
    cloth: ti.template(),
    stages: ti.template(),
    now: ti.template(),
    k: ti.template(),
    s: int,
    colour: ti.template(),
    end: ti.template(),
):
    """All triangles of some colours and one body, as the body sees them: its surface is at rest."""
    of = ti.static(NEAREST[ROUND[k]])
    table = ti.static(now.bodies)
    travel, turn = vector_at(table, s, BODY_TO) - vector_at(table, s, BODY_FROM), vector_at(table, s, BODY_TURN)
    reached, share = (now.s + 1.0) / now.substeps, now.lasts / now.substeps
    center, axes = posed(table, s, reached)
    center_before, axes_before = posed(table, s, reached - share)
    size, friction, swept = vector_at(table, s, BODY_SIZE), table[s, BODY_FRICTION], table[s, BODY_SWEPT]
    half, reach = ti.static(((0.0, size.x), (size.x, size.y))[k])
    reach += margin_at(table, s, reached)
    along_axis, own = axis_of(axes, 1), (travel.norm() + turn.norm() * (half + reach)) * share
    if ti.static(cloth.gathers):  # no loop in parallel may stand under an `if`
        reach *= ti.select(table[s, BODY_TRIANGLES] > 0.0, 1.0, 0.0)
    for t in range(cloth.patches.first[colour], cloth.patches.first[end]):
        i, j, m = cloth.patches.corners[t]
        p, q, r = cloth.x[i] - center, cloth.x[j] - center, cloth.x[m] - center
        off = p - along_axis * ti.min(ti.max(p.dot(along_axis), -half), half)
        far = reach + ti.sqrt(ti.max((q - p).norm_sqr(), (r - p).norm_sqr()))
        if ti.static(stages.swept):
            gone_p, gone_q = cloth.x_prev[i] - cloth.x[i], cloth.x_prev[j] - cloth.x[j]
            gone_r = cloth.x_prev[m] - cloth.x[m]
            far += ti.sqrt(ti.max(gone_p.norm_sqr(), gone_q.norm_sqr(), gone_r.norm_sqr())) + own
        if reach > 0.0 and off.norm_sqr() < far * far:  # most are not near
            a, b, c = into(axes, p), into(axes, q), into(axes, r)
            way_a = a - into(axes_before, cloth.x_prev[i] - center_before)
            way_b = b - into(axes_before, cloth.x_prev[j] - center_before)
            way_c = c - into(axes_before, cloth.x_prev[m] - center_before)
            shares, away = of(size, a, b, c)
            depth, normal = reach - away.norm(), away / ti.max(away.norm(), TINY)
            if away.norm() < TINY:  # the axis is in it
                normal = (b - a).cross(c - a).normalized()
            if ti.static(stages.swept):  # noqa: SIM102 (of the two only this one is known while compiling)
                if swept > 0.0:
                    core = CORE * reach
                    passes, shares_then, normal_then = passing(
                        of, size, core, a - way_a, b - way_b, c - way_c, way_a, way_b, way_c
                    )
                    along = normal_then.dot(shares_then.x * a + shares_then.y * b + shares_then.z * c)
                    if passes and along < core:
                        shares, normal, depth = shares_then, normal_then, reach - along
            if depth > 0.0:
                w = tm.vec3(cloth.inverse_mass[i], cloth.inverse_mass[j], cloth.inverse_mass[m])
                move = normal * depth
                if ti.static(now.pushes) and friction > 0.0:
                    slid = shares.x * way_a + shares.y * way_b + shares.z * way_c
                    move += friction_slide(normal * depth, slid + normal * depth, friction)
                stroke = back(axes, move) / ti.max((shares * shares * w).sum(), TINY)
                put_right(cloth, stages, now, i, stroke * (shares.x * w.x))
                put_right(cloth, stages, now, j, stroke * (shares.y * w.y))
                put_right(cloth, stages, now, m, stroke * (shares.z * w.z))
