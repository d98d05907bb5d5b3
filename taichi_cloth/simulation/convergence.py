"""Estimates of what iterations that do not converge leave, without simulating: stretch, and too large forces.

In each substep of h seconds every particle falls by g·h², and red-black Gauss-Seidel iterations over the springs
correct that. On a sheet of N rows below its pins, with springs of stiffness k [N/m] and particles of mass m [kg], an
iteration reduces an error by the factor

    ρ = (2w/(2w + α))² = 1/(1 + m/(2kh²))²,    w = 1/m, α = 1/(kh²)

In equilibrium, i iterations leave an excess of κ·(1 − ρ)·ρ^(i−1)/(1 − ρ^i) of the elastic elongation, with κ = kh²/m.
For stiff springs ρ → 1, and it becomes κ/i: an artificial stretch of ½·N²·g·h²/i for any fabric. (In Müller's
position-based dynamics this is the only elongation.) Both formulas are for structural springs; shear springs carry a
third of the load.

`lines` solves A·λ = K·C, A = I + K·J·W·Jᵀ, block by block; an iteration multiplies the error of λ by a matrix M. In
equilibrium (I − Mⁱ)·λ carries the weight, and the springs pull with A·Mⁱ·λ more: beside single pins, where the load
differs from spring to spring. It depends on the cells of the sheet, not on their number.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from ..geometry import cloth_builder
from ..geometry.membrane_model import Membrane
from ..geometry.topology import Topology, spring_strains
from ..scene.fabric_schema import Fabric
from ..scene.schema import Cloth, Scene

GRAVITY = 9.81  # [m/s²] the default of a scene


def unconverged_fraction(constant: float, mass: float, h: float, iterations: int) -> float:
    """Return the excess elongation of a hanging sheet as a fraction of its elastic elongation.

    `constant`: stiffness of a spring [N/m]; `mass` of a particle [kg]; `h`: length of a substep [s].
    """
    kappa = constant * h * h / mass
    rho = 1 / (1 + 1 / (2 * kappa)) ** 2
    if rho > 1 - 1e-9:
        return kappa / iterations
    return float(kappa * (1 - rho) * rho ** (iterations - 1) / (1 - rho**iterations))


def artificial_stretch(rows: int, h: float, iterations: int, gravity: float = GRAVITY) -> float:
    """Return the artificial stretch of a hanging sheet with inextensible springs [m]: ½·N²·g·h²/i."""
    return 0.5 * rows**2 * gravity * h * h / iterations


def overstretched(topology: Topology, positions: NDArray[np.float64]) -> str:
    """Return a warning if a spring is stretched as no cloth survives; otherwise an empty text. `positions`: (N, 3)."""
    strain = float(spring_strains(topology, positions).max(initial=0.0))
    if strain <= TORN_APART:
        return ""
    return f"a spring is {1 + strain:.3g} times as long as at rest: the cloth may have blown up; try more substeps"


WIDE_CELL = 0.5  # of the bending length: a loop is then as wide as a few cells


def coarse_for_folds(scene: Scene, topology: Topology) -> str:
    """Return a line if cells are wide beside the bending length of the fabric, otherwise an empty text.

    That length, (B/(σ·g))^(1/3) with bending stiffness B and area density σ, is the scale of the folds that a fabric
    makes under its own weight. Cells must be narrower for such folds to be those of the fabric.
    """
    bending, gravity = max(cloth_builder.bending_of(scene.fabric)), scene.forces.gravity
    if not bending or gravity <= 0 or not len(topology.edges):
        return ""
    length = (bending / (scene.cloth.area_density * gravity)) ** (1 / 3)
    cell = cell_size(topology)
    if cell <= WIDE_CELL * length:
        return ""
    return f"folds depend on the grid: cells of {1e3 * cell:.2g} mm, bending length {1e3 * length:.2g} mm"


def cell_size(topology: Topology) -> float:
    """Return the side of a cell [m]: the median length of the edges at rest."""
    return float(np.median(np.linalg.norm(np.diff(topology.flat[topology.edges], axis=1), axis=2)))


STRETCH_WITH_SHEAR = 2 / 3  # of the stretch remains with shear springs: ⅓·N²·g·h²/i
MAX_SAMPLES = 2048  # particles, and pins, whose distances are compared
MIN_REPORTED_STRETCH = 1e-3  # smallest artificial stretch that is reported, as a fraction of the hanging length
REMEDY = "more iterations or substeps reduce it"
REMEDY_OF_FORCES = f"{REMEDY}, and `implicit` has none of it"
FORCES_OF_GRABS = "not converged: forces of grabs may be many times too large; measure them with `implicit`"
TORN_APART = 1.0  # strain of a spring that no cloth survives
VERLET_MODEL = "verlet has no stiffness in N/m: with finer settings only the other solvers converge to the fabric"
MAX_REPORTED = 10.0  # largest share that is reported as a number
MIN_REPORTED_FRACTION = 1e-2  # smallest excess that is reported, as a fraction of the elastic elongation


@lru_cache(maxsize=2)  # of the two sides of a comparison
def rows_below(topology: Topology) -> int:
    """Return the distance from the pins to the farthest particle, in springs; 0 without pins."""
    rest = topology.rest[topology.family("structural")]
    if not topology.pinned.any() or not len(rest):
        return 0
    pins, others = (sample_points(topology.flat[which]) for which in (topology.pinned, ~topology.pinned))
    if not len(others):
        return 0
    squared = np.full(len(others), np.inf)
    for pin in pins:
        squared = np.minimum(squared, ((others - pin) ** 2).sum(axis=1))
    return round(float(np.sqrt(squared.max()) / np.median(rest)))


def load_factor(cloth: Cloth, topology: Topology) -> float:
    """Return by how much weights at corners raise the mean tension of a hanging sheet: a weight acts on all of it."""
    free = topology.mass[~topology.pinned]
    weights = cloth.corner_mass * int((free > cloth.corner_mass).sum()) if cloth.corner_mass else 0.0
    return 1 + 2 * weights / (float(free.sum()) - weights)


def sample_points(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return at most `MAX_SAMPLES` of the points, evenly spaced, including the first and the last."""
    indices = np.linspace(0, len(points) - 1, min(len(points), MAX_SAMPLES)).astype(int)
    sampled: NDArray[np.float64] = points[np.unique(indices)]
    return sampled


