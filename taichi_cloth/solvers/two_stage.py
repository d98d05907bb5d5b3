"""Implicit steps of second order: the part of a substep that `lines` and `implicit` share.

A substep is the two-stage method of Alexander 1977 (*Diagonally implicit Runge–Kutta methods for stiff O.D.E.'s*,
section 2), which also damps stiff vibrations: two backward Euler steps of γh with γ = 1 − √½, and an extrapolation
between them.

    (1)  x₁ = x + γh·v₁         v₁ = v + γh·a₁
    (2)  x* = x + (1 − γ)h·v₁   v* = v + (1 − γ)h·a₁ = v + (v₁ − v)·(1 − γ)/γ
    (3)  x₂ = x* + γh·v₂        v₂ = v* + γh·a₂

Wind is explicit: its force is that at the positions after the drift, x + γh·v. Contact, tethers and the strain limit
change a velocity by an impulse c, which is not part of the acceleration a₁. Equation (2) adds it once,
v* = v + c + (v₁ − c − v)·(1 − γ)/γ. Extrapolated with the rest, c would throw back a particle that a collider has
stopped. Where the extrapolation leads into a collider, the position is projected and the velocity is not.

A frame counts stages: `ctx.s` increases by two in a substep, and `ctx.h` is half of one. The iterations of the scene
are run in each stage, twice in a substep. A stage solves for γh, which is `ctx.h * STAGE_LENGTH`.
"""

from dataclasses import replace
from math import sqrt

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..geometry.topology import Topology
from ..kernels.forces import consume_acceleration
from ..kernels.integration import move_kinematic_particles
from ..kernels.step_params import VELOCITY_FACTOR
from ..kernels.vec import select
from ..state import ClothState
from ..state.solver_data import attach_stage_start
from .base import Features, FrameInput, Solver
from .pipeline import (
    add_external_forces,
    begin_substep,
    end_substep,
    project_colliders,
    project_distance_bounds,
    project_self_contacts,
    project_strain_limit,
    stop_at_colliders,
)

GAMMA = 1 - sqrt(0.5)
STAGE_LENGTH = 2 * GAMMA  # of a backward Euler step, in stages
EXTRAPOLATION = 2 * (1 - 2 * GAMMA)  # from the end of the first step, in stages: (1 − γ)h from its start


@ti.func
def is_first_stage(ctx: ti.template()):
    return ctx.s % 2 == 0


@ti.func
def stage_end(ctx: ti.template()):
    """Return the time at which the stage ends, in stages since the start of the frame."""
    end = ctx.s + 1.0
    if is_first_stage(ctx):
        end = ctx.s + STAGE_LENGTH
    return end


@ti.func
def drift(cloth: ti.template(), velocity_factor: float, h: float):
    """Apply v ← velocity_factor·v and x ← x + h·v, and store the start of the stage. Pinned particles keep v = 0."""
    for i in range(cloth.packet_count[None]):
        x, velocity = cloth.x[i], cloth.velocity[i] * velocity_factor
        velocity = select(cloth.inverse_mass[i] > 0.0, velocity, velocity * 0.0)
        cloth.velocity[i] = velocity
        cloth.stage_start.velocity[i] = velocity
        cloth.x_prev[i] = x
        cloth.x[i] = x + velocity * h


@ti.func
def accelerate(cloth: ti.template(), params: ti.template(), h: float):
    """Apply v ← v + h·a and x ← x + h²·a."""
    for i in range(cloth.packet_count[None]):
        change = consume_acceleration(cloth, i, params) * h
        change = select(cloth.inverse_mass[i] > 0.0, change, change * 0.0)
        cloth.velocity[i] = cloth.velocity[i] + change
        cloth.x[i] = cloth.x[i] + change * h


