"""Estimates of the error, the cost and the frame time of a solver setting, without simulating.

Error of motion: measured by `taichi-cloth bench --error` on the swinging curtain. It is the root mean square of all
position errors over the first second of a swing from 45°, as a fraction of the side. Errors of contact and wind are not
included.

Artificial stretch of a hanging sheet by iterations that do not converge: in each substep of h seconds every particle
falls by g·h², and red-black Gauss-Seidel iterations over the springs correct that. On a sheet of N rows below its pins,
with springs of stiffness k [N/m] and particles of mass m [kg], an iteration reduces an error by the factor

    ρ = (2w/(2w + α))² = 1/(1 + m/(2kh²))²,    w = 1/m, α = 1/(kh²)

In equilibrium, i iterations leave an excess of κ·(1 − ρ)·ρ^(i−1)/(1 − ρ^i) of the elastic elongation, with κ = kh²/m.
For stiff springs ρ → 1, and it becomes κ/i: an artificial stretch of ½·N²·g·h²/i for any fabric. (In Müller's
position-based dynamics this is the only elongation.) Both formulas are for structural springs; shear springs carry a
third of the load.

`lines` solves A·λ = K·C, A = I + K·J·W·Jᵀ, block by block; an iteration multiplies the error of λ by a matrix M. In
equilibrium (I − Mⁱ)·λ carries the weight, and the springs pull with A·Mⁱ·λ more: beside single pins, where the load
differs from spring to spring. It depends on the cells of the sheet, not on their number.

Cost: the stored frame times of `bench --error` are those of sheets with structural springs only, in the SIMD layout, on
one thread. The estimate scales them by particles and springs, substeps and iterations. Bending forces are computed once
in a substep, not in every iteration.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from math import hypot, log, sqrt

import numpy as np
from numpy.typing import NDArray

from ..geometry import cloth_builder
from ..geometry import stability_bounds as bounds
from ..geometry.topology import Topology
from ..scene.presets import asset_folder
from ..scene.schema import COLLIDERS, FRAME_SECONDS, Cloth, Fabric, Scene, Solver
from ..scene.solver_catalog import SOLVER_CATALOG, needs_a_grid
from ..system.errors import UsageError

# Fewest stable substeps of explicit solvers.
MIN_STABLE_SUBSTEPS = {"explicit": bounds.min_symplectic_substeps, "rk4": bounds.min_rk4_substeps}

# -- error of motion ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class MeasuredSetting:
    """Frame time and error of one setting on one grid."""

    solver: str
    cells: int
    """Cells along a side."""
    substeps: int
    iterations: int
    ms: float
    """Frame time [ms]."""
    error: float
    """Root mean square error of all positions, as a fraction of the side."""

    @property
    def setting(self) -> str:
        """Solver with substeps and iterations, as in `Simulation.method`."""
        return f"{self.solver} {self.substeps}" + ("" if self.solver in MIN_STABLE_SUBSTEPS else f"×{self.iterations}")


@cache
def measured() -> tuple[MeasuredSetting, ...]:
    """Return all measured settings, from the shipped `error.csv`."""
    with (asset_folder() / "error.csv").open(encoding="utf-8", newline="") as file:
        return tuple(
            MeasuredSetting(
                row["solver"],
                int(row["cells"]),
                int(row["substeps"]),
                int(row["iterations"]),
                float(row["median_ms"]),
                float(row["rms_error"]),
            )
            for row in csv.DictReader(file)
        )


def settings_near(cells: float) -> list[MeasuredSetting]:
    """Return the measured settings of the grid closest in size."""
    grid = min({row.cells for row in measured()}, key=lambda n: (abs(log(n / cells)), n))
    return [row for row in measured() if row.cells == grid]


def settings_for_error(scene: Scene, target: float, only: str | None = None) -> tuple[Scene, str]:
    """Return the scene with the fastest measured setting whose error is at most `target`, and a line that explains it.

    `only`: consider this solver only. Raises UsageError if no setting is accurate enough, and for a mesh file.
    """
    if scene.cloth.file:
        raise UsageError("a target error needs a grid: errors were not measured for a cloth from a mesh file")
    cells = max(scene.cloth.rows, scene.cloth.columns) - 1
    near = [row for row in settings_near(cells) if only in (None, row.solver)]
    ignored = only is None and scene.solver.name != "verlet" and scene.fabric != Fabric()
    if ignored:
        near = [row for row in near if row.solver != "verlet"]
    rows = sorted((estimate_for_scene(row, scene) for row in near), key=lambda row: row.ms)
    good = [row for row in rows if row.error <= target]
    if not good:
        best = min(rows, key=lambda row: row.error)
        reached = f"the best, {best.setting}, has {100 * best.error:.2g} %"
        raise UsageError(f"no measured setting reaches an error of {100 * target:g} %: {reached}")
    chosen = good[0]
    same = chosen.solver, chosen.iterations, chosen.error
    measured_as = next(row.setting for row in near if (row.solver, row.iterations, row.error) == same)
    measured_with = "" if measured_as == chosen.setting else f", measured with {measured_as}, which its springs need"
    line = (
        f"{chosen.setting}, about {chosen.ms:.2g} ms a frame: the fastest setting whose error on a swinging curtain of"
        f" {near[0].cells} cells is at most {100 * target:g} % ({100 * chosen.error:.2g} %{measured_with}); on this"
        " scene the error may be larger: contact, wind and other pins are not in it"
    )
    faster = [row for row in rows if row.ms < chosen.ms]
    if faster:
        best_faster = min(faster, key=lambda row: row.error)
        line += f"; the most accurate faster setting is {best_faster.setting}, with {100 * best_faster.error:.2g} %"
    if ignored:
        line += "; verlet is left out: it does not use [fabric]"
    solver = replace(scene.solver, name=chosen.solver, substeps=chosen.substeps, iterations=chosen.iterations)
    return replace(scene, solver=solver), line


def estimate_for_scene(row: MeasuredSetting, scene: Scene) -> MeasuredSetting:
    """Return a measured setting with the frame time for the scene's particles and the substeps its fabric needs."""
    particles = scene.cloth.rows * scene.cloth.columns
    ms = row.ms * particles / (row.cells + 1) ** 2
    if row.solver not in MIN_STABLE_SUBSTEPS:
        return replace(row, ms=ms)
    topology = cloth_builder.build_topology(scene, "fabric")
    frequency = bounds.max_frequency(topology, cloth_builder.spring_stiffness(scene, "fabric", topology))
    coarsest = min(r.substeps for r in measured() if (r.solver, r.cells) == (row.solver, row.cells))
    damping_time = min(scene.fabric.damping_time, bounds.max_damping_time(frequency))
    substeps = MIN_STABLE_SUBSTEPS[row.solver](frequency, damping_time, FRAME_SECONDS) * row.substeps // coarsest
    return replace(row, substeps=substeps, ms=ms * substeps / row.substeps)


