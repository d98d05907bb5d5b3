"""Time integration of free motion, prescribed motion of attachments and grabs, and checks for divergence."""

import taichi as ti
import taichi.math as tm

from .constraint_math import TINY
from .forces import consume_acceleration
from .layout import velocity_of, write
from .step_params import (
    COLLIDER_AXES,
    COLLIDER_BEND,
    COLLIDER_END,
    COLLIDER_MARGIN,
    COLLIDER_MARGIN_CHANGE,
    COLLIDER_ROTATION,
    COLLIDER_ROTATION_BEND,
    COLLIDER_START,
    GRABS,
)
from .vec import select


@ti.func
def integrate(
    cloth: ti.template(), features: ti.template(), params: ti.template(), h: float, velocity_factor: float, drift: float
):
    """Apply v ← velocity_factor·v + h·a, then x ← x + drift·v. Pinned particles keep v = 0."""
    for i in range(cloth.packet_count[None]):
        x, velocity = cloth.x[i], cloth.velocity[i] * velocity_factor + consume_acceleration(cloth, i, params) * h
        velocity = select(cloth.inverse_mass[i] > 0.0, velocity, velocity * 0.0)
        cloth.velocity[i] = velocity
        cloth.x[i] = x + velocity * drift
        if ti.static(features.needs_previous_positions):
            cloth.x_prev[i] = x


@ti.func
def apply_correction(cloth: ti.template(), features: ti.template(), i: int, move, h):
    """Move a particle within a step of h seconds: x ← x + move, v ← v + move/h.

    Summed over a substep this is v = (x − x_prev)/h of position-based dynamics, without the rounding error of x over h.
    The compiler hoists 1/h: six divisions for each spring took a sixth of a frame of `xpbd`.
    """
    cloth.x[i] = cloth.x[i] + move
    if ti.static(features.stores_velocity):
        cloth.velocity[i] = cloth.velocity[i] + move * (1.0 / h)


@ti.func
def apply_impulse(cloth: ti.template(), features: ti.template(), i: int, change, h):
    """Change a particle's velocity [m/s] and not its position."""
    if ti.static(features.stores_velocity):
        cloth.velocity[i] = cloth.velocity[i] + change
    else:
        cloth.x_prev[i] = cloth.x_prev[i] - change * h


@ti.func
def project_position(cloth: ti.template(), features: ti.template(), ctx: ti.template(), i: int, move):
    """Move a particle to an allowed position: x ← x + move, and v ← v + move/(h·dt_scale) if `ctx.update_velocity`."""
    if ti.static(ctx.update_velocity):
        apply_correction(cloth, features, i, move, ctx.h * ctx.dt_scale)
    else:
        cloth.x[i] = cloth.x[i] + move


@ti.func
def vec3_at(table: ti.template(), row: int, column: int) -> tm.vec3:
    """Return three adjacent columns of a table as a vector."""
    return tm.vec3(table[row, column], table[row, column + 1], table[row, column + 2])


@ti.func
def pose_at(table: ti.template(), row: int, fraction: float):
    """Return center [m] and axes of a body after a fraction of the frame.

    Center and rotation vector are parabolas in time, through the poses at both ends and in the middle of the frame.
    """
    travel = vec3_at(table, row, COLLIDER_END) - vec3_at(table, row, COLLIDER_START)
    bent = 4.0 * fraction * (1.0 - fraction)
    center = vec3_at(table, row, COLLIDER_START) + travel * fraction + vec3_at(table, row, COLLIDER_BEND) * bent
    rotation = vec3_at(table, row, COLLIDER_ROTATION) * fraction + vec3_at(table, row, COLLIDER_ROTATION_BEND) * bent
    angle = rotation.norm()
    k, sine, versine = rotation / ti.max(angle, TINY), ti.sin(angle), 1.0 - ti.cos(angle)
    axes = ti.Matrix.zero(ti.f32, 3, 3)
    for c in ti.static(range(3)):  # Rodrigues: a matrix product takes a tenth of the time to parse a frame
        axis = tm.vec3([table[row, COLLIDER_AXES + 3 * r + c] for r in ti.static(range(3))])
        across = k.cross(axis)
        turned = axis + sine * across + versine * k.cross(across)
        for r in ti.static(range(3)):
            axes[r, c] = turned[r]
    return center, axes


@ti.func
def motion_at(table: ti.template(), row: int, fraction: float):
    """Return the linear [m] and angular [rad] velocity of a body after a fraction of the frame, per frame.

    Over a step these are its displacement and rotation if `fraction` is in the middle of the step.
    """
    travel = vec3_at(table, row, COLLIDER_END) - vec3_at(table, row, COLLIDER_START)
    bent = 4.0 - 8.0 * fraction
    rotation = vec3_at(table, row, COLLIDER_ROTATION)
    return (
        travel + vec3_at(table, row, COLLIDER_BEND) * bent,
        rotation + vec3_at(table, row, COLLIDER_ROTATION_BEND) * bent,
    )


