"""The methods, by the name a scene gives."""

import difflib

import taichi as ti

from ..errors import WrongUse
from ..kernels.places import LANES
from ..mesh.topology import NO_GRID
from .base import FrameInput, Solver, Stages
from .lines import Lines
from .projective import Projective
from .rk4 import Rk4
from .spring import Spring
from .verlet import Verlet
from .xpbd import Xpbd

SOLVERS: dict[str, type[Solver]] = {solver.name: solver for solver in (Verlet, Xpbd, Spring, Lines, Rk4, Projective)}
MOST_COLOURS = 64  # of springs, each compiled by itself on the path gather; a grid has 12 at most
NO_GRID_NEEDED = tuple(name for name, solver in SOLVERS.items() if not solver.needs_grid)


def path_for(
    kind: type[Solver],
    shape: tuple[int, int],
    asked: str | None = None,
    *,
    sheets: int = 1,
    triangles: bool = False,
    mapped: bool = False,
    colours: int = 0,
) -> str:
    """The layout a solver works on, for a grid of (rows, columns) on the arch that Taichi was started on.

    `triangles`: bodies keep out whole triangles; `mapped`: stiffness differs from spring to spring; `colours`: how many
    the springs have. Raises WrongUse for an unknown layout, on a GPU for one that would run there on a single thread,
    for strips where they cannot serve (several sheets, triangles, mapped stiffness, meshes that are no grid), for a
    thread a particle where it cannot, and for a method that needs a grid.
    """
    if shape == NO_GRID and kind.needs_grid:
        raise WrongUse(f"{kind.name} needs a grid, and a mesh file has no rows: take {', '.join(NO_GRID_NEEDED)}")
    if asked is not None and asked not in kind.paths:
        near = difflib.get_close_matches(asked, kind.paths, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise WrongUse(f"{kind.name} has no path {asked!r}: {', '.join(kind.paths)}{hint}")
    if asked == "lanes" and shape == NO_GRID:
        raise WrongUse("path lanes needs a grid: list and gather can do any mesh")
    if ti.cfg.arch not in (ti.x64, ti.arm64):
        if asked not in (None, "gather"):
            raise WrongUse(f"path {asked} is for --arch cpu; a GPU has the path gather")
        asked = "gather"
    if asked == "gather" and shape == NO_GRID and triangles:
        raise WrongUse("path gather keeps bodies from the triangles of a grid only: list can do any mesh")
    if asked == "gather" and colours > MOST_COLOURS:
        raise WrongUse(
            f"path gather has a launch for each of the {colours} colours of these springs, more than {MOST_COLOURS}: "
            "a point of the mesh has too many edges, which list can do"
        )
    if asked == "lanes" and sheets > 1:
        raise WrongUse("path lanes is for one sheet: list and gather can do several")
    if asked == "lanes" and triangles:
        raise WrongUse("path lanes cannot keep bodies from triangles: list and gather can")
    if asked == "lanes" and mapped:
        raise WrongUse("path lanes has one stiffness along a column: list and gather can do maps.stiffness")
    if sheets > 1 or triangles or mapped:
        return asked or "list"
    # Strips of one column or less are mostly empty: then springs one by one are as fast.
    return asked or next(path for path in kind.paths if path != "lanes" or shape[1] >= LANES)


__all__ = ["SOLVERS", "FrameInput", "Solver", "Stages", "path_for"]
