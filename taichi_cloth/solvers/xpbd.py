"""`xpbd`: position-based dynamics with compliance. Springs have SI constants, and what they mean does not change
with substeps, iterations or grid once the iteration converges (Macklin et al. 2016, *XPBD*, Algorithm 1).
"""

import taichi as ti

from ..contact.push_out import push_out
from ..kernels.controls import KEPT
from ..kernels.forces import add_air, forget_forces
from ..kernels.grab import lead_held
from ..kernels.motion import drift, kick, take_up_corrections
from ..kernels.springs import for_springs, forget_multipliers, limit_strain, relax_compliant
from ..kernels.tethers import pull_tethers
from .base import Solver


@ti.func
def before(
    cloth: ti.template(),
    stages: ti.template(),
    s: int,
    substeps: int,
    h: float,
    held: int,
    controls: ti.template(),
    spheres: ti.template(),
    boxes: ti.template(),
    ground: ti.template(),
):
    forget_forces(cloth)
    add_air(cloth, stages, controls, h, s * h)
    kick(cloth, controls, h, controls[KEPT])
    drift(cloth, h)  # (1)
    lead_held(cloth, stages, held, controls, (s + 1) / substeps, h * substeps)
    forget_multipliers(cloth)  # (4)


@ti.func
def sweep(
    cloth: ti.template(),
    stages: ti.template(),
    s: int,
    substeps: int,
    h: float,
    held: int,
    controls: ti.template(),
    spheres: ti.template(),
    boxes: ti.template(),
    ground: ti.template(),
):
    """Steps (6)–(11), and contact."""
    for_springs(cloth, stages, relax_compliant, controls, h)
    push_out(cloth, stages, spheres, boxes, ground, (s + 1) / substeps, 1.0 / substeps)


@ti.func
def after(
    cloth: ti.template(),
    stages: ti.template(),
    s: int,
    substeps: int,
    h: float,
    held: int,
    controls: ti.template(),
    spheres: ti.template(),
    boxes: ti.template(),
    ground: ti.template(),
):
    pull_tethers(cloth, stages, s, held, controls)
    limit_strain(cloth, stages, controls, h)
    take_up_corrections(cloth, h)  # (15)


class Xpbd(Solver):
    """Advances a cloth by XPBD."""

    name = "xpbd"
    springs = "fabric"
    before = staticmethod(before)
    sweep = staticmethod(sweep)
    after = staticmethod(after)
    paths = ("list", "lanes", "gather")