@ti.func
def margin_at(table: ti.template(), row: int, fraction: float) -> float:
    """Return a collider's margin [m] after a fraction of the frame, negative while it is reduced (`response.py`)."""
    return table[row, COLLIDER_MARGIN] + table[row, COLLIDER_MARGIN_CHANGE] * fraction


@ti.func
def set_kinematic(
    cloth: ti.template(), features: ti.template(), index: int, x: tm.vec3, velocity: tm.vec3, moves: ti.template()
):
    """Set the velocity of the particle at a layout index, and its position if it `moves`."""
    if ti.static(moves):
        write(cloth, cloth.x, index, x)
    if ti.static(features.stores_velocity):
        write(cloth, cloth.velocity, index, velocity)


@ti.func
def move_kinematic_particles(
    cloth: ti.template(), features: ti.template(), ctx: ti.template(), time: float, moves: ti.template() = True
):
    """Set velocity and, if it `moves` them, position of attached and grabbed particles at a time, in substeps since the
    start of the frame.

    Forces use this velocity. A grab moves in a straight line and takes precedence over an attachment.
    """
    fraction, seconds = time / ctx.substeps, ctx.h * ctx.substeps
    if ti.static(features.attachments):
        for n in range(cloth.attachments.count[None]):
            row = ti.static(features.collider_count) + cloth.attachments.attachment[n]
            center, axes = pose_at(ctx.colliders, row, fraction)
            offset = axes @ cloth.attachments.local[n]
            travel, rotation = motion_at(ctx.colliders, row, fraction)
            velocity = (travel + rotation.cross(offset)) / seconds
            set_kinematic(cloth, features, cloth.attachments.index[n], center + offset, velocity, moves)
    params = ti.static(ctx.params)
    for n in range(ctx.grabbed_count):
        column = GRABS + 6 * cloth.grabbed.grab[n]
        start = tm.vec3(params[column], params[column + 1], params[column + 2])
        path = tm.vec3(params[column + 3], params[column + 4], params[column + 5]) - start
        # Relative to where the particle was grabbed: no bit changes while the grab is at rest.
        x = cloth.grabbed.rest_position[n] + (start + path * fraction)
        set_kinematic(cloth, features, cloth.grabbed.index[n], x, path / seconds, moves)


EXPONENT = 0x7F800000  # exponent bits of a float32: all set for infinity and NaN


@ti.func
def is_finite(value: float) -> int:
    """Return whether a value is finite, by its bits: fast math assumes that comparisons see finite numbers."""
    return int((ti.bit_cast(value, ti.i32) & EXPONENT) != EXPONENT)


@ti.func
def snapshot_particle(
    cloth: ti.template(), features: ti.template(), copy: ti.template(), i: int, h: float, max_speed: float
) -> int:
    """Copy a particle's state. Return 1 if its position is finite and its speed is at most `max_speed` [m/s]."""
    x, speed = cloth.x[i], velocity_of(cloth, features, i, h).norm()
    copy.x[i], copy.x_prev[i], copy.velocity[i] = x, cloth.x_prev[i], cloth.velocity[i]
    finite = is_finite(x.x) * is_finite(x.y) * is_finite(x.z) * is_finite(speed)
    return ti.select(speed > max_speed, 0, finite)


@ti.kernel
def snapshot(
    cloth: ti.template(),
    features: ti.template(),
    copy: ti.template(),
    parallel: ti.template(),
    h: float,
    max_speed: float,
) -> int:
    """Copy the state. Return 1 if every particle is stable. Small cloths use one thread, which is faster."""
    stable = 1
    if ti.static(parallel):
        for i in range(cloth.packet_count[None]):
            ti.atomic_min(stable, snapshot_particle(cloth, features, copy, i, h, max_speed))
    else:
        ti.loop_config(serialize=True)
        for _ in range(1):
            for i in range(cloth.packet_count[None]):
                stable = ti.min(stable, snapshot_particle(cloth, features, copy, i, h, max_speed))
    return stable


@ti.kernel
def roll_back(cloth: ti.template(), copy: ti.template()):
    """Restore the state from a snapshot."""
    for i in range(cloth.packet_count[None]):
        cloth.x[i], cloth.x_prev[i], cloth.velocity[i] = copy.x[i], copy.x_prev[i], copy.velocity[i]


@ti.kernel
def any_longer_than(cloth: ti.template(), count: int, strain: float) -> int:
    """Return 1 if one of the first `count` springs is strained by more than `strain`, else 0."""
    found = 0
    for e in range(count):
        i, j = cloth.ends[e]
        if (cloth.x[j] - cloth.x[i]).norm() > (1.0 + strain) * cloth.rest[e]:
            ti.atomic_max(found, 1)
    return found
