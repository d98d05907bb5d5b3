"""Contact of whole triangles with colliders that `collide_with` them: one smaller than a cell cannot slip between
particles.

The point of a triangle that is closest to the core of the collider (a sphere's center, a capsule's segment) is
projected to the margin by moving the three vertices, each by its weight in that point and its inverse mass. The
corrections add up to one at the point, so linear and angular momentum are those of a push there.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.constraint_math import TINY, friction_correction
from ..kernels.integration import margin_at, motion_at, pose_at, project_position, vec3_at
from ..kernels.step_params import (
    COLLIDER_CONTINUOUS,
    COLLIDER_FRICTION,
    COLLIDER_SIZE,
    COLLIDER_TRIANGLES,
)
from ..kernels.vec import neg
from ..scene.collider_schema import PROJECTION
from ..state.contact_data import TRIANGLE_COLORS
from .colliders import SURFACE_TOLERANCE, table_range
from .shapes import SHAPES
from .shapes.shape import axis, to_local, to_world
from .static_friction import add_friction

CORE = 0.25  # of the contact distance: a triangle that comes this close to the core is about to pass through it
TRACE_STEPS = 24  # of a continuous test
PASSES = 4  # over all triangles with continuous tests: a correction may push a neighbor beyond the collider


@ti.func
def passes_core(closest: ti.template(), size: tm.vec3, core: float, a, b, c, path_a, path_b, path_c):
    """Return whether a moving triangle comes within `core` [m] of the collider's core, and the weights and normal
    there.

    Conservative advancement: no vertex moves further than its path.
    """
    fastest = ti.max(path_a.norm(), path_b.norm(), path_c.norm(), TINY)
    time, hit = 0.0, False
    weights, offset = closest(size, a, b, c)
    for _ in range(TRACE_STEPS):
        if time <= 1.0 and not hit:
            weights, offset = closest(size, a + time * path_a, b + time * path_b, c + time * path_c)
            hit = offset.norm() < core
            time += ti.max(offset.norm() - 0.8 * core, 0.0) / fastest
    return hit, weights, offset / ti.max(offset.norm(), TINY)


TRIANGLE_SHAPES = tuple(k for k, shape in enumerate(SHAPES) if shape.closest_on_triangle is not None)


@ti.func
def project_triangles(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Project every triangle out of the colliders that collide with triangles."""
    if ti.static(features.triangles):
        passes = ti.static(PASSES if features.continuous else 1)
        if ti.static(cloth.is_parallel):
            for _ in ti.static(range(passes)):
                project_once(cloth, features, ctx)
        else:
            for _ in range(passes):
                project_once(cloth, features, ctx)


