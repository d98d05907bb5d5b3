"""`xpbd`: position-based dynamics with compliance. Springs have SI constants, and what they mean does not change
with substeps, iterations or grid once the iteration converges (Macklin et al. 2016, *XPBD*, Algorithm 1).
"""

import taichi as ti

from ..contact.push_out import push_out
from ..kernels.controls import KEPT
from ..kernels.forces import add_air, forget_forces
from ..kernels.grab import lead_held
from ..kernels.motion import drift, kick, take_up_corrections
from ..kernels.springs import for_springs, limit_strain, relax_compliant
from .base import Solver


@ti.func
def forget_multipliers(cloth: ti.template()):
    """λ = 0 (step 4): once a substep. Once an iteration would make every spring too soft."""
    for e in range(cloth.spring_count[None]):
        cloth.multiplier[e] = cloth.rest[e] * 0.0


@ti.func
def step(
    cloth: ti.template(),
    stages: ti.template(),
    s: int,
    substeps: int,
    iterations: int,
    h: float,
    held: int,
    controls: ti.template(),
    spheres: ti.template(),
    boxes: ti.template(),
    ground: ti.template(),
):
    """One substep; numbers are those of Algorithm 1."""
    share = 1.0 / substeps
    passed = (s + 1) * share
    forget_forces(cloth)
    add_air(cloth, stages, controls, h, s * h)
    kick(cloth, controls, h, controls[KEPT])
    drift(cloth, h)  # (1)
    lead_held(cloth, stages, held, controls, passed, h * substeps)
    forget_multipliers(cloth)  # (4)
    for _ in range(iterations):  # (5)–(13)
        for_springs(cloth, stages, relax_compliant, controls, h)
        push_out(cloth, stages, spheres, boxes, ground, passed, share)
    limit_strain(cloth, stages, controls, h)
    take_up_corrections(cloth, h)  # (15)


class Xpbd(Solver):
    """Advances a cloth by XPBD."""

    name = "xpbd"
    springs = "fabric"
    step = staticmethod(step)