def percent(share: float, before: str = "") -> str:
    """Return a share as text, with two digits below 100 %, and without digits where linear theory does not hold."""
    if share >= MAX_REPORTED:
        return f"more than {100 * MAX_REPORTED:.0f} %"
    return f"{before}{100 * share:.0f} %" if share >= 0.995 else f"{before}{100 * share:.2g} %"


STAGE = 1 - sqrt(0.5)  # of a substep of `lines`: γ of `solvers/two_stage.py`, which needs Taichi
MODEL_CELLS = 6  # along the sides of the sheet that stands for all; more change the result by a few hundredths of it


@lru_cache(maxsize=16)
def lines_excess(cloth: Cloth, fabric: Fabric, h: float, iterations: int) -> float:
    """Return how much too large the forces of single pins are with `lines`, as a fraction. `h`: of a substep [s].

    By linear theory, for a flat sheet of a few such cells that hangs by two corners.
    """
    n, cell = MODEL_CELLS + 1, (cloth.width / (cloth.columns - 1), cloth.height / (cloth.rows - 1))
    same = {name: getattr(cloth, name) for name in ("area_density", "diagonals", "mass_lumping")}
    sheet = Cloth(n, n, MODEL_CELLS * cell[0], MODEL_CELLS * cell[1], pins=("top-left", "top-right"), **same)
    topology = cloth_builder.build_topology(scene := Scene(cloth=sheet, fabric=fabric), "fabric")
    incidence, bend = np.eye(n * n)[topology.ends[:, 1]] - np.eye(n * n)[topology.ends[:, 0]], topology.family("bend")
    steps, free = incidence @ topology.flat[:, :2], ~np.repeat(topology.pinned, 2)
    j = (incidence[:, :, None] * (steps / topology.rest[:, None])[:, None]).reshape(len(steps), -1)
    mass, stage = np.repeat(topology.mass, 2), STAGE * h
    k = stage * (stage + fabric.damping_time) * cloth_builder.spring_stiffness(scene, "fabric", topology)[:, None]
    a = np.eye(len(j)) + k * (j * np.where(free, 1 / mass, 0.0)) @ j.T
    right, down = np.rint(steps / cell).T
    block = np.select([down == 0, right == 0, right * down > 0], [0, 1, 2], 3)
    block[bend] = 4 + np.arange(len(bend))  # one by one
    matrix = np.eye(len(j)) - np.linalg.solve(np.where(block[:, None] >= block, a, 0.0), a)
    exact = np.linalg.solve(a, k * j[:, free])
    remaining = np.linalg.matrix_power(matrix, iterations) @ exact
    weight = np.where(np.arange(len(mass)) % 2, mass, 0.0)[free]  # of each particle: along x, and along y
    excess = j.T @ a @ remaining @ np.linalg.solve(j[:, free].T @ (exact - remaining), weight)
    return float(abs(excess[~free][1::2].sum() / weight.sum()))


