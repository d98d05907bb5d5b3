"""`xpbd`: position-based dynamics with compliance. Springs have SI constants, and what they mean does not change
with substeps, iterations or grid once the iteration converges (Macklin et al. 2016, *XPBD*, Algorithm 1).
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
from ..kernels.springs import RELAX_COMPLIANT, add_bending, for_springs, forget_multipliers, limit_strain
from ..kernels.tethers import pull_tethers
from .base import Solver


@ti.func
def before(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    find_tangles(cloth, stages, now)
    forget_anchors(cloth, stages, now)
    add_air(cloth, stages, now, now.s)
    add_repulsion(cloth, stages, now, now.s)
    add_bending(cloth, stages, now.controls, now.h)
    move_freely(cloth, stages, now.controls, now.h, now.controls[KEPT], now.h)  # (1)
    lead_held(cloth, stages, now, now.s + 1.0)
    forget_multipliers(cloth)  # (4)


@ti.func
def sweep(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """Steps (6)–(11), and contact, of the cloth with itself too: a stack is carried, and held by friction, through as
    many of its layers as there are iterations. Velocities (15) take up at once what moves particles.
    """
    for_springs(cloth, stages, RELAX_COMPLIANT, now.controls, now.h)
    keep_apart(cloth, stages, now)
    push_out(cloth, stages, now)


@ti.func
def after(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    pull_tethers(cloth, stages, now)
    limit_strain(cloth, stages, now.controls, now.h)


class Xpbd(Solver):
    """Advances a cloth by XPBD."""

    name = "xpbd"
    springs = "fabric"
    before = staticmethod(before)
    sweep = staticmethod(sweep)
    after = staticmethod(after)
