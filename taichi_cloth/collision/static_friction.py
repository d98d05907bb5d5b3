"""Friction that takes more into account than one correction: the sums over a substep, and friction anchors.

Sums, for solvers with colliders in each iteration. The first iteration takes a particle's whole weight. Were friction
bounded by the normal correction of its own iteration, what springs pull afterwards would slip: cloth that lies on a
ball would creep off it. It is bounded by the sum of the normal corrections instead (Catto 2005, *Iterative dynamics
with temporal coherence*).

Friction anchors, for static friction between particles. Each pair in contact has an anchor: the gap between its
particles when contact began. Friction acts on the slide since then, not only on that of the last substep, and so pulls
the pair back to its anchor. Without anchors piles creep: a Jacobi iteration applies only a part of each correction, so
a loaded contact slides a little in every substep, and friction on the slide of one substep never takes that back.

This is the tangential spring of contact in granular media (Cundall and Strack 1979, *A discrete numerical model for
granular assemblies*), without a spring constant, because position-based friction corrects the slide itself. The
friction coefficient is the same. A pair slides, and moves its anchor along, if its slide exceeds the coefficient times
the sum of the substep's normal corrections.

An anchor belongs to an entry of the candidate list. All anchors are cleared at the start of a frame, so that a frame
depends on positions and velocities alone, and a run resumes from a checkpoint with the same bits.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.constraint_math import TINY
from ..kernels.step_params import SELF_FRICTION
from ..kernels.vec import dot, length, scale
from ..state.contact_data import TRIANGLE_COLORS

NEVER = -2  # neither this substep nor the one before


@ti.func
def clear_friction_sums(cloth: ti.template(), features: ti.template()):
    """Begin the sums of a substep."""
    if ti.static(features.friction_sums):
        for i in range(cloth.packet_count[None]):
            cloth.friction_sums.push[i] = cloth.x[i] * 0.0
            cloth.friction_sums.friction[i] = cloth.x[i] * 0.0
        if ti.static(features.triangles):
            for t in range(cloth.colored_triangles.first[ti.static(TRIANGLE_COLORS)]):
                cloth.friction_sums.triangle_push[t] = tm.vec3(0.0)
                cloth.friction_sums.triangle_friction[t] = tm.vec3(0.0)


@ti.func
def bounded_friction(push_sum, friction_sum, normal, slide, friction: float):
    """Return the friction correction that stops a slide, as far as the sums so far allow.

    `push_sum`: of all normal corrections, with that of this iteration; `friction_sum`: of all friction corrections
    before this one [m]. `slide`: the motion relative to the surface in this substep [m].
    """
    tangent = slide - scale(normal, dot(normal, slide))
    wanted = friction_sum - tangent
    limit = ti.max(friction * length(push_sum), length(friction_sum))  # friction with another collider stays
    return scale(wanted, ti.min(1.0, limit / ti.max(length(wanted), TINY))) - friction_sum


@ti.func
def add_friction(
    push_sums: ti.template(), friction_sums: ti.template(), i: int, push, normal, slide, friction: float, touching
):
    """Add this iteration's corrections to the sums of particle or triangle i. Return its friction correction [m].

    `touching`: 1 where it still touches the collider, else 0.
    """
    push_sum, friction_sum = push_sums[i] + push, friction_sums[i]
    correction = scale(bounded_friction(push_sum, friction_sum, normal, slide, friction), touching)
    push_sums[i], friction_sums[i] = push_sum, friction_sum + correction
    return correction


@ti.func
def clear_anchors_each_frame(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Expire the candidate list at the start of a frame, which clears the anchors."""
    if ti.static(features.static_friction):
        for _ in range(int(ctx.s == 0)):
            cloth.self_contact.list_thickness[None] = 0.0


@ti.func
def clear_anchors(cloth: ti.template(), count: int):
    """Clear the anchors of the first `count` pairs."""
    for k in range(ti.min(count, ti.static(cloth.friction_anchors.last_contact.shape[0]))):
        cloth.friction_anchors.last_contact[k] = NEVER


@ti.func
def slide_since_anchor(
    anchors: ti.template(), ctx: ti.template(), entry: int, normal: tm.vec3, start_gap: tm.vec3, push: tm.vec3
):
    """Return how far a pair had slid from its anchor at the start of the substep [m].

    Adds `push` to the pair's sum of normal corrections. The first contact of a substep moves the anchor along if the
    slide was larger than friction allowed in the substep before, or sets it if there was no contact then.
    """
    if anchors.last_contact[entry] != ctx.s:
        slide = tm.vec3(0.0)
        if anchors.last_contact[entry] == ctx.s - 1:
            slide = start_gap - anchors.gap[entry]
            slide = slide - normal * normal.dot(slide)  # `-=` does not work on unscalarized vectors
            limit = ctx.params[SELF_FRICTION] * anchors.normal_correction[entry]
            slide *= ti.min(1.0, limit / ti.max(slide.norm(), TINY))
        anchors.gap[entry] = start_gap - slide
        anchors.last_contact[entry] = ctx.s
        anchors.normal_correction[entry] = 0.0
    anchors.normal_correction[entry] += push.norm()
    return start_gap - anchors.gap[entry]