@ti.func
def move_with_velocity(cloth: ti.template(), h: float):
    """Set x to x + h·v₁ of (1), which loses no correction to rounding.

    A correction may be smaller than the spacing of float32 at x. Added to x alone it is lost; the velocity collects it.
    In short steps all of them are lost: steps become explicit, and their energy grows. In a stiff cloth every iteration
    finds the same stretch that is rounding, and the velocity alone collects its corrections until x follows.
    """
    for i in range(cloth.packet_count[None]):
        x = cloth.x_prev[i] + cloth.velocity[i] * h
        cloth.x[i] = select(cloth.inverse_mass[i] > 0.0, x, cloth.x[i])


@ti.func
def prepare_extrapolation(cloth: ti.template()):
    """Store what (2) adds to the velocity, before contact changes it."""
    for i in range(cloth.packet_count[None]):
        change = cloth.velocity[i] - cloth.stage_start.velocity[i]
        cloth.stage_start.velocity[i] = change * ti.static((1 - GAMMA) / GAMMA - 1)


@ti.func
def end_stage(cloth: ti.template(), first: bool, velocity_factor: float, ahead: float):
    """Extrapolate (2) after the first stage, `ahead` [s]; after the second apply v ← velocity_factor·v."""
    for i in range(cloth.packet_count[None]):
        x, velocity = cloth.x[i], cloth.velocity[i]
        cloth.x_prev[i] = x
        if first:
            x = select(cloth.inverse_mass[i] > 0.0, x + velocity * ahead, x)
            velocity = velocity + cloth.stage_start.velocity[i]
        else:
            velocity = velocity * velocity_factor
        cloth.x[i] = x
        cloth.velocity[i] = velocity


@ti.func
def begin_stage(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Drift, move driven particles, and add external forces, which `accelerate` applies."""
    velocity_factor = 1.0
    if is_first_stage(ctx):
        velocity_factor = ctx.params[VELOCITY_FACTOR]
    begin_substep(cloth, features, ctx)
    drift(cloth, velocity_factor, ctx.h * STAGE_LENGTH)
    move_kinematic_particles(cloth, features, ctx, stage_end(ctx))
    add_external_forces(cloth, features, ctx, stage_end(ctx), 2)


@ti.func
def finalize(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    prepare_extrapolation(cloth)
    stage = ti.static(ctx._replace(dt_scale=STAGE_LENGTH))
    project_distance_bounds(cloth, features, stage)
    project_self_contacts(cloth, features, stage)
    project_colliders(cloth, features, ti.static(stage._replace(s=stage_end(ctx) - 1.0)))
    project_strain_limit(cloth, features, ctx, ctx.h * STAGE_LENGTH)
    ahead = 0.0
    if is_first_stage(ctx):
        ahead = EXTRAPOLATION
    end_stage(cloth, is_first_stage(ctx), ctx.params[VELOCITY_FACTOR], ctx.h * ahead)
    # Driven particles are extrapolated too: damping divides their motion in a stage by the length of the stage.
    move_kinematic_particles(cloth, features, ctx, stage_end(ctx) + ahead)
    position_only = ti.static(ctx._replace(update_velocity=False))
    project_distance_bounds(cloth, features, position_only)
    project_colliders(
        cloth, features, ti.static(position_only._replace(s=stage_end(ctx) + ahead - 1.0, dt_scale=ahead))
    )
    end_substep(cloth, features, ctx)


class TwoStageSolver(Solver):
    """A solver whose substep is two backward Euler steps with an extrapolation between them.

    A subclass has a `predict` that calls `begin_stage` and `accelerate`, and an `iterate`.
    """

    finalize = staticmethod(finalize)
    end_frame = staticmethod(stop_at_colliders)

    def __init__(
        self, cloth: ClothState, topology: Topology, stiffness: NDArray[np.float64], features: Features, layout: str
    ) -> None:
        super().__init__(cloth, topology, stiffness, features, layout)
        attach_stage_start(self.layout)

    def step(self, frame: FrameInput) -> None:
        params = frame.params.copy()
        params[VELOCITY_FACTOR] = sqrt(params[VELOCITY_FACTOR])  # half of the damping before a substep, half after
        span = (2 * frame.span[0], 2 * frame.span[1])
        super().step(replace(frame, substeps=2 * frame.substeps, h=frame.h / 2, params=params, span=span))
