"""The methods, by the name a scene gives."""

from .base import FrameInput, Solver, Stages
from .verlet import Verlet
from .xpbd import Xpbd

SOLVERS: dict[str, type[Verlet] | type[Xpbd]] = {solver.name: solver for solver in (Verlet, Xpbd)}

__all__ = ["SOLVERS", "FrameInput", "Solver", "Stages"]
