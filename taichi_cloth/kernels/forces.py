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

# Three plane waves, one for each component of the gust: turns a metre along x, y, z (wavelengths of 2 to 3 m).
GUST_WAVES = ((0.31, 0.17, 0.11), (0.13, 0.37, 0.19), (0.23, -0.11, 0.29))
GUST_SHARES = (0.6, 0.3, 1.0)  # size of each component; the air rolls least up and down


@ti.func
def gust_at(place: tm.vec3, controls: ti.template(), seconds: float) -> tm.vec3:
    """Velocity of the gust [m/s] at a place, `seconds` after the frame began."""
    gust = tm.vec3(0.0)
    for k in ti.static(range(3)):
        turns = place.dot(tm.vec3(*GUST_WAVES[k])) - GUST_RATES[k] * seconds - controls[GUST_TURNS + k]
        gust[k] = GUST_SHARES[k] * arc_wave(turns)
    return gust * controls[GUST]


@ti.func
def gather_accelerations(
    cloth: ti.template(), stages: ti.template(), controls: ti.template(), h: float, seconds: float
):
    """Writes cloth.acceleration [m/s²]: gravity, and where the scene has wind the air on each triangle."""
    for i in range(cloth.particle_count[None]):
        cloth.acceleration[i] = tm.vec3(0.0)
    if ti.static(stages.wind):
        wind = tm.vec3(controls[WIND_X], controls[WIND_Y], controls[WIND_Z])
        for t in range(cloth.triangle_count[None]):
            i, j, k = cloth.triangles[t]
            a, b, c = cloth.x[i], cloth.x[j], cloth.x[k]
            velocity = (a + b + c - cloth.x_prev[i] - cloth.x_prev[j] - cloth.x_prev[k]) / (3.0 * h)
            air = wind + gust_at((a + b + c) / 3.0, controls, seconds) - velocity
            force = air_force(
                triangle_area_normal(a, b, c), air, controls[HALF_AIR_DENSITY], controls[DRAG], controls[LIFT]
            )
            # Six triangles meet at a particle and each gives it a third: beyond this the air would throw a
            # light sheet back faster than it came, and an explicit step would blow up.
            lightest = tm.max(cloth.inverse_mass[i], cloth.inverse_mass[j], cloth.inverse_mass[k])
            most = air.norm() / (2.0 * h * tm.max(lightest, TINY))
            third = force * (tm.min(1.0, most / tm.max(force.norm(), TINY)) / 3.0)
            for corner in ti.static((i, j, k)):  # plain sums: `+=` on a field would be atomic
                cloth.acceleration[corner] = cloth.acceleration[corner] + third
    for i in range(cloth.particle_count[None]):
        gravity = tm.vec3(0.0, -controls[GRAVITY], 0.0)
        cloth.acceleration[i] = cloth.acceleration[i] * cloth.inverse_mass[i] + gravity
