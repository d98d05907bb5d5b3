"""How wrong a setting is before it runs, from what `taichi-cloth bench --error` measured on the swinging curtain.

A share of the side: the root mean square of all places over the first second of a swing through 45°. Contact and wind
have errors of their own that are not in it.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from functools import cache
from math import exp, hypot, log, sqrt

import numpy as np

from ..errors import WrongUse
from ..mesh.frequency import highest_frequency, longest_dashpot, stable_runge_kutta_substeps, stable_substeps
from ..mesh.from_scene import stiffness_of, topology_of
from ..scene.library import asset_folder
from ..scene.model import FRAME_SECONDS, Scene

NEEDED = {"spring": stable_substeps, "rk4": stable_runge_kutta_substeps}  # substeps that are stable

# The law of `verlet` and `xpbd`, within a factor of 1.6 of every measured row it is used for: Euler's steps
# lose LOST·h·√(g/L), however well each is solved, and relaxation leaves ½·N²·g·h²/iterations of stretch.
LOST = 1.05
FINEST = {"verlet": 40, "xpbd": 60}  # substeps from which on float32 rounding is what is left


@dataclass(frozen=True)
class Measured:
    """One setting on one grid."""

    solver: str
    cells: int  # a side
    substeps: int
    iterations: int
    ms: float  # of a frame
    error: float

    @property
    def setting(self) -> str:
        """As `Simulation.method` writes it."""
        return f"{self.solver} {self.substeps}" + ("" if self.solver in NEEDED else f"×{self.iterations}")


@cache
def measured() -> tuple[Measured, ...]:
    """All rows that are shipped."""
    with (asset_folder() / "error.csv").open(encoding="utf-8", newline="") as file:
        return tuple(
            Measured(
                row["solver"],
                int(row["cells"]),
                int(row["substeps"]),
                int(row["iterations"]),
                float(row["median_ms"]),
                float(row["rms_error"]),
            )
            for row in csv.DictReader(file)
        )


def cells_of(scene: Scene) -> int:
    """Cells along the longer side of the grid."""
    return max(scene.cloth.rows, scene.cloth.columns) - 1


def rows_near(cells: int) -> list[Measured]:
    """The rows of the measured grid that is nearest in size."""
    grid = min({row.cells for row in measured()}, key=lambda n: (abs(log(n / cells)), n))
    return [row for row in measured() if row.cells == grid]


def estimate(scene: Scene, solver: str, substeps: int, iterations: int, gravity: float) -> float | None:
    """Error of a setting in a scene: the measured one, or that of the law; None where neither is known.

    `gravity` [m/s²] is that of now.
    """
    if scene.cloth.file:  # only grids were measured
        return None
    cells = cells_of(scene)
    for row in rows_near(cells):
        if row.solver == solver and solver in NEEDED:  # as many as it needs, on any grid
            return row.error
    for row in measured():
        if (row.solver, row.cells, row.substeps, row.iterations) == (solver, cells, substeps, iterations):
            return row.error
    if solver == "lines":
        return between(cells, substeps)
    if substeps > FINEST.get(solver, 0):
        return None
    return law(cells, substeps, iterations, gravity, scene.cloth.height)


def between(cells: int, substeps: int) -> float | None:
    """Error of `lines` from the rows of the nearest grid, whose logarithm is taken as straight from one to the next."""
    rows = [row for row in rows_near(cells) if row.solver == "lines"]
    steps, errors = ([log(getattr(row, name)) for row in rows] for name in ("substeps", "error"))
    if not rows[0].substeps <= substeps <= rows[-1].substeps:
        return None
    return exp(float(np.interp(log(substeps), steps, errors)))


def law(cells: int, substeps: int, iterations: int, gravity: float, height: float) -> float:
    """What Euler's steps and unfinished relaxation cost `verlet` and `xpbd`; [m/s²] and [m]."""
    h = FRAME_SECONDS / substeps
    lost = LOST * h * sqrt(gravity / height)
    return hypot(lost, cells**2 * gravity * h**2 / (2 * iterations * height))


def aim(scene: Scene, target: float, only: str | None = None) -> tuple[Scene, str]:
    """The scene at the fastest measured setting whose error is at most `target`, and a line that says why.

    `only`: with this solver. Raises WrongUse where there is none.
    """
    if scene.cloth.file:
        raise WrongUse("errors were measured on grids only: a cloth from a mesh file has no setting for a target")
    near = [row for row in rows_near(cells_of(scene)) if only in (None, row.solver)]
    rows = sorted((in_scene(row, scene) for row in near), key=lambda row: row.ms)
    good = [row for row in rows if row.error <= target]
    if not good:
        best = min(rows, key=lambda row: row.error)
        raise WrongUse(
            f"an error of {100 * target:g} % was never measured: {best.setting} has {100 * best.error:.2g} %"
        )
    pick = good[0]
    line = (
        f"target {100 * target:g} %: {pick.setting}, {100 * pick.error:.2g} % in about {pick.ms:.2g} ms a frame"
        f" (measured on a swinging curtain of {near[0].cells} cells)"
    )
    missed = [row for row in rows if row.ms < pick.ms]
    if missed:
        nearest = min(missed, key=lambda row: row.error)
        line += f"; of the faster ones {nearest.setting} comes nearest, {100 * nearest.error:.2g} %"
    solver = replace(scene.solver, name=pick.solver, substeps=pick.substeps, iterations=pick.iterations)
    return replace(scene, solver=solver), line


def in_scene(row: Measured, scene: Scene) -> Measured:
    """The row with the time it takes for the scene's particles, and the substeps that its fabric asks for."""
    particles = scene.cloth.rows * scene.cloth.columns
    ms = row.ms * particles / (row.cells + 1) ** 2
    if row.solver not in NEEDED:
        return replace(row, ms=ms)
    topology = topology_of(scene, "fabric")
    frequency = highest_frequency(topology, stiffness_of(scene, "fabric", topology))
    coarsest = min(r.substeps for r in measured() if (r.solver, r.cells) == (row.solver, row.cells))
    damping_time = min(scene.fabric.damping_time, longest_dashpot(frequency))
    substeps = NEEDED[row.solver](frequency, damping_time, FRAME_SECONDS) * row.substeps // coarsest
    return replace(row, substeps=substeps, ms=ms * substeps / row.substeps)
