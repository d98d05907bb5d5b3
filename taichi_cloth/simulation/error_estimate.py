"""Estimates of the error, the cost and the frame time of a solver setting, without simulating.

Error of motion: measured by `taichi-cloth bench --error` on the swinging curtain. It is the root mean square of all
position errors over the first second of a swing from 45°, as a fraction of the side. Errors of contact and wind are not
included.

Cost: the stored frame times of `bench --error` are those of sheets with structural springs only, in the SIMD layout, on
one thread. The estimate scales them by particles and springs, substeps and iterations. Bending forces are computed once
in a substep, not in every iteration.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import hypot, log, sqrt

from ..geometry import cloth_builder
from ..geometry import stability_bounds as bounds
from ..geometry.topology import Topology
from ..scene.fabric_schema import Fabric
from ..scene.presets import asset_folder
from ..scene.schema import COLLIDERS, FRAME_SECONDS, Scene, Solver
from ..scene.solver_catalog import SOLVER_CATALOG, needs_a_grid, needs_other_model
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
    model = scene.fabric.model
    if only and model not in SOLVER_CATALOG[only].models:
        raise UsageError(needs_other_model(only, model))
    near = [row for row in near if model in SOLVER_CATALOG[row.solver].models]
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
    stiffness = cloth_builder.spring_stiffness(scene, "fabric", topology)
    frequency = bounds.max_frequency(topology, stiffness, topology.membrane)
    coarsest = min(r.substeps for r in measured() if (r.solver, r.cells) == (row.solver, row.cells))
    damping_time = min(scene.fabric.damping_time, bounds.max_damping_time(frequency))
    needed = MIN_STABLE_SUBSTEPS[row.solver](frequency, damping_time, FRAME_SECONDS) * row.substeps // coarsest
    return replace(row, substeps=needed, ms=ms * needed / row.substeps)


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
    if (model := scene.fabric.model) not in info.models:
        raise UsageError(needs_other_model(name, model))
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
    if no_grid or cloth.layers > 1 or cloth_builder.model_of(scene, info.stiffness_section) != "springs":
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
    forces = (stiffness, topology.membrane) if info.is_explicit else (0 * stiffness, None)
    implicit = name == "implicit" or not (info.is_explicit or len(topology.bending_links.ends))
    frequency = 0.0 if implicit else bounds.max_frequency(topology, *forces)
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
