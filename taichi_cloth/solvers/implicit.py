"""`implicit`: Newton's method with conjugate gradients (Baraff and Witkin 1998, *Large steps in cloth simulation*), in
implicit steps of second order.

Each of the two stages of `two_stage.py` is a backward Euler step. With h its length and y = x + h·v + h²·a the position
without springs, it ends at the x with M·(x − y) = h²·f(x), where f are the forces of springs and bending links. An
iteration is a step of Newton's method: with the stiffness matrix K at the present positions (K = −∂f/∂x) and Σδ, the
displacement since y, it moves all particles by the δ of

    (M + h²K)·δ = h²·f(x) − M·Σδ,    x ← x + δ

A shortened spring has no stiffness across its direction here, although its force has a negative one there: so the
matrix is positive definite (Choi and Ko 2002, *Stable but responsive cloth*, section 4), and conjugate gradients solve
the equation. They never form the matrix: a product with it is one pass over the springs. The next iteration takes up
what an inexact solution leaves. A particle that moves far leaves more, since forces are linear only nearby: the
iteration then takes more than one step. Damping of springs (`damping_time`) is left out.
"""

from dataclasses import replace

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..geometry.topology import Topology
from ..kernels.conjugate_gradient import (
    MAX_PRODUCTS,
    PARTIAL_SUMS,
    cg_finish,
    cg_init,
    cg_iterate,
    cg_solve,
    largest_square,
    parallel_largest_square,
)
from ..kernels.constraint_math import TINY
from ..kernels.forces import consume_force
from ..kernels.springs import add_elastic_forces
from ..kernels.vec import scale, select
from ..state import ClothState
from ..state.constraint_data import attach_cg_state
from ..state.solver_data import attach_correction
from .base import Features, FrameInput
from .pipeline import final_phases
from .two_stage import STAGE_LENGTH, TwoStageSolver, accelerate, begin_stage, move_with_velocity

LINEAR_RANGE = 0.03  # of the shortest spring: an error of 0.1 % in a force; with 1 % a narrow fold shakes
MAX_STEPS = 8  # of Newton's method in an iteration
PRODUCTS_PER_CHECK = 4  # of the matrix and a direction, between two checks of convergence; divides MAX_PRODUCTS


@ti.func
def predict(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Move every particle to y, and driven particles to where they are."""
    begin_stage(cloth, features, ctx)
    accelerate(cloth, ctx.params, ctx.h * STAGE_LENGTH)
    for i in range(cloth.packet_count[None]):
        cloth.correction[i] = cloth.x[i] * 0.0


@ti.func
def write_residual(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Set the right side of the equation [kg·m], 0 for particles that are not free."""
    h = ctx.h * STAGE_LENGTH
    add_elastic_forces(cloth, features, ctx.params, h)
    for i in range(cloth.packet_count[None]):
        mass = 1.0 / ti.max(cloth.inverse_mass[i], TINY)
        residual = consume_force(cloth, i) * (h * h) - scale(cloth.correction[i], mass)
        cloth.cg.residual[i] = select(cloth.inverse_mass[i] > 0.0, residual, residual * 0.0)


@ti.func
def apply_solution(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    h = ctx.h * STAGE_LENGTH
    for i in range(cloth.packet_count[None]):
        cloth.correction[i] = cloth.correction[i] + cloth.cg.solution[i]
        cloth.velocity[i] = cloth.velocity[i] + cloth.cg.solution[i] * (1.0 / h)
    move_with_velocity(cloth, h)


@ti.func
def iterate(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """One step of Newton's method, or more as long as a particle moves farther than forces are linear."""
    steps, linear = 0, False
    while not linear and steps < ti.static(MAX_STEPS):
        write_residual(cloth, features, ctx)
        cg_solve(cloth, cloth.cg, features, ctx.params, ctx.h * STAGE_LENGTH)
        apply_solution(cloth, features, ctx)
        linear = largest_square(cloth, cloth.cg.solution) <= cloth.cg.linear_range[None]
        steps += 1


@ti.func
def start_iteration(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """The beginning of a parallel step of Newton's method; `cg_iteration` and `end_iteration` follow."""
    write_residual(cloth, features, ctx)
    cg_init(cloth, cloth.cg, ctx.h * STAGE_LENGTH)


@ti.func
def cg_iteration(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    cg_iterate(cloth, cloth.cg, features, ctx.params, ctx.h * STAGE_LENGTH)


@ti.func
def end_iteration(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    cg_finish(cloth, cloth.cg)
    apply_solution(cloth, features, ctx)
    parallel_largest_square(cloth, cloth.cg.solution, cloth.cg.largest_move)


class Implicit(TwoStageSolver):
    """Newton's method with conjugate gradients, in substeps of two stages."""

    predict = staticmethod(predict)
    iterate = staticmethod(iterate)
    needs_coloring = False
    needs_previous_positions = False

    def __init__(
        self, cloth: ClothState, topology: Topology, stiffness: NDArray[np.float64], features: Features, layout: str
    ) -> None:
        super().__init__(cloth, topology, stiffness, replace(features, spring_damping=False), layout)
        attach_correction(self.layout)
        attach_cg_state(self.layout, PARTIAL_SUMS)
        self.layout.cg.linear_range[None] = (LINEAR_RANGE * topology.rest.min(initial=np.inf)) ** 2

    def damping_time(self, wanted: float) -> float:
        """Return 0 s: dampers of springs are left out."""
        return 0.0

    def _step_in_parallel(self, frame: FrameInput) -> None:
        cg = self.layout.cg

        for s in range(frame.first, frame.last):

            def run(*phases: object, s: int = s) -> None:
                self.runner.run([(phase, s) for phase in phases], frame.shared_arguments)

            run(self.predict)
            for _ in range(frame.iterations):
                for _ in range(MAX_STEPS):
                    run(start_iteration)
                    goal = cg.goal[None]
                    for _ in range(MAX_PRODUCTS // PRODUCTS_PER_CHECK):
                        if cg.squares[None] <= goal:
                            break
                        run(*[cg_iteration] * PRODUCTS_PER_CHECK)
                    run(end_iteration)
                    if cg.largest_move[None] <= cg.linear_range[None]:
                        break
            run(self.finalize, *final_phases(self.features.penetration_free))
        if self._ends_frame(frame):
            self.runner.run([(self.end_frame, frame.substeps)], frame.shared_arguments)

    def _force_frequency(self, topology: Topology, stiffness: NDArray[np.float64]) -> float:
        return 0.0  # springs and bending links are both in the matrix
