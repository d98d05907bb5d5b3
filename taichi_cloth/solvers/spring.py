"""`spring`: explicit symplectic Verlet on spring-damper forces. No iteration, and the most accurate method wherever its
small substeps can be paid for: of second order, and of first where forces depend on velocity (damping, dashpots, air),
since they see that of half a substep ago (Störmer–Verlet in kick–drift–kick form; Hairer, Lubich and
Wanner 2003, *Geometric numerical integration illustrated by the Störmer–Verlet method*, eq. 1.4).
"""

import taichi as ti

from ..contact.push_out import push_out
from ..contact.responses import add_repulsion
from ..contact.self_collision import keep_apart
from ..contact.sticking import forget_anchors
from ..contact.tangles import find_tangles
from ..kernels.controls import KEPT
from ..kernels.forces import add_air
from ..kernels.grab import lead_held
from ..kernels.motion import move_freely
from ..kernels.springs import add_spring_forces, limit_strain
from ..kernels.tethers import pull_tethers
from ..mesh.frequency import stable_substeps
from ..scene.model import FRAME_SECONDS
from .base import ExplicitSolver


@ti.func
def before(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """Forces at the present places, and where they lead.

    Half a kick opens the frame and half a kick closes it; two halves are one.
    """
    find_tangles(cloth, stages, now)
    forget_anchors(cloth, stages, now)
    lead_held(cloth, stages, now, now.s)  # where it is already: its velocity, for the forces
    add_air(cloth, stages, now, now.s)
    add_repulsion(cloth, stages, now, now.s)
    add_spring_forces(cloth, stages, now.controls, now.h)
    share, ahead = 1.0, now.h
    if now.s == 0 or now.s == now.substeps:
        share = 0.5
    if now.s == now.substeps:
        ahead = 0.0
    move_freely(cloth, stages, now.controls, share * now.h, ti.pow(now.controls[KEPT], share), ahead)


@ti.func
def after(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    lead_held(cloth, stages, now, now.s + 1.0)
    pull_tethers(cloth, stages, now)
    keep_apart(cloth, stages, now)
    push_out(cloth, stages, now)
    limit_strain(cloth, stages, now.controls, now.h)


class Spring(ExplicitSolver):
    """Advances a cloth by explicit symplectic Verlet."""

    name = "spring"
    springs = "fabric"
    before = staticmethod(before)
    after = staticmethod(after)
    closing = True

    def least_substeps(self, damping_time: float) -> int:
        return stable_substeps(self.frequency, damping_time, FRAME_SECONDS)