def unconverged(
    scene: Scene, topology: Topology, h: float, iterations: int, grabbed: NDArray[np.int64] | None = None
) -> str:
    """Return a line with the artificial stretch by iterations that do not converge; empty if it is small.

    `h`: length of a substep [s]. `grabbed`: indices of particles that hold a cloth without pins.
    """
    if grabbed is not None and len(grabbed) and not topology.pinned.any():
        if scene.solver.name == "lines":  # the cloth hangs in folds, for which linear theory gives far too little
            return FORCES_OF_GRABS if scene.tethers is None else ""
        held = np.zeros_like(topology.pinned)
        held[grabbed] = True
        topology = replace(topology, pinned=held)
    rows, gravity = rows_below(topology), abs(scene.forces.gravity)
    if not rows or not gravity:
        return ""
    factor = STRETCH_WITH_SHEAR if len(topology.family("shear")) else 1.0
    rest, load = float(np.median(topology.rest[topology.family("structural")])), load_factor(scene.cloth, topology)
    if scene.solver.name == "verlet":
        stretch = factor * load * artificial_stretch(rows, h, iterations, gravity) / (rows * rest)
        line = f"not converged: about {percent(stretch)} artificial stretch at rest; {REMEDY}"
        return line if stretch >= MIN_REPORTED_STRETCH else ""
    if scene.solver.name == "xpbd":
        mass, fabric, membrane = float(np.median(topology.mass)), scene.fabric, topology.membrane
        constant = max(fabric.warp, fabric.weft) if not isinstance(membrane, Membrane) else float(membrane.tensor.max())
        damped = constant * (1 + scene.fabric.damping_time / h)  # to a correction a damper is a stiffer spring
        fraction = factor * unconverged_fraction(damped, mass, h, iterations)
        stretch = load * fraction * 0.5 * rows * mass * gravity / (constant * rest)  # of the strain of a hanging sheet
        line = f"not converged: forces of pins and grabs are too large, by {percent(fraction, 'up to about ')}"
        return (
            f"{line}, and {percent(stretch)} artificial stretch at rest; {REMEDY_OF_FORCES}"
            if fraction >= MIN_REPORTED_FRACTION
            else ""
        )
    neighbors = topology.ends[np.concatenate([topology.family("structural"), topology.family("shear")])]
    edges = neighbors[topology.pinned[neighbors].all(axis=1)]  # an edge that is pinned as a whole has no excess
    stable = min(scene.fabric.warp, scene.fabric.weft, scene.fabric.shear) > 0  # else the model is a mechanism
    loaded = len(np.unique(edges)) < topology.pinned.sum() and scene.tethers is None  # tethers carry most of the load
    if scene.solver.name == "lines" and stable and loaded:
        excess = lines_excess(scene.cloth, scene.fabric, h, iterations)
        line = f"not converged: forces of single pins are too large, by {percent(excess, 'up to about ')}"
        return f"{line}; {REMEDY_OF_FORCES}" if excess >= MIN_REPORTED_FRACTION else ""
    return ""
