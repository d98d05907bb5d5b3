"""Frame time and error on a sheet of fabric that swings down from two corners, on finer grids than the scenes have.

The error is the distance from the float64 reference solution (`reference/`) of the same springs. The reference has no
tethers, so the effect of a setting's tethers counts as an error. It is cached on disk: on 256 cells per side it takes
half an hour.

`taichi-cloth bench --goals` prints run time and memory of commands, and these errors. docs/performance.md compares
these figures, those of `bench` and those of `bench --error` with the project's goals.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ...scene.collider_schema import Sphere
from ...scene.fabric_schema import Fabric
from ...scene.schema import Cloth, Forces, Scene, Solver, Tethers, Wind
from ...simulation.simulation import Simulation
from ...system.console import machine, new_file, number, printed_table, wide_console
from ...system.files import cached
from ..reference.solution import Motion, Solution, distances, solve, steps_per_frame
from .bench_report import run_info
from .scene_error import Floats, timed_run
from .subprocess_runner import Startup

SIDE = 1.45  # [m]
FABRIC = Fabric(warp=2000, weft=2000, shear=1000, bend_spring=20)
DENIM = Fabric(warp=15000, weft=15000, shear=1000, bend_spring=20)


@dataclass(frozen=True)
class SheetCase:
    """A setting on a grid of `cells` × `cells`."""

    name: str
    cells: int
    solver: str
    substeps: int
    """Substeps of a frame; 1 for `explicit`, which raises them to what is stable."""
    frames: int
    """Largest number of frames to compare."""
    fabric: Fabric = FABRIC
    area_density: float = 0.2  # [kg/m²]
    slack: float | None = None
    """Slack of the tethers; without tethers if None."""
    obstacles: bool = False
    """With wind, and a sphere that the falling sheet hits. Frames are then compared up to the horizon."""


CASES = (
    SheetCase("whole fabric 128", 128, "explicit", 1, 30, obstacles=True),
    SheetCase("denim 64", 64, "explicit", 1, 30, DENIM, 0.4),
    SheetCase("pinned fabric 128", 128, "lines", 10, 30, slack=1.03),
    SheetCase("pinned fabric 256", 256, "lines", 10, 16, slack=1.03),
)


@dataclass(frozen=True)
class SheetError:
    """Frame time and error of a setting."""

    name: str
    method: str
    """Solver, with the substeps and iterations in use."""
    cells: int
    """Cells along a side."""
    particles: int
    frames: int
    """Number of frames compared."""
    median_ms: float
    """Median frame time [ms]."""
    p95_ms: float
    """95th percentile of the frame time [ms]."""
    rms_error: float
    """Root mean square over all particles and frames, as a share of the side."""
    max_error: float
    """Largest error of a particle in a frame, as a share of the side."""
    uncertainty: float
    """Root mean square distance of the reference from one with twice its time step, as a share of the side."""
    max_strain: float
    """Largest strain after the last frame."""


def scene_of(case: SheetCase) -> Scene:
    """Return the scene of a case: an undamped sheet, 5° from horizontal, pinned at two corners."""
    count = case.cells + 1
    return Scene(
        name=case.name,
        cloth=Cloth(
            rows=count,
            columns=count,
            width=SIDE,
            height=SIDE,
            rotation=(-85.0, 0.0, 0.0),
            area_density=case.area_density,
            pins=("top-left", "top-right"),
        ),
        fabric=case.fabric,
        solver=Solver(case.solver, case.substeps, 1, damping=0.0),
        forces=Forces(gravity=9.81),
        wind=Wind(x=0.4, z=0.9, turbulence=0.0) if case.obstacles else None,
        spheres=(Sphere(center=(0.0, 1.6, 0.1), radius=0.25, margin=0.02, friction=0.0),) if case.obstacles else (),
        tethers=None if case.slack is None else Tethers(slack=case.slack),
    )


def solution(case: SheetCase, scene: Scene) -> Solution:
    """Return the reference solution for the frames that are compared. It is cached on disk."""
    untethered = replace(scene, tethers=None)
    run = solve if case.obstacles else solve_all_frames
    positions, coarser = cached(f"{run.__name__} {untethered} {case.frames}", lambda: run(untethered, case.frames))
    return Solution(positions, coarser, SIDE)


def solve_all_frames(scene: Scene, frames: int) -> Floats:
    """Return `Solution.positions` and `Solution.coarse_positions`, (2, frames, N, 3), without looking for a horizon."""
    steps = steps_per_frame(scene)
    runs = Motion(scene, 2 * steps), Motion(scene, steps)
    return np.stack([[run.step_frame() for _ in range(frames)] for run in runs])


def measure(case: SheetCase) -> SheetError:
    """Measure one case."""
    scene = scene_of(case)
    truth = solution(case, scene)
    with Simulation(scene) as simulation:
        ms, positions, _ = timed_run(simulation, len(truth.positions))
        error = distances(positions, truth.positions) / truth.side
        return SheetError(
            name=case.name,
            method=simulation.method.partition(" · ")[0],
            cells=case.cells,
            particles=simulation.topology.particle_count,
            frames=truth.horizon,
            median_ms=float(np.median(ms)),
            p95_ms=float(np.percentile(ms, 95)),
            rms_error=float(np.sqrt((error**2).mean())),
            max_error=float(error.max()),
            uncertainty=truth.uncertainty[0],
            max_strain=simulation.metrics().max_strain,
        )


def print_report(commands: Sequence[Startup], sheets: Sequence[SheetError]) -> None:
    """Print both tables, and the machine in the last line."""
    console = wide_console()
    lines = [["process", "seconds", "peak MB"]]
    lines += [[one.what, f"{one.seconds:.2f}", number(one.peak_mb, ".0f")] for one in commands]
    console.print(printed_table(lines))
    lines = [["sheet", "setting", "frames", "ms", "p95", "RMS error", "max error", "uncertainty", "strain"]]
    for one in sheets:
        errors = (f"{one.rms_error:.3%}", f"{one.max_error:.2%}", f"{one.uncertainty:.3%}", f"{one.max_strain:.1%}")
        lines.append([one.name, one.method, str(one.frames), f"{one.median_ms:.2f}", f"{one.p95_ms:.2f}", *errors])
    console.print(printed_table(lines))
    console.print(" · ".join(machine().values()), soft_wrap=True)


def write_json(path: Path, commands: Sequence[Startup], sheets: Sequence[SheetError]) -> None:
    """Write all results as JSON. Raises OSError."""
    results = {
        **run_info(),
        "commands": [asdict(one) for one in commands],
        "sheets": [asdict(one) for one in sheets],
    }
    with new_file(path) as file:
        file.write(json.dumps(results, indent=1).encode())
