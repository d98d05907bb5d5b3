"""Properties of the solvers, for the schema, the documentation and the evaluation. Does not import Taichi."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SolverInfo:
    """Properties of one solver."""

    summary: str
    """One line for lists of solvers."""
    substeps: int
    """Default substeps per frame."""
    iterations: int
    """Default iterations per substep."""
    order: int
    """Order of convergence for smooth motion."""
    stiffness_section: str = "fabric"
    """Scene section of its spring stiffness: `fabric` in SI units, or `verlet` in 0…1."""
    is_explicit: bool = False
    """Whether it has no iterations and is stable only below a time step that depends on stiffness.

    If stability requires it, such a solver takes more substeps than the scene sets.
    """
    grid_only: bool = False
    """Whether it needs a grid with complete rows."""
    models: tuple[str, ...] = ("springs", "membrane")
    """Values of `fabric.model` that it supports; `verlet` does not read the constants of a membrane."""
    euler_steps: bool = False
    """Whether free fall is that of the semi-implicit Euler method, not the exact parabola."""

    @property
    def defaults(self) -> tuple[int, int]:
        """Default substeps per frame and iterations per substep."""
        return self.substeps, self.iterations

    @property
    def uses_si_constants(self) -> bool:
        """Whether its stiffness has SI units, independent of grid, substeps and iterations."""
        return self.stiffness_section == "fabric"


ALL_MODELS = ("springs", "membrane", "weave")
# The defaults of `verlet` are those of the browser demos. The defaults of `xpbd`, `lines` and `implicit` are the
# cheapest with which sheets up to 33×33 in `taichi-cloth validate` converge to the solution of a substep. `explicit`
# needs ten substeps for a soft damper, whose force lags by half a substep.
SOLVER_CATALOG: dict[str, SolverInfo] = {
    "verlet": SolverInfo(
        "position-based dynamics with Verlet integration", 5, 12, order=1, stiffness_section="verlet", euler_steps=True
    ),
    "xpbd": SolverInfo("extended position-based dynamics", 60, 4, order=1, euler_steps=True),
    "explicit": SolverInfo(
        "explicit symplectic Verlet on spring forces", 10, 1, order=2, is_explicit=True, models=ALL_MODELS
    ),
    "lines": SolverInfo(
        "XPBD with a direct solver along rows, columns and diagonals",
        10,
        2,
        order=2,
        grid_only=True,
        models=("springs",),
    ),
    "rk4": SolverInfo(
        "classical Runge–Kutta method on spring forces", 1, 1, order=4, is_explicit=True, models=ALL_MODELS
    ),
    "implicit": SolverInfo("implicit steps of second order by Newton's method", 20, 1, order=2),
}


def solver_names() -> list[str]:
    """Return the names of all solvers, for `name` in `[solver]` and for `switch_solver`."""
    return list(SOLVER_CATALOG)


def needs_other_model(solver: str, model: str) -> str:
    """Return why a solver is refused that does not support a `fabric.model`."""
    others = ", ".join(name for name, info in SOLVER_CATALOG.items() if model in info.models and info.uses_si_constants)
    return f'{solver} does not support fabric.model = "{model}"; use {others}'


def needs_a_grid(solver: str, reason: str) -> str:
    """Return why a solver that needs a grid is refused. `reason`: why the cloth is none."""
    others = ", ".join(name for name, info in SOLVER_CATALOG.items() if not info.grid_only)
    return f"{solver} needs a grid with whole rows, and {reason}; use {others}"
