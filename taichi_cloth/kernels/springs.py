"""What is done to every spring: relaxed as a distance, relaxed with compliance, limited, one after the other; and what
each gives to sums over its ends, such as their forces.

Each function treats one spring in slot `e` between the particles in slots `a` and `b`, or eight springs at
once (`places.py`).
"""

from operator import attrgetter
from typing import Any

import taichi as ti

from .controls import COMPRESSION, DAMPING_TIME, MOST_STRAIN, STIFFNESS
from .maths import TINY, dashpot_pull, project_compliant, project_distance, spring_pull
from .motion import displace
from .places import dot, length, minus, times
from .strips import Share, Treatment, for_strip_springs, sum_strip_springs


@ti.func
def bring_together(cloth: ti.template(), stages: ti.template(), a: int, b: int, shift, h):
    """Moves a by its inverse mass times `shift` [kg·m], and b the other way."""
    displace(cloth, stages, a, times(shift, cloth.inverse_mass[a]), h)
    displace(cloth, stages, b, times(shift, minus(cloth.inverse_mass[b])), h)


@ti.func
def relax(cloth: ti.template(), stages: ti.template(), a, b, e, stiffness, controls: ti.template(), h):
    """Moves both particles towards the rest length; `stiffness` is the family's share 0…1."""
    w_a, w_b = cloth.inverse_mass[a], cloth.inverse_mass[b]
    gap = cloth.x[b] - cloth.x[a]
    shift = project_distance(gap, w_a + w_b, cloth.rest[e], stiffness * controls[STIFFNESS])
    bring_together(cloth, stages, a, b, shift, h)


@ti.func
def bearing(stages: ti.template(), controls: ti.template(), error, stiffness):
    """The constant with which a spring resists that is longer than at rest by `error` [m], or shorter: where threads
    go slack, a share of its own. With a share of 0 the energy of springs is a convex function of all places.
    """
    bears = stiffness
    if ti.static(stages.slack):
        bears = stiffness * ti.select(error < 0.0, controls[COMPRESSION], 1.0)
    return bears


@ti.func
def relax_compliant(cloth: ti.template(), stages: ti.template(), a, b, e, stiffness, controls: ti.template(), h):
    """The same for a spring of `stiffness` [N/m], with the multiplier it has gathered in this substep."""
    w_a, w_b = cloth.inverse_mass[a], cloth.inverse_mass[b]
    gap = cloth.x[b] - cloth.x[a]
    gamma = 0.0
    grown = 0.0 * w_a
    if ti.static(stages.spring_damping):
        before = cloth.x_prev[b] - cloth.x_prev[a]
        gamma = controls[DAMPING_TIME] / h
        grown = dot(gap, gap - before) / ti.max(length(gap), TINY)
    # What it does at the end of the substep hangs on its error without the pull that it has gathered.
    free = length(gap) - cloth.rest[e] - cloth.multiplier[e] * (w_a + w_b)
    shift, change = project_compliant(
        gap,
        w_a + w_b,
        cloth.rest[e],
        bearing(stages, controls, free, stiffness) * (controls[STIFFNESS] * h * h),
        cloth.multiplier[e],
        gamma,
        grown,
    )
    cloth.multiplier[e] = cloth.multiplier[e] + change
    bring_together(cloth, stages, a, b, shift, h)


@ti.func
def pull(cloth: ti.template(), stages: ti.template(), a, b, e, stiffness, controls: ti.template(), h):
    """Force [N] on a of the spring-damper e between a and b; in strips of their bond too."""
    gap = cloth.x[b] - cloth.x[a]
    bears = bearing(stages, controls, length(gap) - cloth.rest[e], stiffness)
    force = spring_pull(gap, cloth.rest[e], bears * controls[STIFFNESS])
    if ti.static(stages.spring_damping):
        rate = cloth.velocity[b] - cloth.velocity[a]
        force += dashpot_pull(gap, rate, bears * (controls[STIFFNESS] * controls[DAMPING_TIME]))
    if ti.static(stages.bending and cloth.in_lanes):
        force += times(gap, cloth.bonds.stiffness[e] * controls[STIFFNESS])
    return force


