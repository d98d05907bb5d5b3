"""`verlet`: damped Verlet, then relaxation of distances. The method of the browser demos.

Position-based dynamics (Müller et al. 2007) in its plainest form: velocity is the difference of two
positions, and a stiffness of 0…1 says how much of a length error one iteration puts right. What stiffness
means therefore changes with substeps, iterations and grid.
"""

from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..contact.push_out import push_out
from ..contact.responses import add_repulsion
from ..contact.self_collision import keep_apart
from ..contact.sticking import forget_anchors
from ..contact.tangles import find_tangles
from ..kernels.controls import KEPT
from ..kernels.forces import add_air, take_acceleration
from ..kernels.grab import lead_held
from ..kernels.maths import verlet_step
from ..kernels.places import choose
from ..kernels.springs import RELAX, for_springs, limit_strain
from ..kernels.tethers import pull_tethers
from ..state import fields
from .base import Solver


@ti.func
def predict(cloth: ti.template(), controls: ti.template(), h: float):
    """Every particle goes on as it moved, pulled by the external forces; a pin stays."""
    for i in range(cloth.slot_count[None]):
        x = cloth.x[i]
        onwards = verlet_step(x, cloth.x_prev[i], controls[KEPT], take_acceleration(cloth, i, controls), h)
        cloth.x[i] = choose(cloth.inverse_mass[i] > 0.0, onwards, x)
        cloth.x_prev[i] = x


@ti.func
def before(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """External forces, and every particle goes on as it moved."""
    find_tangles(cloth, stages, now)
    forget_anchors(cloth, stages, now)
    add_air(cloth, stages, now, now.s)
    add_repulsion(cloth, stages, now, now.s)
    predict(cloth, now.controls, now.h)
    lead_held(cloth, stages, now, now.s + 1.0)


@ti.func
def sweep(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    for_springs(cloth, stages, RELAX, now.controls, now.h)
    push_out(cloth, stages, now)


@ti.func
def after(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    keep_apart(cloth, stages, now)
    pull_tethers(cloth, stages, now)
    limit_strain(cloth, stages, now.controls, now.h)


@ti.kernel
def rescale_velocities(cloth: ti.template(), ratio: float):
    for i in range(cloth.slot_count[None]):
        cloth.x_prev[i] = cloth.x[i] - (cloth.x[i] - cloth.x_prev[i]) * ratio


class Verlet(Solver):
    """Advances a cloth by damped Verlet and relaxation."""

    name = "verlet"
    springs = "springs"
    before = staticmethod(before)
    sweep = staticmethod(sweep)
    after = staticmethod(after)
    own_velocity = False

    def velocities(self, h: float) -> NDArray[np.float64]:
        x, x_prev = (self.cloth.taken(f).astype(np.float64) for f in (self.cloth.x, self.cloth.x_prev))
        return (x - x_prev) / h

    def set_velocities(self, velocities: NDArray[np.float64], h: float, of: Any = slice(None)) -> None:
        before = self.cloth.taken(self.cloth.x_prev)
        before[of] = self.cloth.taken(self.cloth.x)[of] - velocities * h
        fields.put(self.cloth.x_prev, before)

    def change_substep(self, old: float, new: float) -> None:
        rescale_velocities(self.cloth, new / old)
