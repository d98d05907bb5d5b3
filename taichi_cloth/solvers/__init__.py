"""All solvers by name. A new solver is a file here and an entry in `scene/solver_catalog.py`."""

from importlib import import_module

from ..scene.solver_catalog import SOLVER_CATALOG
from .base import Features, FrameInput, Solver
from .layout_choice import LAYOUTS, Unsupported, choose_layout


def _solver_class(name: str) -> type[Solver]:
    """Return the solver class of a module, called like the module with a capital, with its name and `info` set."""
    solver: type[Solver] = getattr(import_module(f".{name}", __name__), name.capitalize())
    solver.name, solver.info = name, SOLVER_CATALOG[name]
    return solver


SOLVERS: dict[str, type[Solver]] = {name: _solver_class(name) for name in SOLVER_CATALOG}

__all__ = ["LAYOUTS", "SOLVERS", "Features", "FrameInput", "Solver", "Unsupported", "choose_layout"]
