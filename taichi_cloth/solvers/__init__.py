"""The methods, by the name a scene gives."""

import difflib

import taichi as ti

from ..errors import WrongUse
from ..kernels.places import LANES
from .base import FrameInput, Solver, Stages
from .lines import Lines
from .projective import Projective
from .rk4 import Rk4
from .spring import Spring
from .verlet import Verlet
from .xpbd import Xpbd

SOLVERS: dict[str, type[Solver]] = {solver.name: solver for solver in (Verlet, Xpbd, Spring, Lines, Rk4, Projective)}


def path_for(
    kind: type[Solver],
    shape: tuple[int, int],
    asked: str | None = None,
    *,
    sheets: int = 1,
    triangles: bool = False,
    tears: bool = False,
) -> str:
    """The layout a solver works on, for a grid of (rows, columns) on the arch that Taichi was started on.

    `triangles`: bodies keep out whole triangles; `tears`: springs may go while it runs. Raises WrongUse for an unknown
    one, on a GPU for one that would run there on a single thread, for strips where they cannot serve, and for a method
    that cannot tear.
    """
    if asked is not None and asked not in kind.paths:
        near = difflib.get_close_matches(asked, kind.paths, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise WrongUse(f"{kind.name} has no path {asked!r}: {', '.join(kind.paths)}{hint}")
    if tears and not kind.tears:
        others = ", ".join(name for name, other in SOLVERS.items() if other.tears)
        raise WrongUse(f"{kind.name} cannot tear: it solves whole rows; take {others}")
    if ti.cfg.arch not in (ti.x64, ti.arm64):
        if asked not in (None, "gather"):
            raise WrongUse(f"path {asked} is for --arch cpu; a GPU has the path gather")
        return "gather"
    if asked == "lanes" and sheets > 1:
        raise WrongUse("path lanes is for one sheet: list and gather can do several")
    if asked == "lanes" and triangles:
        raise WrongUse("path lanes cannot keep bodies from triangles: list and gather can")
    if asked == "lanes" and tears:
        raise WrongUse("path lanes is for cloth that does not tear: list and gather can")
    if sheets > 1 or triangles or tears:
        return asked or "list"
    # Strips of one column or less are mostly empty: then springs one by one are as fast.
    return asked or next(path for path in kind.paths if path != "lanes" or shape[1] >= LANES)


__all__ = ["SOLVERS", "FrameInput", "Solver", "Stages", "path_for"]
