"""Which solvers and layouts a cloth can be simulated with, and the layout that is chosen."""

from typing import NamedTuple

from ..geometry.simd_layout import LANES
from ..kernels.tensor_fields import simd_available
from ..scene.solver_catalog import SOLVER_CATALOG, needs_a_grid, needs_other_model
from ..system.errors import RENAMED_LAYOUTS, UsageError, choose_from
from ..system.taichi_runtime import on_cpu
from .base import Solver

LAYOUTS = ("simd", "serial", "parallel")  # the first that suits a cloth is used


class Unsupported(NamedTuple):
    """Reasons why a cloth cannot be simulated by some solvers or in some layouts, for messages; empty if it can be."""

    model: str = "springs"
    """Value of `fabric.model`, against solvers without it (`SolverInfo.models`)."""
    grid_only: str = ""
    """Reason against solvers that need a grid with complete rows (`SolverInfo.grid_only`)."""
    simd: str = ""
    """Reason against the SIMD layout."""
    parallel: str = ""
    """Reason against the parallel layout."""


SUPPORTED = Unsupported()


def choose_layout(
    solver: type[Solver], shape: tuple[int, int], wanted: str | None = None, unsupported: Unsupported = SUPPORTED
) -> str:
    """Return the layout for a grid of (rows, columns), on the arch that Taichi runs on.

    Raises UsageError for a layout that does not exist, that the cloth does not support, or that a GPU would run on one
    thread; and where the solver does not support the cloth.
    """
    if unsupported.grid_only and solver.info.grid_only:
        raise UsageError(needs_a_grid(solver.name, unsupported.grid_only))
    if unsupported.model not in solver.info.models:
        raise UsageError(needs_other_model(solver.name, unsupported.model))
    if wanted is not None and wanted not in LAYOUTS:
        is_solver = wanted in SOLVER_CATALOG
        hint = f"; load_scene(scene, solver={wanted!r}) chooses a solver" if is_solver else ""
        raise UsageError(f"unknown layout {wanted!r}{choose_from(wanted, LAYOUTS, RENAMED_LAYOUTS)}{hint}")
    if not on_cpu():
        if wanted not in (None, "parallel"):
            raise UsageError(f"layout {wanted} is for --arch cpu; a GPU uses parallel")
        wanted = "parallel"
    if unsupported.parallel and wanted == "parallel":
        instead = "serial" if on_cpu() else "--arch cpu"
        raise UsageError(f"layout parallel is not supported: {unsupported.parallel}; use {instead}")
    if unsupported.simd and wanted == "simd":
        raise UsageError(f"layout simd is not supported: {unsupported.simd}; use serial or parallel")
    if wanted == "simd" and not simd_available():
        raise UsageError("layout simd does not work with this release of Taichi; use serial or parallel")
    if wanted or unsupported.simd:
        return wanted or "serial"
    # Grids narrower than a packet would leave most lanes empty.
    return "simd" if shape[1] >= LANES and simd_available() else "serial"
