"""The methods, by the name a scene gives."""

from .base import FrameInput, Solver, Stages
from .verlet import Verlet

SOLVERS = {solver.name: solver for solver in (Verlet,)}

__all__ = ["SOLVERS", "FrameInput", "Solver", "Stages"]
