"""`rk4`: the classical Runge–Kutta method with four stages, on spring-damper forces (Hairer, Nørsett and Wanner 1993,
*Solving Ordinary Differential Equations I*, table II.1.2). Of fourth order where the motion is smooth.

The whole substep is in `finalize`; `predict` and `iterate` are empty. Contact and distance limits are projected once,
after the four stages.
"""

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..geometry.stability_bounds import min_rk4_substeps
from ..geometry.topology import Topology
from ..kernels.constraint_math import TINY
from ..kernels.forces import consume_acceleration
from ..kernels.integration import move_kinematic_particles
from ..kernels.springs import add_elastic_forces
from ..kernels.step_params import VELOCITY_FACTOR
from ..kernels.vec import select
from ..scene.schema import FRAME_SECONDS
from ..state import ClothState
from ..state.solver_data import attach_stage_sums
from .base import ExplicitSolver, Features
from .pipeline import add_external_forces, begin_substep, project_constraints, stop_at_colliders

MAX_DAMPING = 1.0  # of a substep: an explicit step overshoots beyond it


@ti.func
def save_state(cloth: ti.template()):
    """Store the start of the substep. Pinned particles have no velocity."""
    for i in range(cloth.packet_count[None]):
        v = cloth.velocity[i]
        v = select(cloth.inverse_mass[i] > 0.0, v, v * 0.0)
        cloth.x_prev[i] = cloth.x[i]
        cloth.velocity[i] = v
        cloth.stage_sums.first_velocity[i] = v
        cloth.stage_sums.velocity[i] = v * 0.0
        cloth.stage_sums.acceleration[i] = v * 0.0


@ti.func
def accumulate_stage(cloth: ti.template(), params: ti.template(), damping: float, weight: float, ahead: float):
    """Add this stage's derivative to the sums, and set the state of the next: from the start, `ahead` [s] along it.

    `damping` [1/s] is a force here: −damping·v.
    """
    for i in range(cloth.packet_count[None]):
        v = cloth.velocity[i]
        a = consume_acceleration(cloth, i, params) - v * damping
        a = select(cloth.inverse_mass[i] > 0.0, a, a * 0.0)
        cloth.stage_sums.velocity[i] = cloth.stage_sums.velocity[i] + v * weight
        cloth.stage_sums.acceleration[i] = cloth.stage_sums.acceleration[i] + a * weight
        cloth.x[i] = cloth.x_prev[i] + v * ahead
        cloth.velocity[i] = cloth.stage_sums.first_velocity[i] + a * ahead


@ti.func
def combine_stages(cloth: ti.template(), h: float):
    """Step from the start along the weighted mean of the stages."""
    for i in range(cloth.packet_count[None]):
        cloth.x[i] = cloth.x_prev[i] + cloth.stage_sums.velocity[i] * h
        cloth.velocity[i] = cloth.stage_sums.first_velocity[i] + cloth.stage_sums.acceleration[i] * h


@ti.func
def run_stage(cloth: ti.template(), features: ti.template(), ctx: ti.template(), stage: int):
    outer = stage == 0 or stage == 3
    time = ti.select(stage == 0, 0.0, ti.select(stage == 3, 1.0, 0.5))  # of this stage, in substeps
    move_kinematic_particles(cloth, features, ctx, ctx.s + time)
    add_external_forces(cloth, features, ctx, ctx.s + time, 1)
    add_elastic_forces(cloth, features, ctx.params, ctx.h)
    damping = ti.min(-ti.log(ti.max(ctx.params[VELOCITY_FACTOR], TINY)), MAX_DAMPING) / ctx.h
    weight = 1.0 / 6.0 if outer else 1.0 / 3.0
    accumulate_stage(cloth, ctx.params, damping, weight, ctx.h if stage == 2 else 0.5 * ctx.h)


@ti.func
def finalize(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    begin_substep(cloth, features, ctx)
    save_state(cloth)
    if ti.static(cloth.is_parallel):  # a parallel loop must be outermost, so the stages are unrolled
        for stage in ti.static(range(4)):
            run_stage(cloth, features, ctx, stage)
    else:
        for stage in range(4):
            run_stage(cloth, features, ctx, stage)
    combine_stages(cloth, ctx.h)
    move_kinematic_particles(cloth, features, ctx, ctx.s + 1.0)
    project_constraints(cloth, features, ctx)


class Rk4(ExplicitSolver):
    """The classical Runge–Kutta method."""

    finalize = staticmethod(finalize)
    end_frame = staticmethod(stop_at_colliders)

    def __init__(
        self, cloth: ClothState, topology: Topology, stiffness: NDArray[np.float64], features: Features, layout: str
    ) -> None:
        super().__init__(cloth, topology, stiffness, features, layout)
        attach_stage_sums(self.layout)

    def min_stable_substeps(self, damping_time: float) -> int:
        return min_rk4_substeps(self.frequency, damping_time, FRAME_SECONDS)
