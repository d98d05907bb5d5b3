"""The methods, by the name a scene gives."""

from ..kernels.places import LANES
from .base import FrameInput, Solver, Stages
from .spring import Spring
from .verlet import Verlet
from .xpbd import Xpbd

SOLVERS: dict[str, type[Solver]] = {solver.name: solver for solver in (Verlet, Xpbd, Spring)}


def path_for(kind: type[Solver], shape: tuple[int, int], asked: str | None = None) -> str:
    """The layout a solver works on for a grid of (rows, columns).

    Raises ValueError where the one that is `asked` for is none of the solver's.
    """
    if asked is not None:
        if asked not in kind.paths:
            raise ValueError(f"{kind.name} has no path {asked!r}: {', '.join(kind.paths)}")
        return asked
    # Strips of one column or less are mostly empty: then springs one by one are as fast.
    return "lanes" if "lanes" in kind.paths and shape[1] >= LANES else "list"


__all__ = ["SOLVERS", "FrameInput", "Solver", "Stages", "path_for"]
