"""Contact of particles with colliders. A collider's `response` is one of three:

- projection: move the particle to the margin, with Coulomb friction. A `continuous` collider also stops a particle
  that would end a substep on its other side.
- reflection: contact with restitution. Reverse the normal velocity of a particle within the margin, times the
  restitution.
- repulsion: a penalty force, proportional to the depth.

The last two do not project the position. With reflection a particle sinks in by its motion in one substep, and further
under a steady load; with repulsion, until the force carries the cloth.

Depenetration: a collider that appears around particles, or touches triangles that collide with it, starts with its
margin reduced by their largest depth, and the margin then grows. Projecting all particles to the full margin at once
would give them a high velocity; moving each of them slowly would stretch springs, which snap back later.
"""

from collections.abc import Callable, Sequence

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..kernels.constraint_math import TINY, friction_correction
from ..kernels.integration import apply_impulse, margin_at, motion_at, pose_at, project_position, vec3_at
from ..kernels.layout import velocity_of
from ..kernels.step_params import (
    AREA_DENSITY,
    COLLIDER_CONTINUOUS,
    COLLIDER_FRICTION,
    COLLIDER_RESTITUTION,
    COLLIDER_SIZE,
    COLLIDER_STIFFNESS,
)
from ..kernels.vec import any_at_most, any_nonzero, broadcast, cross, dot, is_scalar, length, scale, select
from ..scene.collider_schema import PROJECTION, REFLECTION, REPULSION, Collider, Ground
from .colliders import (
    SURFACE_TOLERANCE,
    Floats,
    collides_with_triangles,
    pose_colliders,
    signed_distance,
    table_range,
    teleports,
    triangle_distance,
)
from .shapes import SHAPES
from .shapes.shape import to_local, to_world
from .static_friction import add_friction
from .triangle_collision import project_triangles


@ti.func
def for_each_collider(
    cloth: ti.template(),
    features: ti.template(),
    ctx: ti.template(),
    response: ti.template(),
    act: ti.template(),
    time: float,
):
    """Call `act(cloth, features, ctx, shape, row, time)` for every collider with this response.

    `time`: in substeps since the start of the frame. In the parallel layout each collider has a parallel loop of its
    own: in a loop over colliders they would race.
    """
    for k in ti.static(range(len(SHAPES))):
        if ti.static(cloth.is_parallel):
            for row in ti.static(range(*table_range(features.colliders, response, k))):
                act(cloth, features, ctx, ti.static(SHAPES[k]), row, time)
        elif ti.static(features.colliders[response][k] > 0):
            for row in range(
                ti.static(table_range(features.colliders, response, k)[0]),
                ti.static(table_range(features.colliders, response, k)[1]),
            ):
                act(cloth, features, ctx, ti.static(SHAPES[k]), row, time)