# -- cost --------------------------------------------------------------------------------------------------------------

SAMPLE = 256  # [particles] longest side of the sheet whose springs stand for those of a larger one
BY_PARTICLES = ("lines", "implicit")  # solvers of a linear system: more springs hardly slow them down
SERIAL_FACTOR = 2.8  # frame time of the serial over that of the SIMD layout (`bench`: verlet 5×12 on the curtain)


@dataclass(frozen=True)
class Cost:
    """What a scene has, and what a frame of it costs."""

    particles: int
    springs: int
    bending_links: int
    """Of a sheet with more than `SAMPLE`² particles, both are estimated from a part of it."""
    setting: str
    """Solver with the substeps that it takes and its iterations, as in `Simulation.method`."""
    substeps: int
    ms: float
    """Estimated frame time [ms], without optional sections such as wind and colliders."""
    is_measured_size: bool
    """Whether sheets of that size were measured. On larger ones a spring takes longer, by an unknown factor."""

    @property
    def bytes(self) -> int:
        """Estimated peak memory, without that of the program [bytes]."""
        return cloth_builder.BYTES_PER_PARTICLE * self.particles


def cost_of(scene: Scene) -> Cost:
    """Return the cost of a scene, within a second also for the largest sheet.

    Raises UsageError for a scene that `Simulation` refuses: by its solver, its memory or its substeps.
    """
    name, iterations, cloth = scene.solver.name, scene.solver.iterations, scene.cloth
    info, no_grid = SOLVER_CATALOG[name], cloth_builder.reason_not_a_grid(scene)
    if no_grid and info.grid_only:
        raise UsageError(needs_a_grid(name, no_grid))
    if reason := cloth_builder.too_many_particles(scene):
        raise UsageError(reason)
    part = _sample_of(scene)
    topology = cloth_builder.build_topology(part, info.stiffness_section)
    corners = scene if cloth.file else replace(scene, cloth=replace(cloth, rows=2, columns=2))
    needed = _min_substeps(part, topology, cloth_builder.build_particles(corners).extent)
    if reason := bounds.too_many_substeps(name, needed):
        raise UsageError(reason)
    substeps = max(scene.solver.substeps, needed)
    particles = cloth_builder.particle_count(cloth)
    counts = topology.spring_count, len(topology.bending_links.ends)
    springs, links = (round(count * particles / topology.particle_count) for count in counts)
    cells, iterations = max(1, round(sqrt(particles)) - 1), 1 if info.is_explicit else iterations
    row = nearest_setting(cells, name, substeps, iterations)
    work, its_work = particles, (row.cells + 1) ** 2
    if name not in BY_PARTICLES:
        work, its_work = work + springs + links // iterations, its_work + 2 * row.cells * (row.cells + 1)
    ms = row.ms * work / its_work
    setting = f"{name} {substeps}" + ("" if info.is_explicit else f"×{iterations}")
    if no_grid or cloth.layers > 1:
        ms *= SERIAL_FACTOR
    return Cost(particles, springs, links, setting, substeps, ms, cells <= 2 * row.cells)