@ti.func
def bend(cloth: ti.template(), stages: ti.template(), a, b, e, constant, controls: ti.template(), h):
    """Force [N] on a of bond e between a and b (`mesh/bending.py`)."""
    if ti.static(cloth.in_lanes):
        constant = cloth.bonds.stiffness[e]
    return times(cloth.x[b] - cloth.x[a], constant * controls[STIFFNESS])


@ti.func
def hold_back(
    cloth: ti.template(), stages: ti.template(), a, b, e, stiffness, factor: ti.template(), controls: ti.template(), h
):
    """Brings a spring that is longer than the strain limit allows back to it (Provot 1995, section 5), and beyond it
    where the factor is more than 1.

    That is projected successive over-relaxation (Cryer 1971): the multiplier is what a spring has been drawn together
    by so far, of which it may give back what was too much, but no more. None pushes, and one that stays within its
    limit is left alone.
    """
    w_a, w_b = cloth.inverse_mass[a], cloth.inverse_mass[b]
    gap = cloth.x[b] - cloth.x[a]
    long = length(gap)
    over = long - cloth.rest[e] * (1.0 + controls[MOST_STRAIN])
    before = cloth.multiplier[e]
    held = ti.max(before + ti.select(stiffness > 0.0, factor, 0.0) * over / ti.max(w_a + w_b, TINY), 0.0)
    cloth.multiplier[e] = held
    bring_together(cloth, stages, a, b, times(gap, (held - before) / ti.max(long, TINY)), h)


@ti.func
def limit(cloth: ti.template(), stages: ti.template(), a, b, e, stiffness, controls: ti.template(), h):
    """To the limit and no farther."""
    hold_back(cloth, stages, a, b, e, stiffness, 1.0, controls, h)


@ti.func
def limit_ahead(cloth: ti.template(), stages: ti.template(), a, b, e, stiffness, controls: ti.template(), h):
    """In a sweep that is not one of the last."""
    hold_back(cloth, stages, a, b, e, stiffness, ti.static(over_relaxation(stages.strain_limit)), controls, h)


def over_relaxation(sweeps: int) -> float:
    """The factor for so many sweeps: what was too much dies away by this less 1 a sweep, to about e⁻⁴ in the end."""
    return 2.0 - 4.0 / (sweeps + 3.0)


