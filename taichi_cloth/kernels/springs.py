"""Constraints and forces of springs, and the loops over all springs in each layout.

The functions for one spring take its packet `e` and the packets `a` and `b` of its ends: one spring, or eight at once
in the SIMD layout (`vec.py`). `stiffness` has the unit of the solver: 0…1 for `verlet`, [N/m] for all others.
"""

from operator import attrgetter

import taichi as ti

from .constraint_math import TINY, damper_force, hooke_force, project_distance, project_distance_xpbd
from .integration import apply_correction
from .membrane_constraints import clear_membrane_multipliers, solve_membrane
from .membrane_forces import MEMBRANE_FORCE, accumulate_membrane, add_thread_bending
from .simd_sweep import PairConstraint, PairForce, accumulate_simd, for_each_spring_simd
from .step_params import COMPRESSION, DAMPING_TIME, STIFFNESS_FACTOR
from .vec import dot, length, neg, scale


@ti.func
def apply_pair_correction(cloth: ti.template(), features: ti.template(), a: int, b: int, shift, h):
    """Move a by its inverse mass times `shift` [kg·m], and b the other way."""
    apply_correction(cloth, features, a, scale(shift, cloth.inverse_mass[a]), h)
    apply_correction(cloth, features, b, scale(shift, neg(cloth.inverse_mass[b])), h)


@ti.func
def solve_distance(cloth: ti.template(), features: ti.template(), a, b, e, stiffness, params: ti.template(), h):
    """Position-based distance constraint; `stiffness` is 0…1."""
    w_a, w_b = cloth.inverse_mass[a], cloth.inverse_mass[b]
    gap = cloth.x[b] - cloth.x[a]
    shift = project_distance(gap, w_a + w_b, cloth.rest[e], stiffness * params[STIFFNESS_FACTOR])
    apply_pair_correction(cloth, features, a, b, shift, h)


@ti.func
def effective_stiffness(features: ti.template(), params: ti.template(), elongation, stiffness):
    """Return the stiffness at an elongation [m]: times `fabric.compression` where the spring is shortened.

    With a factor of 0 shortened springs have no force, and the spring energy is a convex function of all positions.
    """
    effective = stiffness
    if ti.static(features.soft_compression):
        effective = stiffness * ti.select(elongation < 0.0, params[COMPRESSION], 1.0)
    return effective


@ti.func
def solve_distance_xpbd(cloth: ti.template(), features: ti.template(), a, b, e, stiffness, params: ti.template(), h):
    """Compliant distance constraint of XPBD (Macklin 2016, Algorithm 1, lines 7–10). `multiplier` is the λ of (18).

    `stiffness` is in [N/m]; the formula takes it times the runtime factor and h², [kg].
    """
    w_a, w_b = cloth.inverse_mass[a], cloth.inverse_mass[b]
    gap = cloth.x[b] - cloth.x[a]
    damping_steps = 0.0
    growth = 0.0 * w_a
    if ti.static(features.spring_damping):
        start_gap = cloth.x_prev[b] - cloth.x_prev[a]
        damping_steps = params[DAMPING_TIME] / h
        growth = dot(gap, gap - start_gap) / ti.max(length(gap), TINY)
    # Whether it is shortened at the end of the substep depends on its elongation without its accumulated correction.
    elongation = length(gap) - cloth.rest[e] - cloth.multiplier[e] * (w_a + w_b)
    shift, change = project_distance_xpbd(
        gap,
        w_a + w_b,
        cloth.rest[e],
        effective_stiffness(features, params, elongation, stiffness) * (params[STIFFNESS_FACTOR] * h * h),
        cloth.multiplier[e],
        damping_steps,
        growth,
    )
    cloth.multiplier[e] = cloth.multiplier[e] + change
    apply_pair_correction(cloth, features, a, b, shift, h)


@ti.func
def spring_force(cloth: ti.template(), features: ti.template(), a, b, e, stiffness, params: ti.template(), h):
    """Return the force [N] on a of the damped spring e; in the SIMD layout also of the bending link beside it."""
    gap = cloth.x[b] - cloth.x[a]
    effective = effective_stiffness(features, params, length(gap) - cloth.rest[e], stiffness)
    force = hooke_force(gap, cloth.rest[e], effective * params[STIFFNESS_FACTOR])
    if ti.static(features.spring_damping):
        rate = cloth.velocity[b] - cloth.velocity[a]
        force += damper_force(gap, rate, effective * (params[STIFFNESS_FACTOR] * params[DAMPING_TIME]))
    if ti.static(features.bending and cloth.is_simd):
        force += scale(gap, cloth.bending_links.stiffness[e] * params[STIFFNESS_FACTOR])
    return force


@ti.func
def bending_force(cloth: ti.template(), features: ti.template(), a, b, e, stiffness, params: ti.template(), h):
    """Return the force [N] on a of bending link e (`geometry/bending.py`)."""
    if ti.static(cloth.is_simd):
        stiffness = cloth.bending_links.stiffness[e]
    return scale(cloth.x[b] - cloth.x[a], stiffness * params[STIFFNESS_FACTOR])