def _sample_of(scene: Scene) -> Scene:
    """Return a scene with a small part of its sheet, with the same cells and without pins, if the sheet is large."""
    cloth = scene.cloth
    if cloth.file or cloth_builder.particle_count(cloth) <= SAMPLE**2:
        return scene
    rows, columns = min(cloth.rows, SAMPLE), min(cloth.columns, SAMPLE)
    width = cloth.width * (columns - 1) / (cloth.columns - 1)
    height = cloth.height * (rows - 1) / (cloth.rows - 1)
    part = replace(cloth, rows=rows, columns=columns, width=width, height=height, layers=1, pins=())
    return replace(scene, cloth=part, maps=None, attachments=(), regions=())


def _min_substeps(scene: Scene, topology: Topology, extent: float) -> int:
    """Return the fewest substeps of a frame at which the solver is stable (`Simulation.min_stable_substeps`).

    `extent`: of the whole cloth [m].
    """
    name, info = scene.solver.name, SOLVER_CATALOG[scene.solver.name]
    stiffness = cloth_builder.spring_stiffness(scene, info.stiffness_section, topology)
    explicit_forces = stiffness if info.is_explicit else 0 * stiffness
    implicit = name == "implicit" or not (info.is_explicit or len(topology.bending_links.ends))
    frequency = 0.0 if implicit else bounds.max_frequency(topology, explicit_forces)
    found = [getattr(scene, section) for section in COLLIDERS] + [(scene.ground,) if scene.ground else ()]
    colliders = [collider for section in found for collider in section]
    frequency = hypot(frequency, bounds.repulsion_frequency(colliders, scene.cloth.area_density))
    if info.is_explicit:
        damping_time = min(scene.fabric.damping_time, bounds.max_damping_time(frequency))
        return MIN_STABLE_SUBSTEPS[name](frequency, damping_time, FRAME_SECONDS)
    needed = bounds.min_force_substeps(frequency, FRAME_SECONDS)
    return max(needed, bounds.min_line_substeps(topology, extent, FRAME_SECONDS)) if name == "lines" else needed


# -- frame time --------------------------------------------------------------------------------------------------------


