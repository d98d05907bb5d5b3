"""`verlet`: position-based dynamics with Verlet integration (Müller et al. 2007), the method of the browser demos.

The velocity is the difference of two positions, and a stiffness of 0…1 is the part of a length error that one iteration
corrects. What it means therefore depends on substeps, iterations and grid.
"""

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..kernels.constraint_math import verlet_step
from ..kernels.forces import consume_acceleration
from ..kernels.integration import move_kinematic_particles
from ..kernels.springs import DISTANCE, for_each_spring
from ..kernels.step_params import VELOCITY_FACTOR
from ..kernels.vec import select
from ..state import field_pool as fields
from .base import Solver
from .pipeline import (
    add_external_forces,
    begin_substep,
    end_substep,
    project_colliders,
    project_distance_bounds,
    project_self_contacts,
    project_strain_limit,
)


@ti.func
def predict_positions(cloth: ti.template(), params: ti.template(), h: float):
    """Verlet step of every free particle."""
    for i in range(cloth.packet_count[None]):
        x = cloth.x[i]
        predicted = verlet_step(x, cloth.x_prev[i], params[VELOCITY_FACTOR], consume_acceleration(cloth, i, params), h)
        cloth.x[i] = select(cloth.inverse_mass[i] > 0.0, predicted, x)
        cloth.x_prev[i] = x


@ti.func
def predict(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    begin_substep(cloth, features, ctx)
    add_external_forces(cloth, features, ctx, ctx.s, 1)
    predict_positions(cloth, ctx.params, ctx.h)
    move_kinematic_particles(cloth, features, ctx, ctx.s + 1.0)


@ti.func
def iterate(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    for_each_spring(cloth, features, DISTANCE, ctx.params, ctx.h)
    project_colliders(cloth, features, ctx)


@ti.func
def finalize(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    project_self_contacts(cloth, features, ctx)
    project_distance_bounds(cloth, features, ctx)
    project_strain_limit(cloth, features, ctx, ctx.h)
    end_substep(cloth, features, ctx)


@ti.kernel
def rescale_velocities(cloth: ti.template(), ratio: float):
    for i in range(cloth.packet_count[None]):
        cloth.x_prev[i] = cloth.x[i] - (cloth.x[i] - cloth.x_prev[i]) * ratio


class Verlet(Solver):
    """Position-based dynamics with Verlet integration."""

    predict = staticmethod(predict)
    iterate = staticmethod(iterate)
    finalize = staticmethod(finalize)
    iterates_contact = True
    stores_velocity = False

    def velocities(self, h: float) -> NDArray[np.float64]:
        x, x_prev = (self.cloth.to_numpy(f).astype(np.float64) for f in (self.cloth.x, self.cloth.x_prev))
        return (x - x_prev) / h

    def set_velocities(self, velocities: NDArray[np.float64], h: float, of: object = slice(None)) -> None:
        x_prev = self.cloth.to_numpy(self.cloth.x_prev)
        x_prev[of] = self.cloth.to_numpy(self.cloth.x)[of] - velocities * h
        fields.upload(self.cloth.x_prev, x_prev)

    def change_substep(self, old: float, new: float) -> None:
        rescale_velocities(self.cloth, new / old)
