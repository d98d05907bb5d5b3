"""`projective`: backward Euler as a minimization, in rounds that all solve with one matrix (Liu, Bargteil, O'Brien and
Kavan 2013, *Fast simulation of mass-spring systems*).

With y = x + h·v + h²·a the position without springs, the substep ends where ½(x − y)ᵀM(x − y) + h²·E(x) is least. Given
the direction d_ij that each spring would have at its rest length (local step), that is linear: (M + h²L)·x = M·y +
h²·J·d (eq. 14, global step). Here the equation is solved for the displacement δ still to go, whose right side is the
residual of equilibrium, with the plain spring forces f and the displacements so far. That loses nothing to float32:

    (M + h²L)·δ = h²·f(x) − M·Σδ,    x ← x + δ

The matrix is constant, and the paper factorizes it once. Here it is never formed: conjugate gradients solve the
equation to a hundredth, with one pass over the springs for every product, and the next round takes up what is left. At
33×33 particles and ten rounds that takes less time than substitution in a Cholesky factor: 28 ms a frame, not 60.
Damping of springs (`damping_time`) is left out: backward Euler damps by itself.
"""

from dataclasses import replace

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..geometry.topology import Topology
from ..kernels.conjugate_gradient import MAX_PRODUCTS, PARTIAL_SUMS, cg_init, cg_iterate, cg_solve
from ..kernels.constraint_math import TINY
from ..kernels.forces import consume_force
from ..kernels.integration import apply_correction, integrate, move_kinematic_particles
from ..kernels.springs import add_spring_forces
from ..kernels.step_params import VELOCITY_FACTOR
from ..kernels.vec import scale, select
from ..state import ClothState
from ..state.constraint_data import attach_cg_state
from ..state.solver_data import attach_correction
from .base import Features, FrameInput, Solver
from .pipeline import add_external_forces, begin_substep, project_constraints

PRODUCTS_PER_CHECK = 4  # of the matrix and a direction, between two checks of convergence; divides MAX_PRODUCTS


@ti.func
def predict(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Move every particle to y, and driven particles to where they are."""
    begin_substep(cloth, features, ctx)
    add_external_forces(cloth, features, ctx, ctx.s, 1)
    integrate(cloth, features, ctx.params, ctx.h, ctx.params[VELOCITY_FACTOR], ctx.h)
    move_kinematic_particles(cloth, features, ctx, ctx.s + 1.0)
    for i in range(cloth.packet_count[None]):
        cloth.correction[i] = cloth.x[i] * 0.0


@ti.func
def write_residual(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Set the right side of the equation [kg·m], 0 for particles that are not free."""
    add_spring_forces(cloth, features, ctx.params, ctx.h)
    for i in range(cloth.packet_count[None]):
        mass = 1.0 / ti.max(cloth.inverse_mass[i], TINY)
        residual = consume_force(cloth, i) * (ctx.h * ctx.h) - scale(cloth.correction[i], mass)
        cloth.cg.residual[i] = select(cloth.inverse_mass[i] > 0.0, residual, residual * 0.0)


@ti.func
def apply_solution(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    for i in range(cloth.packet_count[None]):
        apply_correction(cloth, features, i, cloth.cg.solution[i], ctx.h)
        cloth.correction[i] = cloth.correction[i] + cloth.cg.solution[i]


@ti.func
def iterate(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """One round, in one serial launch."""
    write_residual(cloth, features, ctx)
    cg_solve(cloth, cloth.cg, features, ctx.params, ctx.h)
    apply_solution(cloth, features, ctx)


@ti.func
def start_round(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """The beginning of a parallel round; `cg_iteration` and `apply_solution` follow."""
    write_residual(cloth, features, ctx)
    cg_init(cloth, cloth.cg)


@ti.func
def cg_iteration(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    cg_iterate(cloth, cloth.cg, features, ctx.params, ctx.h)


class Projective(Solver):
    """Projective dynamics with conjugate gradients."""

    predict = staticmethod(predict)
    iterate = staticmethod(iterate)
    finalize = staticmethod(project_constraints)
    needs_coloring = False

    def __init__(
        self, cloth: ClothState, topology: Topology, stiffness: NDArray[np.float64], features: Features, layout: str
    ) -> None:
        super().__init__(cloth, topology, stiffness, replace(features, spring_damping=False), layout)
        attach_correction(self.layout)
        attach_cg_state(self.layout, PARTIAL_SUMS)

    def _step_in_parallel(self, frame: FrameInput) -> None:
        cg = self.layout.cg

        for s in range(frame.first, frame.last):

            def run(*phases: object, s: int = s) -> None:
                self.runner.run([(phase, s) for phase in phases], frame.shared_arguments)

            run(self.predict)
            for _ in range(frame.iterations):
                run(start_round)
                goal = cg.goal[None]
                for _ in range(MAX_PRODUCTS // PRODUCTS_PER_CHECK):
                    if cg.squares[None] <= goal:
                        break
                    run(*[cg_iteration] * PRODUCTS_PER_CHECK)
                run(apply_solution)
            run(self.finalize)

    def _force_frequency(self, topology: Topology, stiffness: NDArray[np.float64]) -> float:
        return 0.0  # springs and bending links are both in the matrix
