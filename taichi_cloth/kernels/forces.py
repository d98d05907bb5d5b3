"""External forces: wind on every triangle, and the force accumulator of every particle, to which gravity is added."""

import taichi as ti
import taichi.math as tm

from .constraint_math import TINY, parabolic_wave, triangle_area_normal, wind_force
from .layout import velocity_of
from .simd_sweep import add_halo, load_halo
from .step_params import (
    DRAG,
    GRAVITY,
    GUST_FREQUENCIES,
    GUST_PHASE,
    GUST_SPEED,
    GUST_WAVEVECTORS,
    HALF_AIR_DENSITY,
    LIFT,
    WIND_X,
    WIND_Y,
    WIND_Z,
)
from .vec import broadcast, dot, from_components, length, scale

GUST_AMPLITUDES = (0.6, 0.3, 1.0)  # of each component: gusts are weakest along y


@ti.func
def gust_wave(position, k: ti.template(), params: ti.template(), seconds: float):
    """Return component k of the gust [m/s] at a position, `seconds` after the frame began."""
    along = dot(position, broadcast(tm.vec3(*GUST_WAVEVECTORS[k]), position))
    wave = parabolic_wave(along - (GUST_FREQUENCIES[k] * seconds + params[GUST_PHASE + k]))
    return wave * (GUST_AMPLITUDES[k] * params[GUST_SPEED])


@ti.func
def wind_at(position, params: ti.template(), seconds: float):
    """Return the velocity of the air [m/s]: mean wind plus gust."""
    mean = broadcast(tm.vec3(params[WIND_X], params[WIND_Y], params[WIND_Z]), position)
    gust = from_components(
        gust_wave(position, 0, params, seconds),
        gust_wave(position, 1, params, seconds),
        gust_wave(position, 2, params, seconds),
        position,
    )
    return mean + gust


@ti.func
def wind_on_triangle(a, b, c, velocity, max_inverse_mass, params: ti.template(), h: float, seconds: float):
    """Return a third of the wind force [N] on a triangle that moves at `velocity` [m/s]: the part of each corner.

    It is limited to the force that stops the air in one substep when six triangles meet at a particle: beyond that an
    explicit step would throw a light sheet back faster than the air came. `max_inverse_mass` of its corners [1/kg].
    """
    air = wind_at((a + b + c) / 3.0, params, seconds) - velocity
    force = wind_force(triangle_area_normal(a, b, c), air, params[HALF_AIR_DENSITY], params[DRAG], params[LIFT])
    limit = length(air) / (2.0 * h * ti.max(max_inverse_mass, TINY))
    return scale(force, ti.min(1.0, limit / ti.max(length(force), TINY)) / 3.0)


@ti.func
def wind_force_per_corner(
    cloth: ti.template(),
    features: ti.template(),
    i: int,
    j: int,
    k: int,
    params: ti.template(),
    h: float,
    seconds: float,
):
    """Return the wind force [N] on each corner of the triangle of particles i, j, k."""
    velocity = (
        velocity_of(cloth, features, i, h) + velocity_of(cloth, features, j, h) + velocity_of(cloth, features, k, h)
    ) / 3.0
    lightest = ti.max(cloth.inverse_mass[i], cloth.inverse_mass[j], cloth.inverse_mass[k])
    return wind_on_triangle(cloth.x[i], cloth.x[j], cloth.x[k], velocity, lightest, params, h, seconds)


@ti.func
def add_to_corners(cloth: ti.template(), i: int, j: int, k: int, force):
    """Add the same force [N] to three particles. `+=` on a field would be atomic."""
    cloth.force[i] = cloth.force[i] + force
    cloth.force[j] = cloth.force[j] + force
    cloth.force[k] = cloth.force[k] + force


@ti.func
def add_wind_to_list(cloth: ti.template(), features: ti.template(), params: ti.template(), h: float, seconds: float):
    """Add the wind force to the corners of every triangle, in the serial and the parallel layout."""
    if ti.static(cloth.is_parallel):  # each particle gathers from its own triangles
        for p in range(cloth.packet_count[None]):
            total = cloth.force[p]
            for n in range(cloth.triangle_first[p], cloth.triangle_first[p + 1]):
                i, j, k = cloth.triangles[cloth.triangle_rows[n]]
                total += wind_force_per_corner(cloth, features, i, j, k, params, h, seconds)
            cloth.force[p] = total
    else:
        for t in range(cloth.triangle_count[None]):
            i, j, k = cloth.triangles[t]
            add_to_corners(cloth, i, j, k, wind_force_per_corner(cloth, features, i, j, k, params, h, seconds))


def wind_inputs(features: object) -> tuple[str, ...]:
    """Return the fields that the wind reads."""
    return "x", "inverse_mass", "velocity" if features.stores_velocity else "x_prev"


@ti.func
def add_wind_simd(cloth: ti.template(), features: ti.template(), params: ti.template(), h: float, seconds: float):
    """Add the wind force to the two triangles of eight cells at once, which are cut as `grid.triangles` cuts them.

    The last cells of a strip end at the first column of the next lane, which is loaded into the halo.
    """
    row_stride, halo = cloth.row_stride[None], cloth.packet_count[None]
    load_halo(cloth, ti.static(wind_inputs(features)), "force", 1)
    for y in range(cloth.rows[None] - 1):
        for i in range(row_stride):
            a = y * row_stride + i  # corners of the cell: a b over c d
            b, c, d = a + 1, a + row_stride, a + row_stride + 1
            if i == row_stride - 1:
                b, d = halo + y, halo + y + 1
            falling = (y + i) & 1 == 0  # cut from a to d, else from b to c
            for right in range(2):
                p, q, o = a, c, b
                if right:
                    p, q = c, d
                if falling:
                    p, o = a, b if right else d
                force = wind_force_per_corner(cloth, features, p, q, o, params, h, seconds)
                add_to_corners(cloth, p, q, o, scale(force, cloth.has_cell[i]))
    add_halo(cloth, "force", 1)


@ti.func
def add_wind(cloth: ti.template(), features: ti.template(), ctx: ti.template(), time: float):
    """Add the wind force [N] at a time, in substeps since the start of the frame, if the scene has wind."""
    if ti.static(features.wind):
        if ti.static(cloth.is_simd):
            add_wind_simd(cloth, features, ctx.params, ctx.h, time * ctx.h)
        else:
            add_wind_to_list(cloth, features, ctx.params, ctx.h, time * ctx.h)


@ti.func
def clear_forces(cloth: ti.template()):
    """Set all forces to zero, before the first frame. Later, `consume_force` clears each force when it is read."""
    for i in range(cloth.packet_count[None]):
        cloth.force[i] = broadcast(tm.vec3(0.0), cloth.force[i])


@ti.func
def consume_force(cloth: ti.template(), i: int):
    """Return the accumulated force of a particle [N] and set it to zero."""
    force = cloth.force[i]
    cloth.force[i] = broadcast(tm.vec3(0.0), force)
    return force


@ti.func
def consume_acceleration(cloth: ti.template(), i: int, params: ti.template()):
    """Return the acceleration of a particle [m/s²] by its accumulated force, which is consumed, and by gravity."""
    force = consume_force(cloth, i)
    return scale(force, cloth.inverse_mass[i]) + broadcast(tm.vec3(0.0, -params[GRAVITY], 0.0), force)