def nearest_setting(cells: float, solver: str, substeps: int, iterations: int) -> MeasuredSetting:
    """Return the measured setting of a solver that is nearest in work, with its time in proportion to the work.

    Work is substeps times iterations. The time is that of a swinging sheet on the machine that measured it: only the
    ratio of two such times applies to other scenes and machines.
    """
    work = substeps * iterations
    row = min(
        (row for row in settings_near(cells) if row.solver == solver),
        key=lambda row: (abs(log(row.substeps * row.iterations / work)), abs(log(row.iterations / iterations))),
    )
    return replace(row, ms=row.ms * (work / (row.substeps * row.iterations)))


MIN_GAIN = 0.85  # part of the present frame time below which a solver that is still too slow is worth a change


def faster_solver(cells: float, running: Solver, others: Sequence[Solver], ms: float, limit_ms: float) -> str:
    """Return the most accurate of other solvers that takes at most `limit_ms`, or else the fastest; "" if none helps.

    `cells` along a side. `running`: the present solver and setting, whose frame takes `ms` [ms]. Contact is taken to
    slow all solvers by the same factor.
    """
    present = nearest_setting(cells, running.name, running.substeps, running.iterations)
    rows = [nearest_setting(cells, other.name, other.substeps, other.iterations) for other in others]
    rows = [replace(row, ms=ms * row.ms / present.ms) for row in rows]
    fast = [row for row in rows if row.ms <= limit_ms]
    if fast:
        return min(fast, key=lambda row: row.error).solver
    gains = [row for row in rows if row.ms < MIN_GAIN * ms]
    return min(gains, key=lambda row: row.ms).solver if gains else ""


# -- artificial stretch ------------------------------------------------------------------------------------------------

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


STRETCH_WITH_SHEAR = 2 / 3  # of the stretch remains with shear springs: ⅓·N²·g·h²/i
MAX_SAMPLES = 2048  # particles, and pins, whose distances are compared
MIN_REPORTED_STRETCH = 1e-3  # smallest artificial stretch that is reported, as a fraction of the hanging length
REMEDY = "more iterations or substeps reduce it"
REMEDY_OF_FORCES = f"{REMEDY}, and `implicit` has none of it"
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


def sample_points(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return at most `MAX_SAMPLES` of the points, evenly spaced, including the first and the last."""
    indices = np.linspace(0, len(points) - 1, min(len(points), MAX_SAMPLES)).astype(int)
    sampled: NDArray[np.float64] = points[np.unique(indices)]
    return sampled


def percent(share: float, before: str = "") -> str:
    """Return a share as text, with two digits below 100 %, and without digits where linear theory does not hold."""
    if share >= MAX_REPORTED:
        return f"more than {100 * MAX_REPORTED:.0f} %"
    return f"{before}{100 * share:.0f} %" if share >= 1 else f"{before}{100 * share:.2g} %"


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


def unconverged(scene: Scene, topology: Topology, h: float, iterations: int) -> str:
    """Return a line with the artificial stretch by iterations that do not converge; empty if it is small.

    `h`: length of a substep [s].
    """
    rows, gravity = rows_below(topology), abs(scene.forces.gravity)
    if not rows or not gravity:
        return ""
    factor = STRETCH_WITH_SHEAR if len(topology.family("shear")) else 1.0
    rest = float(np.median(topology.rest[topology.family("structural")]))
    if scene.solver.name == "verlet":
        stretch = factor * artificial_stretch(rows, h, iterations, gravity) / (rows * rest)
        line = f"not converged: about {percent(stretch)} artificial stretch at rest; {REMEDY}"
        return line if stretch >= MIN_REPORTED_STRETCH else ""
    if scene.solver.name == "xpbd":
        mass, constant = float(np.median(topology.mass)), max(scene.fabric.warp, scene.fabric.weft)
        damped = constant * (1 + scene.fabric.damping_time / h)  # to a correction a damper is a stiffer spring
        fraction = factor * unconverged_fraction(damped, mass, h, iterations)
        stretch = fraction * 0.5 * rows * mass * gravity / (constant * rest)  # of the strain of a hanging sheet
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
        line = f"not converged: forces of single pins and grabs are too large, by {percent(excess, 'up to about ')}"
        return f"{line}; {REMEDY_OF_FORCES}" if excess >= MIN_REPORTED_FRACTION else ""
    return ""
