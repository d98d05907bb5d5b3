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


@dataclass(frozen=True)
class Candidates:
    """Measured settings that a scene can have."""

    scene: Scene
    measured: list[MeasuredSetting]
    """As they were measured."""
    rows: list[MeasuredSetting]
    """The same with times and substeps for the scene, fastest first."""
    leaves_out_verlet: bool

    @classmethod
    def of(cls, scene: Scene, only: str | None) -> Candidates:
        """Return the settings of all solvers that support the scene and use its fabric, or of the solver `only`.

        Raises UsageError for a mesh file, and if no solver remains.
        """
        if scene.cloth.file:
            raise UsageError("a target needs a grid: errors and times were not measured for a cloth from a mesh file")
        cells = max(scene.cloth.rows, scene.cloth.columns) - 1
        near = [row for row in settings_near(cells) if only in (None, row.solver)]
        model = scene.fabric.model
        if only and model not in SOLVER_CATALOG[only].models:
            raise UsageError(needs_other_model(only, model))
        near = [row for row in near if model in SOLVER_CATALOG[row.solver].models]
        leaves_out = only is None and scene.solver.name != "verlet" and scene.fabric != Fabric()
        if leaves_out:
            near = [row for row in near if row.solver != "verlet"]
        rows, refusals = [], []
        for row in near:
            try:
                rows.append(estimate_for_scene(row, scene))
            except UsageError as refusal:  # such as that of `lines`, which requires a grid, for several layers
                refusals.append(refusal)
        if not rows:
            raise refusals[0]
        return cls(scene, near, sorted(rows, key=lambda row: row.ms), leaves_out)

    def select(self, chosen: MeasuredSetting, why: str, other: str) -> tuple[Scene, str]:
        """Return the scene with a setting of `rows`, and a line that explains it. `other`: a setting nearby, or ""."""
        same = chosen.solver, chosen.iterations, chosen.error
        its_row = next(row for row in self.measured if (row.solver, row.iterations, row.error) == same)
        where = f"on a swinging curtain of {its_row.cells} cells"
        if its_row.setting != chosen.setting:
            where += f", measured with {its_row.setting}, which its springs need"
        line = (
            f"{chosen.setting}, about {chosen.ms:.2g} ms a frame: {why} ({100 * chosen.error:.2g} % {where}); on this"
            " scene time and error may be larger: contact, wind and other pins are not in them"
        )
        left_out = "; verlet is left out: it does not use [fabric]" if self.leaves_out_verlet else ""
        solver = replace(self.scene.solver, name=chosen.solver, substeps=chosen.substeps, iterations=chosen.iterations)
        return replace(self.scene, solver=solver), line + other + left_out


def settings_for_error(scene: Scene, target: float, only: str | None = None) -> tuple[Scene, str]:
    """Return the scene with the fastest measured setting whose error is at most `target`, and a line that explains it.

    `only`: consider this solver only. Raises UsageError if no setting is accurate enough, and as `Candidates.of`.
    """
    candidates = Candidates.of(scene, only)
    good = [row for row in candidates.rows if row.error <= target]
    if not good:
        best = min(candidates.rows, key=lambda row: row.error)
        reached = f"the best, {best.setting}, has {100 * best.error:.2g} %"
        raise UsageError(f"no measured setting reaches an error of {100 * target:g} %: {reached}")
    faster, other = [row for row in candidates.rows if row.ms < good[0].ms], ""
    if faster:
        best = min(faster, key=lambda row: row.error)
        other = f"; the most accurate faster setting is {best.setting}, with {100 * best.error:.2g} %"
    return candidates.select(good[0], f"the fastest setting whose error is at most {100 * target:g} %", other)


def settings_for_time(scene: Scene, limit_ms: float, only: str | None = None) -> tuple[Scene, str]:
    """Return the scene with the most accurate measured setting that takes at most `limit_ms` a frame [ms], and a line.

    Arguments and errors: of `settings_for_error`.
    """
    candidates = Candidates.of(scene, only)
    good = [row for row in candidates.rows if row.ms <= limit_ms]
    if not good:
        fastest = candidates.rows[0]
        reached = f"the fastest, {fastest.setting}, takes about {fastest.ms:.2g} ms"
        raise UsageError(f"no measured setting takes at most {limit_ms:g} ms a frame: {reached}")
    chosen = min(good, key=lambda row: row.error)
    better, other = [row for row in candidates.rows if row.error < chosen.error], ""
    if better:
        other = f"; the fastest more accurate setting is {better[0].setting}, about {better[0].ms:.2g} ms"
    return candidates.select(chosen, f"the most accurate setting that takes at most {limit_ms:g} ms", other)


def estimate_for_scene(row: MeasuredSetting, scene: Scene) -> MeasuredSetting:
    """Return a measured setting with the substeps that the scene needs, and their frame time (`cost_of`).

    A multiple of the fewest substeps at which an explicit solver is stable remains that multiple. Raises UsageError for
    a solver that does not support the scene.
    """
    solver = replace(scene.solver, name=row.solver, substeps=row.substeps, iterations=row.iterations)
    if row.solver in MIN_STABLE_SUBSTEPS:
        fewest = min(r.substeps for r in measured() if (r.solver, r.cells) == (row.solver, row.cells))
        needed = cost_of(replace(scene, solver=replace(solver, substeps=1))).substeps
        solver = replace(solver, substeps=needed * row.substeps // fewest)
    cost = cost_of(replace(scene, solver=solver))
    return replace(row, substeps=cost.substeps, ms=cost.ms)


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