@ti.func
def resolve_contacts(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Project particles, then triangles, out of colliders, and reflect velocities, at the end of a substep."""
    for_each_collider(cloth, features, ctx, PROJECTION, project, ctx.s + 1.0)
    project_triangles(cloth, features, ctx)
    if ti.static(ctx.update_velocity):
        for_each_collider(cloth, features, ctx, REFLECTION, reflect, ctx.s + 1.0)


@ti.func
def stop_in_contact(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Make velocities those of cloth in contact, at the end of a frame.

    Forces accelerate a particle on a collider in every substep, and the next projection stops it. Between them is the
    end of the frame: without this, cloth at rest would be reported to move into the collider, and cloth that friction
    holds to slide.
    """
    for_each_collider(cloth, features, ctx, PROJECTION, stop, float(ctx.substeps))


@ti.func
def add_repulsion(cloth: ti.template(), features: ti.template(), ctx: ti.template(), time: float):
    """Add the penalty force [N] of every repelling collider at a time, in substeps since the start of the frame."""
    for_each_collider(cloth, features, ctx, REPULSION, repel, time)


@ti.func
def project(cloth: ti.template(), features: ti.template(), ctx: ti.template(), shape: ti.template(), row: int, time):
    """Project every particle to the margin of one collider."""
    table = ti.static(ctx.colliders)
    end, fraction = time / ctx.substeps, ctx.dt_scale / ctx.substeps  # of the frame: its end, and the step's length
    travel, rotation = motion_at(table, row, end - 0.5 * fraction)
    center, axes = pose_at(table, row, end)
    size, margin = vec3_at(table, row, COLLIDER_SIZE), margin_at(table, row, end)
    friction = table[row, COLLIDER_FRICTION]
    start_center, start_axes = center, axes
    if ti.static(features.continuous):
        start_center, start_axes = pose_at(table, row, end - fraction)
    for i in range(cloth.packet_count[None]):
        x = cloth.x[i]
        offset = x - broadcast(center, x)
        near = shape.push_out(features, axes, size, margin + SURFACE_TOLERANCE, offset)
        acts = any_nonzero(near)  # most particles are far away
        if ti.static(features.continuous):
            acts = 1
        if acts == 1:
            push = shape.push_out(features, axes, size, margin, offset)
            if ti.static(features.continuous):  # noqa: SIM102 (only this condition is known while compiling)
                if table[row, COLLIDER_CONTINUOUS] > 0.0:
                    start = to_local(start_axes, cloth.x_prev[i] - broadcast(start_center, x))
                    path = to_local(axes, offset) - start
                    impact, normal = shape.time_of_impact(features, size, margin - SURFACE_TOLERANCE, start, path)
                    hits = 1
                    if ti.static(not is_scalar(x)):  # a branch saves time: mostly none of the eight hits it
                        hits = any_at_most(impact, 1.0)
                    if hits == 1:
                        tangential = path - scale(normal, dot(normal, path))  # after the impact it slides on
                        stopped = to_world(axes, start + scale(path, impact) + scale(tangential, 1.0 - impact))
                        stopped_push = shape.push_out(features, axes, size, margin, stopped)
                        push = select(impact <= 1.0, stopped - offset + stopped_push, push)
            move = push
            if ti.static(ctx.update_velocity) and friction > 0.0:
                surface = broadcast(travel * fraction, x) + cross(broadcast(rotation * fraction, x), offset + push)
                slide = x + push - cloth.x_prev[i] - surface
                if ti.static(features.friction_sums):
                    # Springs may have lifted it a little since the last iteration.
                    near = shape.push_out(features, axes, size, margin + SURFACE_TOLERANCE, offset + push)
                    normal = scale(near, 1.0 / ti.max(length(near), TINY))
                    touching = ti.select(length(near) > 0.0, 1.0, 0.0)
                    push_sums, sums = ti.static(cloth.friction_sums.push, cloth.friction_sums.friction)
                    move += add_friction(push_sums, sums, i, push, normal, slide, friction, touching)
                else:
                    move += friction_correction(push, slide, friction)
                if ti.static(features.continuous):  # friction of a long push may lead into the collider
                    move += shape.push_out(features, axes, size, margin, offset + move)
            free = ti.select(cloth.inverse_mass[i] > 0.0, 1.0, 0.0)
            project_position(cloth, features, ctx, i, scale(move, free))


@ti.func
def contact_of(
    cloth: ti.template(),
    features: ti.template(),
    ctx: ti.template(),
    shape: ti.template(),
    row: int,
    i: int,
    state: ti.template(),
):
    """Return the displacement of a particle to a collider's margin [m], and its velocity relative to the surface."""
    center, axes, margin, speed, spin = ti.static(state)
    x = cloth.x[i]
    offset = x - broadcast(center, x)
    size = vec3_at(ctx.colliders, row, COLLIDER_SIZE)
    push = shape.push_out(features, axes, size, margin, offset)
    surface = broadcast(speed, x) + cross(broadcast(spin, x), offset)
    return push, velocity_of(cloth, features, i, ctx.h) - surface


@ti.func
def reflect(cloth: ti.template(), features: ti.template(), ctx: ti.template(), shape: ti.template(), row: int, time):
    """Reverse the normal velocity of particles that approach within the margin, times the restitution."""
    restitution = ctx.colliders[row, COLLIDER_RESTITUTION]
    resolve_velocities(cloth, features, ctx, shape, row, time, restitution, 0.0)


@ti.func
def stop(cloth: ti.template(), features: ti.template(), ctx: ti.template(), shape: ti.template(), row: int, time):
    """Stop the approach of particles on the margin."""
    resolve_velocities(cloth, features, ctx, shape, row, time, 0.0, SURFACE_TOLERANCE)


@ti.func
def resolve_velocities(
    cloth: ti.template(),
    features: ti.template(),
    ctx: ti.template(),
    shape: ti.template(),
    row: int,
    time,
    restitution: float,
    tolerance: float,
):
    """Change the velocities of particles that approach within the margin and a tolerance [m], with Coulomb friction."""
    table = ti.static(ctx.colliders)
    friction = table[row, COLLIDER_FRICTION]
    center, axes = pose_at(table, row, time / ctx.substeps)
    margin = margin_at(table, row, time / ctx.substeps) + tolerance
    travel, rotation = motion_at(table, row, time / ctx.substeps)
    speed, spin = travel / (ctx.substeps * ctx.h), rotation / (ctx.substeps * ctx.h)
    for i in range(cloth.packet_count[None]):
        push, velocity = contact_of(cloth, features, ctx, shape, row, i, ti.static((center, axes, margin, speed, spin)))
        normal = scale(push, 1.0 / ti.max(length(push), TINY))
        change = scale(normal, -(1.0 + restitution) * ti.min(dot(normal, velocity), 0.0))
        change += friction_correction(change, velocity + change, friction)
        free = ti.select(cloth.inverse_mass[i] > 0.0, 1.0, 0.0)
        apply_impulse(cloth, features, i, scale(change, free), ctx.h)


@ti.func
def repel(cloth: ti.template(), features: ti.template(), ctx: ti.template(), shape: ti.template(), row: int, time):
    """Add a pressure proportional to the depth. A particle stands for an area of its mass over the area density."""
    table = ti.static(ctx.colliders)
    rate = table[row, COLLIDER_STIFFNESS] / ctx.params[AREA_DENSITY]  # [1/s²]
    friction = table[row, COLLIDER_FRICTION]
    center, axes = pose_at(table, row, time / ctx.substeps)
    margin = margin_at(table, row, time / ctx.substeps)
    travel, rotation = motion_at(table, row, time / ctx.substeps)
    speed, spin = travel / (ctx.substeps * ctx.h), rotation / (ctx.substeps * ctx.h)
    for i in range(cloth.packet_count[None]):
        push, velocity = contact_of(cloth, features, ctx, shape, row, i, ti.static((center, axes, margin, speed, spin)))
        change = push * (rate * ctx.h)  # [m/s] in a substep
        change += friction_correction(change, velocity + change, friction)
        w = cloth.inverse_mass[i]
        mass = ti.select(w > 0.0, 1.0 / ti.max(w, TINY), 0.0)
        cloth.force[i] = cloth.force[i] + scale(change, mass / ctx.h)


GROWTH_RATE = 0.2  # [m/s]
UNKNOWN = -1.0


class Depenetration:
    """By how much the margin of every collider is reduced, so that particles inside it are let out slowly.

    It is determined after the cloth was placed, or a collider teleported or grew, and then decreases to 0.
    """

    def __init__(self, count: int) -> None:
        self.reduction = np.full(count, UNKNOWN)
        """Reduction of every collider [m], or `UNKNOWN` until the next frame."""

    def invalidate(self, row: int | slice = slice(None)) -> None:
        """Have the reduction of one collider, or of all, determined anew at the next frame."""
        self.reduction[row] = UNKNOWN

    def advance(
        self,
        colliders: Sequence[Collider | Ground],
        points: Callable[[], Floats],
        corners: Callable[[], Floats],
        start: float,
        end: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the reduction of every collider at the start and the end of a frame [m].

        `points` returns the positions of all free particles [m], (N, 3), and `corners` those of the corners of all
        triangles with a free particle [m], (T, 3, 3). They are called only when needed.
        """
        teleported = [row for row, collider in enumerate(colliders) if teleports(collider, start, end)]
        self.reduction[teleported] = UNKNOWN
        if self.reduction.any():  # in nearly every frame all are 0
            positions = points()
            for row in map(int, np.flatnonzero(self.reduction)):
                (posed,) = pose_colliders([colliders[row]], end if row in teleported else start)
                distance = float(signed_distance(posed, positions).min(initial=np.inf))
                if collides_with_triangles(posed.collider):
                    distance = min(distance, float(triangle_distance(posed, corners()).min(initial=np.inf)))
                depth = posed.collider.margin - distance
                if self.reduction[row] == UNKNOWN:
                    self.reduction[row] = max(depth, 0.0)
                else:
                    self.reduction[row] = min(self.reduction[row], depth)
        before = np.maximum(self.reduction, 0.0)
        self.reduction = np.maximum(before - GROWTH_RATE * (end - start), 0.0)
        return before, self.reduction
