"""`explicit`: symplectic Störmer–Verlet integration of spring-damper forces, in kick–drift–kick form (Hairer, Lubich
and Wanner 2003, *Geometric numerical integration illustrated by the Störmer–Verlet method*, eq. 1.4).

It has no iterations, and is the most accurate solver where its small substeps can be afforded: of second order, and of
first where forces depend on velocity (damping, wind), which is that of half a substep before.
"""

import taichi as ti

from ..geometry.stability_bounds import min_symplectic_substeps
from ..kernels.integration import integrate, move_kinematic_particles
from ..kernels.springs import add_elastic_forces
from ..kernels.step_params import VELOCITY_FACTOR
from ..scene.schema import FRAME_SECONDS
from .base import ExplicitSolver
from .pipeline import add_external_forces, begin_substep, project_constraints, stop_at_colliders


@ti.func
def predict(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Kick and drift. The frame begins and ends with half a kick; between substeps two halves make one."""
    begin_substep(cloth, features, ctx)
    move_kinematic_particles(cloth, features, ctx, ctx.s, False)  # they are there: forces need their velocity
    add_external_forces(cloth, features, ctx, ctx.s, 1)
    add_elastic_forces(cloth, features, ctx.params, ctx.h)
    kick, drift = 1.0, ctx.h
    if ctx.s == 0 or ctx.s == ctx.substeps:
        kick = 0.5
    if ctx.s == ctx.substeps:
        drift = 0.0
    integrate(cloth, features, ctx.params, kick * ctx.h, ti.pow(ctx.params[VELOCITY_FACTOR], kick), drift)
    if ctx.s == ctx.substeps:  # the frame ends with the velocities of held particles, which `integrate` sets to 0
        move_kinematic_particles(cloth, features, ctx, ctx.s, False)


@ti.func
def finalize(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    move_kinematic_particles(cloth, features, ctx, ctx.s + 1.0)
    project_constraints(cloth, features, ctx)


class Explicit(ExplicitSolver):
    """Explicit symplectic Verlet."""

    predict = staticmethod(predict)
    finalize = staticmethod(finalize)
    end_frame = staticmethod(stop_at_colliders)
    final_half_step = True

    def min_stable_substeps(self, damping_time: float) -> int:
        return min_symplectic_substeps(self.frequency, damping_time, FRAME_SECONDS)