def last_sweeps(sweeps: int) -> int:
    """How many of them are not over-relaxed: a quarter, and the only one. They even out what was too much.

    Thirty-three rows under ten times their weight, with a limit of 0.1 % at 60×8: 160 sweeps to the limit leave 7 % of
    that too much, 24 of these 5 %.
    """
    return -(-sweeps // 4)


RELAX = Treatment(relax)
RELAX_COMPLIANT = Treatment(relax_compliant, damped=("x_prev",))
LIMIT, LIMIT_AHEAD = Treatment(limit), Treatment(limit_ahead)
PULL = Share(pull, reads=("x",), into="force", damped=("velocity",))
BEND = Share(bend, reads=("x",), into="force")


@ti.func
def limit_strain(cloth: ti.template(), stages: ti.template(), controls: ti.template(), h: float):
    """The sweeps of the strain limit, where the scene has one."""
    if ti.static(stages.strain_limit > 0):
        forget_multipliers(cloth)
        last = ti.static(last_sweeps(stages.strain_limit))
        ahead = ti.static(stages.strain_limit - last)
        limit_times(cloth, stages, LIMIT_AHEAD, ahead, controls, h)
        limit_times(cloth, stages, LIMIT, last, controls, h)


@ti.func
def limit_times(
    cloth: ti.template(),
    stages: ti.template(),
    treat: ti.template(),
    sweeps: ti.template(),
    controls: ti.template(),
    h: float,
):
    if ti.static(cloth.gathers):  # its loops are parallel: they may not stand in another
        for _ in ti.static(range(sweeps)):
            for_springs(cloth, stages, treat, controls, h)
    elif ti.static(sweeps > 0):
        for _ in range(sweeps):
            for_springs(cloth, stages, treat, controls, h)


@ti.func
def add_spring_forces(cloth: ti.template(), stages: ti.template(), controls: ti.template(), h: float):
    """Adds the force [N] of every spring-damper and of every bond to cloth.force."""
    sum_links(cloth, cloth, stages, PULL, controls, h)
    if ti.static(not cloth.in_lanes):  # there springs and bonds are one pass
        add_bending(cloth, stages, controls, h)


@ti.func
def add_bending(cloth: ti.template(), stages: ti.template(), controls: ti.template(), h: float):
    """Adds the force [N] of every bond, where the sheet resists bending."""
    if ti.static(stages.bending):
        sum_links(cloth, cloth.bonds, stages, BEND, controls, h)


@ti.func
def sum_links(
    cloth: ti.template(), links: ti.template(), stages: ti.template(), share: ti.template(), controls: ti.template(), h
):
    """What each link, a spring of the cloth or one of its bonds, adds to the sums of both its ends."""
    sums = ti.static(attrgetter(share.into)(cloth))
    if ti.static(cloth.in_lanes):
        sum_strip_springs(cloth, stages, share, controls, h)
    elif ti.static(cloth.gathers):  # each particle asks its own springs: one loop instead of one for each colour
        for i in range(cloth.slot_count[None]):
            total = sums[i]
            for n in range(links.spring_first[i], links.spring_first[i + 1]):
                e = links.spring_rows[n]
                other = links.ends[e][0] + links.ends[e][1] - i
                total += share.of(cloth, stages, i, other, e, links.stiffness[e], controls, h)
            sums[i] = total
    else:
        for e in range(links.spring_count[None]):
            a, b = links.ends[e]
            given = share.of(cloth, stages, a, b, e, links.stiffness[e], controls, h)
            sums[a] = sums[a] + given  # a plain sum: `+=` on a field would be atomic
            sums[b] = sums[b] - given


@ti.func
def forget_multipliers(cloth: ti.template()):
    """λ = 0: once a substep, and before a limit. Once an iteration would make every spring too soft."""
    for e in range(cloth.spring_count[None]):
        cloth.multiplier[e] = cloth.rest[e] * 0.0


def most_batches(cloth: Any) -> int:
    """How many colours of springs the cloth has room for; strips have passes instead."""
    return 0 if cloth.in_lanes else cloth.batch_first.shape[0] - 1


@ti.func
def for_springs(cloth: ti.template(), stages: ti.template(), treat: ti.template(), controls: ti.template(), h: float):
    """One sweep: `treat` on every spring, colour by colour."""
    for_springs_from(cloth, stages, 0, ti.static(most_batches(cloth)), treat, controls, h)


@ti.func
def for_springs_from(
    cloth: ti.template(),
    stages: ti.template(),
    first: int,
    most: ti.template(),
    treat: ti.template(),
    controls: ti.template(),
    h: float,
):
    """The same, without the colours before the one of number `first`; no more than `most` are left.

    Springs of one colour share no particle, so that none waits for the result of the one before: 6 ns a spring
    against 15 ns in grid order, and under 1 ns where eight go at once.
    """
    if ti.static(cloth.in_lanes):
        for_strip_springs(cloth, stages, first, treat, controls, h)
    elif ti.static(cloth.gathers):  # one parallel loop for each colour; a colour that is not there is empty
        for s in ti.static(range(most)):
            last = ti.static(most_batches(cloth))
            here, end = ti.min(first + s, last), ti.min(first + s + 1, last)
            for e in range(cloth.batch_first[here], cloth.batch_first[end]):
                treat.apply(cloth, stages, cloth.ends[e][0], cloth.ends[e][1], e, cloth.stiffness[e], controls, h)
    else:
        for s in range(first, cloth.batch_count[None]):
            for e in range(cloth.batch_first[s], cloth.batch_first[s + 1]):
                treat.apply(cloth, stages, cloth.ends[e][0], cloth.ends[e][1], e, cloth.stiffness[e], controls, h)
