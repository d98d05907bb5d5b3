"""External forces: gravity on every particle, air on every triangle. Shared by all solvers."""

from typing import Any

import taichi as ti
import taichi.math as tm

from .controls import (
    DRAG,
    GRAVITY,
    GUST,
    GUST_RATES,
    GUST_TURNS,
    GUST_WAVES,
    HALF_AIR_DENSITY,
    LIFT,
    WIND_X,
    WIND_Y,
    WIND_Z,
)
from .maths import TINY, air_force, arc_wave, triangle_area_normal
from .places import dot, join, length, spread, times
from .strips import bring_back, fetch_beyond

GUST_SHARES = (0.6, 0.3, 1.0)  # size of each component; the air rolls least up and down


@ti.func
def gust_wave(place, k: ti.template(), controls: ti.template(), seconds: float):
    """Component k of the gust [m/s] at a place, `seconds` after the frame began."""
    along = dot(place, spread(tm.vec3(*GUST_WAVES[k]), place))
    return arc_wave(along - (GUST_RATES[k] * seconds + controls[GUST_TURNS + k])) * (GUST_SHARES[k] * controls[GUST])


@ti.func
def wind_at(place, controls: ti.template(), seconds: float):
    """Velocity of the air [m/s]: the mean wind and its gust."""
    mean = spread(tm.vec3(controls[WIND_X], controls[WIND_Y], controls[WIND_Z]), place)
    gust = join(
        gust_wave(place, 0, controls, seconds),
        gust_wave(place, 1, controls, seconds),
        gust_wave(place, 2, controls, seconds),
        place,
    )
    return mean + gust


@ti.func
def air_on_triangle(a, b, c, velocity, lightest, controls: ti.template(), h: float, seconds: float):
    """A third of the air's force [N] on a triangle that moves at `velocity` [m/s]: the share of each corner.

    Six triangles meet at a particle and each gives it a third: beyond the force that stops the air in one
    substep, a light sheet would be thrown back faster than the air came, and an explicit step would blow up.
    `lightest` is the largest inverse mass of its corners [1/kg].
    """
    air = wind_at((a + b + c) / 3.0, controls, seconds) - velocity
    force = air_force(triangle_area_normal(a, b, c), air, controls[HALF_AIR_DENSITY], controls[DRAG], controls[LIFT])
    most = length(air) / (2.0 * h * ti.max(lightest, TINY))
    return times(force, ti.min(1.0, most / ti.max(length(force), TINY)) / 3.0)


@ti.func
def velocity_of(cloth: ti.template(), stages: ti.template(), i: int, h: float):
    """Velocity of a particle [m/s], however the solver keeps it."""
    if ti.static(stages.own_velocity):
        return cloth.velocity[i]
    else:
        return (cloth.x[i] - cloth.x_prev[i]) / h


@ti.func
def third_of_triangle(
    cloth: ti.template(),
    stages: ti.template(),
    i: int,
    j: int,
    k: int,
    controls: ti.template(),
    h: float,
    seconds: float,
):
    """Force [N] of the air on each corner of the triangle of particles i, j, k."""
    velocity = (
        velocity_of(cloth, stages, i, h) + velocity_of(cloth, stages, j, h) + velocity_of(cloth, stages, k, h)
    ) / 3.0
    lightest = ti.max(cloth.inverse_mass[i], cloth.inverse_mass[j], cloth.inverse_mass[k])
    return air_on_triangle(cloth.x[i], cloth.x[j], cloth.x[k], velocity, lightest, controls, h, seconds)


@ti.func
def push_corners(cloth: ti.template(), i: int, j: int, k: int, third):
    """Adds the same force [N] to three particles. Plain sums: `+=` on a field would be atomic."""
    cloth.force[i] = cloth.force[i] + third
    cloth.force[j] = cloth.force[j] + third
    cloth.force[k] = cloth.force[k] + third


@ti.func
def blow_on_triangles(cloth: ti.template(), stages: ti.template(), controls: ti.template(), h: float, seconds: float):
    """Adds the air's force to the corners of every triangle of the list."""
    if ti.static(cloth.gathers):  # each particle asks its own triangles, so that none adds to another's sum
        for p in range(cloth.slot_count[None]):
            total = cloth.force[p]
            for n in range(cloth.triangle_first[p], cloth.triangle_first[p + 1]):
                i, j, k = cloth.triangles[cloth.triangle_rows[n]]
                total += third_of_triangle(cloth, stages, i, j, k, controls, h, seconds)
            cloth.force[p] = total
    else:
        for t in range(cloth.triangle_count[None]):
            i, j, k = cloth.triangles[t]
            push_corners(cloth, i, j, k, third_of_triangle(cloth, stages, i, j, k, controls, h, seconds))


def air_reads(stages: Any) -> tuple[str, ...]:
    """What the air has to know of a particle."""
    return "x", "inverse_mass", "velocity" if stages.own_velocity else "x_prev"


@ti.func
def blow_on_strips(cloth: ti.template(), stages: ti.template(), controls: ti.template(), h: float, seconds: float):
    """The same for a grid in strips: the two triangles of eight cells at once, cut as `grid.triangles` cuts them.

    The last cells of the strips end at the first column of the next lane: it is fetched into slots behind the grid.
    """
    pitch, spare = cloth.pitch[None], cloth.slot_count[None]
    fetch_beyond(cloth, ti.static(air_reads(stages)), "force", 1)
    for y in range(cloth.rows[None] - 1):
        for i in range(pitch):
            a = y * pitch + i  # corners of the cell: a b over c d
            b, c, d = a + 1, a + pitch, a + pitch + 1
            if i == pitch - 1:
                b, d = spare + y, spare + y + 1
            falling = (y + i) & 1 == 0  # cut from a to d, else from b to c
            for right in range(2):
                p, q, o = a, c, b
                if right:
                    p, q = c, d
                if falling:
                    p, o = a, b if right else d
                third = third_of_triangle(cloth, stages, p, q, o, controls, h, seconds)
                push_corners(cloth, p, q, o, times(third, cloth.has_cell[i]))
    bring_back(cloth, "force", 1)


@ti.func
def forget_forces(cloth: ti.template()):
    """Once, before the first frame: whoever uses a force takes it away."""
    for i in range(cloth.slot_count[None]):
        cloth.force[i] = spread(tm.vec3(0.0), cloth.force[i])


@ti.func
def add_air(cloth: ti.template(), stages: ti.template(), now: ti.template(), steps: float):
    """Adds the air's force [N] after so many substeps of the frame, where the scene has wind."""
    if ti.static(stages.wind):
        if ti.static(cloth.in_lanes):
            blow_on_strips(cloth, stages, now.controls, now.h, steps * now.h)
        else:
            blow_on_triangles(cloth, stages, now.controls, now.h, steps * now.h)


@ti.func
def take_force(cloth: ti.template(), i: int):
    """The force [N] gathered for a particle, which is then gone."""
    force = cloth.force[i]
    cloth.force[i] = spread(tm.vec3(0.0), force)
    return force


@ti.func
def take_acceleration(cloth: ti.template(), i: int, controls: ti.template()):
    """Acceleration of a particle [m/s²] by the force gathered for it, and by gravity."""
    force = take_force(cloth, i)
    return times(force, cloth.inverse_mass[i]) + spread(tm.vec3(0.0, -controls[GRAVITY], 0.0), force)
