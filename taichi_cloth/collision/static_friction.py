"""Static friction between particles by friction anchors.

Each pair in contact has an anchor: the gap between its particles when contact began. Friction acts on the slide since
then, not only on that of the last substep, and so pulls the pair back to its anchor. Without anchors piles creep: a
Jacobi iteration applies only a part of each correction, so a loaded contact slides a little in every substep, and
friction on the slide of one substep never takes that back.

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

NEVER = -2  # neither this substep nor the one before


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
