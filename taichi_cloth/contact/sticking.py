"""Friction that holds what lies: it takes back all that two particles have slid since they met, not in a substep alone.

All contacts of an iteration are put right by shares, so that one that carries a weight slides a little until its
friction is enough. Told by the slide of each substep alone it slides as far in the next one, and a heap creeps like
honey, however it is damped. Here a pair keeps an anchor, the gap that it had when it met, and is drawn back to it: the
tangential spring of Cundall and Strack (1979, *A discrete numerical model for granular assemblies*), which a position
needs no constant for. Friction is no stronger by that. What is farther from its anchor than a substep's pushes could
take back, slides, and drags it along.

An anchor is kept beside the pair in the list of candidates. All are forgotten at the beginning of a frame, which so
begins from places and velocities alone: a run that was saved, or measured, goes on with the same bits.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.controls import SELF_FRICTION
from ..kernels.maths import TINY

NEVER = -2  # no substep, nor the one before


@ti.func
def forget_anchors(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """At the beginning of a frame candidates are listed anew, where the scene asks for anchors."""
    if ti.static(stages.sticks):
        for _ in range(int(now.s == 0)):
            cloth.near.listed_for[None] = 0.0


@ti.func
def clear_anchors(cloth: ti.template(), count: int):
    """Of so many pairs, none has met yet."""
    for k in range(ti.min(count, ti.static(cloth.anchors.met.shape[0]))):
        cloth.anchors.met[k] = NEVER


@ti.func
def slid_since(
    anchors: ti.template(), now: ti.template(), row: int, apart: tm.vec3, gap_before: tm.vec3, push: tm.vec3
):
    """How far [m] a pair of the list had slid from its anchor as the substep began, and counts this push."""
    if anchors.met[row] != now.s:
        slid = tm.vec3(0.0)
        if anchors.met[row] == now.s - 1:
            slid = gap_before - anchors.gap[row]
            slid = slid - apart * apart.dot(slid)  # `-=` is not for vectors that stay whole
            slid *= ti.min(1.0, now.controls[SELF_FRICTION] * anchors.pushed[row] / ti.max(slid.norm(), TINY))
        anchors.gap[row] = gap_before - slid
        anchors.met[row] = now.s
        anchors.pushed[row] = 0.0
    anchors.pushed[row] += push.norm()
    return gap_before - anchors.gap[row]
