"""`xpbd`: extended position-based dynamics (Macklin, Müller and Chentanez 2016, *XPBD: position-based simulation of
compliant constrained dynamics*, Algorithm 1). Numbers such as (4) below are lines of the algorithm.

     (1)  x̃ = x + h·v + h²·M⁻¹·f          prediction
     (4)  λ = 0
          in each iteration, for each spring:
     (7)    Δλ by eq. 18, with damping by eq. 26   `constraint_math.project_distance_xpbd`
     (8)    Δx = M⁻¹·∇C·Δλ  (eq. 17)
     (9)    λ ← λ + Δλ
    (10)    x ← x + Δx
    (15)  x of the next step
    (16)  v = (x − x_prev)/h

Springs have SI stiffness. Once the iterations converge, it does not depend on substeps, iterations or grid. A membrane
has triangles instead of springs (`kernels/membrane_constraints.py`).
"""

import taichi as ti

from ..kernels.integration import integrate, move_kinematic_particles
from ..kernels.springs import add_bending_forces, clear_elastic_multipliers, solve_elastic_constraints
from ..kernels.step_params import VELOCITY_FACTOR
from .base import Solver
from .pipeline import (
    add_external_forces,
    begin_substep,
    end_substep,
    find_self_contacts,
    iterate_self_contacts,
    project_colliders,
    project_distance_bounds,
    project_strain_limit,
)


@ti.func
def predict(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    begin_substep(cloth, features, ctx)
    add_external_forces(cloth, features, ctx, ctx.s, 1)
    add_bending_forces(cloth, features, ctx.params, ctx.h)
    integrate(cloth, features, ctx.params, ctx.h, ctx.params[VELOCITY_FACTOR], ctx.h)  # (1)
    move_kinematic_particles(cloth, features, ctx, ctx.s + 1.0)
    find_self_contacts(cloth, features, ctx)
    clear_elastic_multipliers(cloth, features)  # (4)


@ti.func
def iterate(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Solve springs and contact once. Each correction changes the velocity too: their sum over the substep is (16).

    Self-contact is part of each iteration: a stack is supported, and held by friction, through as many layers as there
    are iterations.
    """
    solve_elastic_constraints(cloth, features, ctx.params, ctx.h)  # (6)–(11)
    iterate_self_contacts(cloth, features, ctx)
    project_colliders(cloth, features, ctx)


@ti.func
def finalize(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    project_distance_bounds(cloth, features, ctx)
    project_strain_limit(cloth, features, ctx, ctx.h)
    end_substep(cloth, features, ctx)


class Xpbd(Solver):
    """Extended position-based dynamics."""

    predict = staticmethod(predict)
    iterate = staticmethod(iterate)
    finalize = staticmethod(finalize)
    iterates_contact = True
