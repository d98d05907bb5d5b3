"""Limits of distances, projected after the springs of a substep: the strain limit of springs (Provot 1995), tethers to
the pins (Kim, Chentanez and Müller 2012, *Long range attachments*), and the max distance of a particle from its start.

Each is a unilateral distance constraint: it shortens, and never pushes.
"""

import taichi as ti

from .constraint_math import TINY
from .integration import project_position
from .layout import read
from .simd_sweep import PairConstraint
from .springs import apply_pair_correction, clear_multipliers, for_each_spring
from .step_params import STRAIN_LIMIT, TETHER_SLACK
from .vec import LANES, length, scale

# -- strain limit ----------------------------------------------------------------------------------------------------


@ti.func
def limit_stretch(
    cloth: ti.template(),
    features: ti.template(),
    a,
    b,
    e,
    stiffness,
    relaxation: ti.template(),
    params: ti.template(),
    h,
):
    """Shorten a spring that is longer than the strain limit allows (Provot 1995, section 5), with over-relaxation.

    Projected successive over-relaxation (Cryer 1971): the multiplier is how far the spring was shortened so far, of
    which it may give back any surplus but no more. It never pushes, and ignores springs within their limit.
    """
    w_a, w_b = cloth.inverse_mass[a], cloth.inverse_mass[b]
    gap = cloth.x[b] - cloth.x[a]
    norm = length(gap)
    excess = norm - cloth.rest[e] * (1.0 + params[STRAIN_LIMIT])
    before = cloth.multiplier[e]
    after = ti.max(before + ti.select(stiffness > 0.0, relaxation, 0.0) * excess / ti.max(w_a + w_b, TINY), 0.0)
    cloth.multiplier[e] = after
    apply_pair_correction(cloth, features, a, b, scale(gap, (after - before) / ti.max(norm, TINY)), h)


@ti.func
def limit_exactly(cloth: ti.template(), features: ti.template(), a, b, e, stiffness, params: ti.template(), h):
    """Shorten a spring to its limit."""
    limit_stretch(cloth, features, a, b, e, stiffness, 1.0, params, h)


@ti.func
def limit_over_relaxed(cloth: ti.template(), features: ti.template(), a, b, e, stiffness, params: ti.template(), h):
    """Shorten a spring beyond its limit, by the relaxation factor of the scene's number of iterations."""
    limit_stretch(cloth, features, a, b, e, stiffness, ti.static(over_relaxation(features.strain_limit)), params, h)


def over_relaxation(iterations: int) -> float:
    """Return the relaxation factor: an error decays by this less 1 in each iteration, to e⁻⁴ in the last."""
    return 2.0 - 4.0 / (iterations + 3.0)


def final_iterations(iterations: int) -> int:
    """Return how many iterations at the end are not over-relaxed: a quarter, at least one. They remove the surplus.

    33 rows under ten times their weight with a limit of 0.1 %, at 60×8: 160 plain iterations leave 7 % of the excess,
    24 of these 5 %.
    """
    return -(-iterations // 4)


STRETCH_LIMIT, STRETCH_LIMIT_OVER_RELAXED = PairConstraint(limit_exactly), PairConstraint(limit_over_relaxed)


@ti.func
def limit_strain(cloth: ti.template(), features: ti.template(), params: ti.template(), h: float):
    """Run the iterations of the strain limit, if the scene has one."""
    if ti.static(features.strain_limit > 0):
        clear_multipliers(cloth)
        final = ti.static(final_iterations(features.strain_limit))
        first = ti.static(features.strain_limit - final)
        iterate_limit(cloth, features, STRETCH_LIMIT_OVER_RELAXED, first, params, h)
        iterate_limit(cloth, features, STRETCH_LIMIT, final, params, h)


@ti.func
def iterate_limit(
    cloth: ti.template(),
    features: ti.template(),
    constraint: ti.template(),
    iterations: ti.template(),
    params: ti.template(),
    h: float,
):
    """Apply a constraint to every spring, `iterations` times."""
    if ti.static(cloth.is_parallel):  # a parallel loop must be outermost, so the iterations are unrolled
        for _ in ti.static(range(iterations)):
            for_each_spring(cloth, features, constraint, params, h)
    elif ti.static(iterations > 0):
        for _ in range(iterations):
            for_each_spring(cloth, features, constraint, params, h)


# -- tethers and max distances ---------------------------------------------------------------------------------------


@ti.func
def correction_to_distance(gap, max_distance):
    """Return the displacement of a particle at `gap` from a point back to `max_distance` [m] of it; zero within it."""
    return scale(gap, ti.min(max_distance / ti.max(length(gap), TINY), 1.0) - 1.0)


@ti.func
def refresh_pin_positions(cloth: ti.template(), tethers: ti.template()):
    """Copy the positions of the pins to the tethers of the SIMD layout."""
    for n in range(tethers.count[None] * cloth.packet_count[None]):
        pins, positions = tethers.pin[n], tethers.pin_position[n]
        for k in range(LANES):
            x = read(cloth, cloth.x, pins[k])
            for c in ti.static(range(3)):
                positions[c, k] = x[c]
        tethers.pin_position[n] = positions


@ti.func
def pin_position(cloth: ti.template(), n: int):
    """Return the position of the pin of tether n."""
    if ti.static(cloth.is_simd):
        return cloth.tethers.pin_position[n]
    else:
        return cloth.x[cloth.tethers.pin[n]]


@ti.func
def project_tethers(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Project every free particle to the longest lengths of its tethers, one after another, if the scene has tethers.

    Within a frame pins move only where an attachment or a grab drives them.
    """
    if ti.static(features.tethers):
        if ti.static(cloth.is_simd):
            if ctx.s == 0 or ctx.grabbed_count > 0 or ti.static(features.attachments):
                refresh_pin_positions(cloth, cloth.tethers)
        for i in range(cloth.packet_count[None]):
            free = ti.select(cloth.inverse_mass[i] > 0.0, 1.0, 0.0)
            x, move = cloth.x[i], cloth.x[i] * 0.0
            for t in range(cloth.tethers.count[None]):
                n = t * cloth.packet_count[None] + i
                gap = x + move - pin_position(cloth, n)
                move += scale(
                    correction_to_distance(gap, cloth.tethers.flat_distance[n] * ctx.params[TETHER_SLACK]), free
                )
            project_position(cloth, features, ctx, i, move)


@ti.func
def project_max_distances(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Project every free particle to its max distance from its start, if the scene has max distances."""
    if ti.static(features.max_distances):
        for i in range(cloth.packet_count[None]):
            free = ti.select(cloth.inverse_mass[i] > 0.0, 1.0, 0.0)
            gap = cloth.x[i] - cloth.max_distances.center[i]
            move = scale(correction_to_distance(gap, cloth.max_distances.limit[i]), free)
            project_position(cloth, features, ctx, i, move)
