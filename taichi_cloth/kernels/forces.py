"""External forces: gravity on every particle, air on every triangle. Shared by all solvers."""

import taichi as ti
import taichi.math as tm

from .controls import (
    DRAG,
    GRAVITY,
    GUST,
    GUST_RATES,
    GUST_TURNS,
    HALF_AIR_DENSITY,
    LIFT,
    WIND_X,
    WIND_Y,
    WIND_Z,
)
from .maths import TINY, air_force, arc_wave, triangle_area_normal
from .places import dot, from_previous, join, length, next_lane, spread, times

# Three plane waves, one for each component of the gust: turns a metre along x, y, z (wavelengths of 2 to 3 m).
GUST_WAVES = ((0.31, 0.17, 0.11), (0.13, 0.37, 0.19), (0.23, -0.11, 0.29))
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
def third_of_triangle(cloth: ti.template(), stages: ti.template(), t: int, controls: ti.template(), h, seconds):
    """Force [N] of the air on each corner of a triangle of the list."""
    i, j, k = cloth.triangles[t]
    velocity = (
        velocity_of(cloth, stages, i, h) + velocity_of(cloth, stages, j, h) + velocity_of(cloth, stages, k, h)
    ) / 3.0
    lightest = ti.max(cloth.inverse_mass[i], cloth.inverse_mass[j], cloth.inverse_mass[k])
    return air_on_triangle(cloth.x[i], cloth.x[j], cloth.x[k], velocity, lightest, controls, h, seconds)


@ti.func
def blow_on_triangles(cloth: ti.template(), stages: ti.template(), controls: ti.template(), h: float, seconds: float):
    """Adds the air's force to the corners of every triangle of the list."""
    if ti.static(cloth.gathers):  # each particle asks its own triangles, so that none adds to another's sum
        for i in range(cloth.slot_count[None]):
            total = cloth.force[i]
            for n in range(cloth.triangle_first[i], cloth.triangle_first[i + 1]):
                total += third_of_triangle(cloth, stages, cloth.triangle_rows[n], controls, h, seconds)
            cloth.force[i] = total
    else:
        for t in range(cloth.triangle_count[None]):
            third = third_of_triangle(cloth, stages, t, controls, h, seconds)
            for c in ti.static(range(3)):  # plain sums: `+=` on a field would be atomic
                corner = cloth.triangles[t][c]
                cloth.force[corner] = cloth.force[corner] + third


@ti.func
def blow_on_strips(cloth: ti.template(), stages: ti.template(), controls: ti.template(), h: float, seconds: float):
    """The same for a grid in strips: the two triangles of eight cells at once, cut as `grid.triangles` cuts them."""
    pitch = cloth.pitch[None]
    for y in range(cloth.rows[None] - 1):
        for i in range(pitch):
            falling = (y + i) & 1 == 0  # the cell is cut from a to d; b and c are its other corners, a b over c d
            over = i == pitch - 1
            at_a = y * pitch + i
            at_b = at_a + 1 - pitch if over else at_a + 1
            at_c, at_d = at_a + pitch, at_b + pitch
            a, b, c, d = cloth.x[at_a], cloth.x[at_b], cloth.x[at_c], cloth.x[at_d]
            v_a, v_b = velocity_of(cloth, stages, at_a, h), velocity_of(cloth, stages, at_b, h)
            v_c, v_d = velocity_of(cloth, stages, at_c, h), velocity_of(cloth, stages, at_d, h)
            w_a, w_b = cloth.inverse_mass[at_a], cloth.inverse_mass[at_b]
            w_c, w_d = cloth.inverse_mass[at_c], cloth.inverse_mass[at_d]
            if over:
                b, d = next_lane(b), next_lane(d)
                v_b, v_d = next_lane(v_b), next_lane(v_d)
                w_b, w_d = next_lane(w_b), next_lane(w_d)
            tip, v_tip, w_tip = b, v_b, w_b  # third corner of the triangle at a and c
            top, v_top, w_top = c, v_c, w_c  # and of the one at d and b
            if falling:
                tip, v_tip, w_tip = d, v_d, w_d
                top, v_top, w_top = a, v_a, w_a
            left = air_on_triangle(a, c, tip, (v_a + v_c + v_tip) / 3.0, ti.max(w_a, w_c, w_tip), controls, h, seconds)
            right = air_on_triangle(top, d, b, (v_top + v_d + v_b) / 3.0, ti.max(w_top, w_d, w_b), controls, h, seconds)
            left, right = times(left, cloth.has_cell[i]), times(right, cloth.has_cell[i])
            on_a, on_b, on_c, on_d = left, left + right, left + right, right
            if falling:
                on_a, on_b, on_c, on_d = left + right, right, left, left + right
            if over:
                on_b, on_d = from_previous(on_b), from_previous(on_d)
            cloth.force[at_a] = cloth.force[at_a] + on_a
            cloth.force[at_b] = cloth.force[at_b] + on_b
            cloth.force[at_c] = cloth.force[at_c] + on_c
            cloth.force[at_d] = cloth.force[at_d] + on_d


@ti.func
def forget_forces(cloth: ti.template()):
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
def acceleration_of(cloth: ti.template(), i: int, controls: ti.template()):
    """Acceleration of a particle [m/s²] by the forces gathered for it, and by gravity."""
    force = cloth.force[i]
    return times(force, cloth.inverse_mass[i]) + spread(tm.vec3(0.0, -controls[GRAVITY], 0.0), force)
