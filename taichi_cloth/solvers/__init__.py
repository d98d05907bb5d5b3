"""The methods, by the name a scene gives."""

import difflib
from typing import NamedTuple

import taichi as ti

from ..errors import WrongUse
from ..kernels.places import LANES
from ..kernels.probe_simd import simd_works
from .base import FrameInput, Solver, Stages
from .lines import Lines
from .projective import Projective
from .rk4 import Rk4
from .spring import Spring
from .verlet import Verlet
from .xpbd import Xpbd

SOLVERS: dict[str, type[Solver]] = {solver.name: solver for solver in (Verlet, Xpbd, Spring, Lines, Rk4, Projective)}


class Unfit(NamedTuple):
    """Why a cloth is not fit for something, in words; nothing where it is."""

    rows: str = ""  # for methods that solve whole rows
    strips: str = ""  # for eight particles at a time
    threads: str = ""  # for a thread each


FIT = Unfit()


def path_for(kind: type[Solver], shape: tuple[int, int], asked: str | None = None, unfit: Unfit = FIT) -> str:
    """The layout a solver works on, for a grid of (rows, columns) on the arch that Taichi was started on.

    Raises WrongUse for an unknown one, on a GPU for one that would run there on a single thread, and where the method
    or the path is what the cloth is `unfit` for.
    """
    if unfit.rows and kind.needs_rows:
        others = ", ".join(name for name, other in SOLVERS.items() if not other.needs_rows)
        raise WrongUse(f"{kind.name} needs a grid of whole rows, and {unfit.rows}: take {others}")
    if asked is not None and asked not in kind.paths:
        near = difflib.get_close_matches(asked, kind.paths, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise WrongUse(f"{kind.name} has no path {asked!r}: {', '.join(kind.paths)}{hint}")
    if ti.cfg.arch not in (ti.x64, ti.arm64):
        if asked not in (None, "gather"):
            raise WrongUse(f"path {asked} is for --arch cpu; a GPU has the path gather")
        asked = "gather"
    if unfit.threads and asked == "gather":
        raise WrongUse(f"path gather cannot do it, since {unfit.threads}: list can")
    if unfit.strips and asked == "lanes":
        raise WrongUse(f"path lanes is for one even grid, and {unfit.strips}: list and gather can do that")
    if asked == "lanes" and not simd_works():
        raise WrongUse("path lanes does not work with this release of Taichi: take list or gather")
    if asked or unfit.strips:
        return asked or "list"
    # Strips of one column or less are mostly empty: springs one by one are as fast.
    return next(path for path in kind.paths if path != "lanes" or (shape[1] >= LANES and simd_works()))


__all__ = ["SOLVERS", "FrameInput", "Solver", "Stages", "Unfit", "path_for"]