@ti.func
def project_once(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    for k in ti.static(TRIANGLE_SHAPES):
        if ti.static(cloth.is_parallel):  # triangles of one color share no particle
            for row in ti.static(range(*table_range(features.colliders, PROJECTION, k))):
                for color in ti.static(range(TRIANGLE_COLORS)):
                    project_out_of_collider(cloth, features, ctx, ti.static(SHAPES[k]), row, color, color + 1)
        elif ti.static(features.colliders[PROJECTION][k] > 0):
            for row in range(
                ti.static(table_range(features.colliders, PROJECTION, k)[0]),
                ti.static(table_range(features.colliders, PROJECTION, k)[1]),
            ):
                if ctx.colliders[row, COLLIDER_TRIANGLES] > 0.0:
                    project_out_of_collider(cloth, features, ctx, ti.static(SHAPES[k]), row, 0, TRIANGLE_COLORS)


@ti.func
def project_out_of_collider(
    cloth: ti.template(),
    features: ti.template(),
    ctx: ti.template(),
    shape: ti.template(),
    row: int,
    color: ti.template(),
    last_color: ti.template(),
):
    """Project the triangles of some colors out of one collider, in the collider's moving frame."""
    closest = ti.static(shape.closest_on_triangle)
    table = ti.static(ctx.colliders)
    end, fraction = (ctx.s + 1.0) / ctx.substeps, ctx.dt_scale / ctx.substeps
    travel, rotation = motion_at(table, row, end - 0.5 * fraction)
    center, axes = pose_at(table, row, end)
    start_center, start_axes = pose_at(table, row, end - fraction)
    size, friction = vec3_at(table, row, COLLIDER_SIZE), table[row, COLLIDER_FRICTION]
    continuous = table[row, COLLIDER_CONTINUOUS]
    half, contact_distance = shape.core(size)
    contact_distance += margin_at(table, row, end)
    along = axis(axes, 1)
    own_path = (travel.norm() + rotation.norm() * (half + contact_distance)) * fraction
    if ti.static(cloth.is_parallel):  # a parallel loop must be outermost, not under an `if`
        contact_distance *= ti.select(table[row, COLLIDER_TRIANGLES] > 0.0, 1.0, 0.0)
    for t in range(cloth.colored_triangles.first[color], cloth.colored_triangles.first[last_color]):
        i, j, m = cloth.colored_triangles.corners[t]
        p, q, r = cloth.x[i] - center, cloth.x[j] - center, cloth.x[m] - center
        from_core = p - along * ti.min(ti.max(p.dot(along), -half), half)
        far = contact_distance + ti.sqrt(ti.max((q - p).norm_sqr(), (r - p).norm_sqr()))
        if ti.static(features.continuous):
            back_p, back_q = cloth.x_prev[i] - cloth.x[i], cloth.x_prev[j] - cloth.x[j]
            back_r = cloth.x_prev[m] - cloth.x[m]
            far += ti.sqrt(ti.max(back_p.norm_sqr(), back_q.norm_sqr(), back_r.norm_sqr())) + own_path
        if contact_distance > 0.0 and from_core.norm_sqr() < far * far:  # most triangles are far away
            a, b, c = to_local(axes, p), to_local(axes, q), to_local(axes, r)
            path_a = a - to_local(start_axes, cloth.x_prev[i] - start_center)
            path_b = b - to_local(start_axes, cloth.x_prev[j] - start_center)
            path_c = c - to_local(start_axes, cloth.x_prev[m] - start_center)
            weights, offset = closest(size, a, b, c)
            depth, normal = contact_distance - offset.norm(), offset / ti.max(offset.norm(), TINY)
            if offset.norm() < TINY:  # the triangle contains a point of the core
                normal = (b - a).cross(c - a).normalized()
            if ti.static(features.continuous):  # noqa: SIM102 (only this condition is known while compiling)
                if continuous > 0.0:
                    core = CORE * contact_distance
                    passed, weights_then, normal_then = passes_core(
                        closest, size, core, a - path_a, b - path_b, c - path_c, path_a, path_b, path_c
                    )
                    level = normal_then.dot(weights_then.x * a + weights_then.y * b + weights_then.z * c)
                    if passed and level < core:
                        weights, normal, depth = weights_then, normal_then, contact_distance - level
            touching = depth > 0.0
            if ti.static(features.friction_sums):  # springs may have lifted it since the last iteration
                pushed = cloth.friction_sums.triangle_push[t].norm() > 0.0
                touching = touching or (depth > neg(SURFACE_TOLERANCE) and pushed)
            if touching:
                push = normal * ti.max(depth, 0.0)
                w = tm.vec3(cloth.inverse_mass[i], cloth.inverse_mass[j], cloth.inverse_mass[m])
                move = push
                if ti.static(ctx.update_velocity) and friction > 0.0:
                    slid = weights.x * path_a + weights.y * path_b + weights.z * path_c
                    slide = slid + push
                    if ti.static(features.friction_sums):
                        push_sums = ti.static(cloth.friction_sums.triangle_push)
                        sums = ti.static(cloth.friction_sums.triangle_friction)
                        push, normal, slide = to_world(axes, push), to_world(axes, normal), to_world(axes, slide)
                        correction = add_friction(push_sums, sums, t, push, normal, slide, friction, 1.0)
                        move += to_local(axes, correction)
                    else:
                        move += friction_correction(push, slide, friction)
                impulse = to_world(axes, move) / ti.max((weights * weights * w).sum(), TINY)
                project_position(cloth, features, ctx, i, impulse * (weights.x * w.x))
                project_position(cloth, features, ctx, j, impulse * (weights.y * w.y))
                project_position(cloth, features, ctx, m, impulse * (weights.z * w.z))