DISTANCE = PairConstraint(solve_distance)
DISTANCE_XPBD = PairConstraint(solve_distance_xpbd, damping_inputs=("x_prev",))
SPRING_FORCE = PairForce(spring_force, inputs=("x",), target="force", damping_inputs=("velocity",))
BENDING_FORCE = PairForce(bending_force, inputs=("x",), target="force")


# -- loops over all springs ------------------------------------------------------------------------------------------


@ti.func
def add_elastic_forces(cloth: ti.template(), features: ti.template(), params: ti.template(), h: float):
    """Add the force [N] of every spring, or triangle of a membrane or a weave, and of bending to `cloth.force`."""
    if ti.static(features.membrane):
        accumulate_membrane(cloth, features, MEMBRANE_FORCE, params, h)
        add_bending_forces(cloth, features, params, h)
        if ti.static(features.thread_bending):
            add_thread_bending(cloth, features, params)
    else:
        accumulate_pair_forces(cloth, cloth, features, SPRING_FORCE, params, h)
        if ti.static(not cloth.is_simd):  # where both are in one pass
            add_bending_forces(cloth, features, params, h)


@ti.func
def solve_elastic_constraints(cloth: ti.template(), features: ti.template(), params: ti.template(), h):
    """Solve the constraint of every spring, or every triangle of a membrane, once (XPBD)."""
    if ti.static(features.membrane):
        solve_membrane(cloth, features, params, h)
    else:
        for_each_spring(cloth, features, DISTANCE_XPBD, params, h)


@ti.func
def clear_elastic_multipliers(cloth: ti.template(), features: ti.template()):
    """Set λ = 0, once a substep: once an iteration would soften every spring."""
    if ti.static(features.membrane):
        clear_membrane_multipliers(cloth)
    else:
        clear_multipliers(cloth)


@ti.func
def add_bending_forces(cloth: ti.template(), features: ti.template(), params: ti.template(), h: float):
    """Add the force [N] of every bending link, if the cloth resists bending."""
    if ti.static(features.bending):
        accumulate_pair_forces(cloth, cloth.bending_links, features, BENDING_FORCE, params, h)


@ti.func
def accumulate_pair_forces(
    cloth: ti.template(),
    links: ti.template(),
    features: ti.template(),
    pair_force: ti.template(),
    params: ti.template(),
    h: float,
):
    """Add the quantity of every link, springs of the cloth or its bending links, to the sums of both ends."""
    sums = ti.static(attrgetter(pair_force.target)(cloth))
    if ti.static(cloth.is_simd):
        accumulate_simd(cloth, features, pair_force, params, h)
    elif ti.static(cloth.is_parallel):  # each particle gathers from its own links: one loop instead of one per color
        for i in range(cloth.packet_count[None]):
            total = sums[i]
            for n in range(links.spring_first[i], links.spring_first[i + 1]):
                e = links.spring_rows[n]
                other = links.ends[e][0] + links.ends[e][1] - i
                total += pair_force.force(cloth, features, i, other, e, links.stiffness[e], params, h)
            sums[i] = total
    else:
        for e in range(links.spring_count[None]):
            a, b = links.ends[e]
            force = pair_force.force(cloth, features, a, b, e, links.stiffness[e], params, h)
            sums[a] = sums[a] + force  # `+=` on a field would be atomic
            sums[b] = sums[b] - force


@ti.func
def clear_multipliers(cloth: ti.template()):
    """Set λ = 0 of every spring."""
    for e in range(cloth.spring_count[None]):
        cloth.multiplier[e] = cloth.rest[e] * 0.0


def max_colors(cloth: object) -> int:
    """Return how many colors of springs the layout has room for; the SIMD layout has passes instead."""
    return 0 if cloth.is_simd else cloth.color_first.shape[0] - 1


@ti.func
def for_each_spring(
    cloth: ti.template(), features: ti.template(), constraint: ti.template(), params: ti.template(), h: float
):
    """Apply a constraint to every spring, color by color (Gauss–Seidel)."""
    for_each_spring_from(cloth, features, 0, ti.static(max_colors(cloth)), constraint, params, h)


@ti.func
def for_each_spring_from(
    cloth: ti.template(),
    features: ti.template(),
    first: int,
    most: ti.template(),
    constraint: ti.template(),
    params: ti.template(),
    h: float,
):
    """Apply a constraint to every spring from color `first` on, of which there are no more than `most`.

    Springs of one color share no particle, so none waits for the result of another: 6 ns a spring against 15 ns in grid
    order, and under 1 ns where eight are solved at once.
    """
    if ti.static(cloth.is_simd):
        for_each_spring_simd(cloth, features, first, constraint, params, h)
    elif ti.static(cloth.is_parallel):  # one parallel loop per color; unused colors are empty
        for s in ti.static(range(most)):
            last = ti.static(max_colors(cloth))
            here, end = ti.min(first + s, last), ti.min(first + s + 1, last)
            for e in range(cloth.color_first[here], cloth.color_first[end]):
                constraint.apply(cloth, features, cloth.ends[e][0], cloth.ends[e][1], e, cloth.stiffness[e], params, h)
    else:
        for s in range(first, cloth.color_count[None]):
            for e in range(cloth.color_first[s], cloth.color_first[s + 1]):
                constraint.apply(cloth, features, cloth.ends[e][0], cloth.ends[e][1], e, cloth.stiffness[e], params, h)
