"""Time and error of a sheet of fabric that swings down from two corners, on grids finer than the scenes' own.

The reference is `spring` with several times the substeps that it needs, in float32; `doubt` is how far it is from one
with half as many, and an error near that is not resolved. It is the program itself, so it tells errors of time steps,
of iterations and of tethers, and none of the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from ..scene.model import Cloth, Fabric, Forces, Scene, Solver, Sphere, Tethers, Wind, keys_of
from ..simulation import Simulation
from ..timing import timed_frame
from .ablate import Floats, apart, horizon, motion

SIDE = 1.45  # [m]
FINER = 4  # times the substeps that `spring` needs
MOST_SUBSTEPS = int(keys_of(Solver)["substeps"].high or 0)
FABRIC = Fabric(warp=2000, weft=2000, shear=1000, bend=20)
DENIM = Fabric(warp=15000, weft=15000, shear=1000, bend=20)


@dataclass(frozen=True)
class SheetCase:
    """A setting on a grid of `cells` × `cells`."""

    name: str
    cells: int
    solver: str
    substeps: int  # 1 for `spring`, which takes what is stable
    frames: int  # at most
    fabric: Fabric = FABRIC
    area_density: float = 0.2  # [kg/m²]
    slack: float | None = None  # of tethers, if there are any
    obstacles: bool = False  # wind, and a ball that the sheet meets as it comes down: compared up to the horizon


CASES = (
    SheetCase("whole fabric 128", 128, "spring", 1, 30, obstacles=True),
    SheetCase("denim 64", 64, "spring", 1, 30, DENIM, 0.4),
    SheetCase("pinned fabric 128", 128, "lines", 10, 30, slack=1.03),
    SheetCase("pinned fabric 256", 256, "lines", 10, 16, slack=1.03),
)


@dataclass(frozen=True)
class SheetError:
    """What a setting costs and how wrong it is."""

    name: str
    method: str  # solver, substeps and iterations as taken
    cells: int
    particles: int
    frames: int  # compared
    median_ms: float  # of a frame
    p95_ms: float
    rms_error: float  # of all particles and frames, as a share of the side
    max_error: float
    doubt: float  # how far the reference is from one with half its substeps, root mean square
    max_strain: float  # after the last frame


def scene_of(case: SheetCase) -> Scene:
    """The sheet, 5° off level, pinned by two corners; undamped."""
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
        spheres=(Sphere(center=(0.0, 1.6, 0.1), radius=0.25, margin=0.02),) if case.obstacles else (),
        tethers=None if case.slack is None else Tethers(slack=case.slack),
    )


def reference(case: SheetCase, scene: Scene) -> tuple[Floats, float]:
    """Positions after each frame that is compared, (frames, N, 3) [m], and `doubt`."""
    plain = replace(scene, solver=replace(scene.solver, name="spring", substeps=1), tethers=None)
    with Simulation(plain) as simulation:
        needed = simulation.substeps
        frames = case.frames
        if case.obstacles:
            frames = horizon(simulation, motion(simulation, frames)[0])
        finest = min(FINER * needed, MOST_SUBSTEPS)
        runs = []
        for substeps in (finest, max(needed, finest // 2)):
            simulation.reset()
            simulation.set("substeps", substeps)
            runs.append(motion(simulation, frames)[0])
        return runs[0], sqrt(float((apart(*runs) ** 2).mean())) / simulation.topology.side


def measure(case: SheetCase) -> SheetError:
    scene = scene_of(case)
    truth, doubt = reference(case, scene)
    with Simulation(scene) as simulation:
        simulation.advance_frame()  # compiles
        simulation.reset()
        ms, places = [], []
        for _ in truth:
            ms.append(timed_frame(simulation))
            places.append(simulation.positions())
        away = np.linalg.norm(np.array(places) - truth, axis=2) / simulation.topology.side
        return SheetError(
            name=case.name,
            method=simulation.method.partition(" · ")[0],
            cells=case.cells,
            particles=simulation.topology.particle_count,
            frames=len(truth),
            median_ms=float(np.median(ms)),
            p95_ms=float(np.percentile(ms, 95)),
            rms_error=float(np.sqrt((away**2).mean())),
            max_error=float(away.max()),
            doubt=doubt,
            max_strain=simulation.measure().max_strain,
        )
