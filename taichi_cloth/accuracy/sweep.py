"""Every solver at many settings on the swinging curtain: how long a frame takes, and how wrong it is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

from ..scene.model import FRAME_SECONDS, Cloth, Fabric, Forces, Scene, Solver, Springs
from ..simulation import Simulation
from ..solvers import SOLVERS
from ..timing import timed_frame
from .truth import Curtain, truth

FRAMES = 60
GRIDS = (32, 64)  # cells a side
ALL_GRIDS = (16, 32, 64, 128, 256)
LARGEST_FOR = {"projective": 128}  # on finer ones a frame takes seconds: only the first setting
SLOW = 5.0  # [Hz] of the vibration whose numerical damping is measured
# (substeps, iterations) from cheap to good; (1, 1) and (2, 1) of the explicit methods: as many as they need, and twice.
RELAXED = ((5, 4), (5, 12), (5, 40), (10, 12), (20, 1), (20, 12), (30, 1), (60, 1), (60, 4), (120, 1))
SETTINGS = {
    "verlet": RELAXED,
    "xpbd": RELAXED,
    "lines": ((5, 1), (10, 1), (20, 1), (40, 1), (80, 1)),
    "spring": ((1, 1), (2, 1)),
    "rk4": ((1, 1), (2, 1)),
    "projective": ((5, 1), (5, 10), (20, 10)),
}


@dataclass(frozen=True)
class Point:
    """One setting on one grid."""

    solver: str
    cells: int  # a side
    substeps: int
    iterations: int
    median_ms: float  # of a frame
    p95_ms: float
    rms_error: float  # of all particles and frames, as a share of the side
    max_error: float
    stretch: float  # how much longer a column is at the end than it should be, as a share of the side
    max_strain: float
    kept: float | None  # of the amplitude of a spring at 5 Hz after a second; None where it has no constant

    @property
    def setting(self) -> str:
        iterations = f"×{self.iterations}" if SOLVERS[self.solver].iterates else ""
        return f"{self.solver} {self.substeps}{iterations}"


def scene_of(curtain: Curtain, solver: str, substeps: int, iterations: int) -> Scene:
    """The curtain as a scene; its top edge lies along the x axis."""
    x, y = curtain.start[-1] / 2
    return Scene(
        name="curtain",
        cloth=Cloth(
            rows=curtain.cells + 1,
            columns=curtain.cells + 1,
            width=1.0,
            height=1.0,
            center=(0.0, float(y), float(x)),
            rotation=(-curtain.degrees, 0.0, 0.0),
            pins=("top",),
            area_density=curtain.area_density,
            lumping="equal",
        ),
        springs=Springs(shear=0.0, bend=0.0),
        fabric=Fabric(warp=curtain.constant, weft=curtain.constant, shear=0.0, bend=0.0),
        solver=Solver(solver, substeps, iterations, damping=0.0),
    )


def measure(curtain: Curtain, solver: str, substeps: int, iterations: int) -> Point:
    """One setting, for a second of the swing."""
    exact = truth(curtain, FRAMES)
    scene = scene_of(curtain, solver, substeps, iterations)
    if not SOLVERS[solver].iterates:
        with Simulation(scene) as simulation:
            substeps *= simulation.substeps
        scene = scene_of(curtain, solver, substeps, 1)
    with Simulation(scene) as simulation:
        simulation.advance_frame()  # compiles
        simulation.reset()
        ms, squares, largest = [], [], 0.0
        for frame in range(FRAMES):
            ms.append(timed_frame(simulation))
            x = simulation.positions()
            away = x.reshape(curtain.cells + 1, -1, 3)[:, :, [2, 1]] - exact[frame][:, None]
            distance = np.hypot(away[..., 0], away[..., 1])
            squares.append(float((distance**2).mean()))
            largest = max(largest, float(distance.max()))
        column = x.reshape(curtain.cells + 1, -1, 3)[:, curtain.cells // 2]
        length, right = (float(np.linalg.norm(np.diff(c, axis=0), axis=1).sum()) for c in (column, exact[-1]))
        return Point(
            solver=solver,
            cells=curtain.cells,
            substeps=simulation.substeps,
            iterations=iterations,
            median_ms=float(np.median(ms)),
            p95_ms=float(np.percentile(ms, 95)),
            rms_error=sqrt(float(np.mean(squares))),
            max_error=largest,
            stretch=length - right,
            max_strain=simulation.measure().max_strain,
            kept=kept(solver, simulation.substeps, iterations),
        )


def kept(solver: str, substeps: int, iterations: int) -> float | None:
    """Share of its amplitude that a spring of 5 Hz has after a second."""
    if SOLVERS[solver].springs == "springs":
        return None
    omega = 2 * pi * SLOW
    scene = Scene(
        cloth=Cloth(rows=2, columns=2, width=1.0, height=1.0, area_density=1.0, lumping="equal"),  # 1 kg a particle
        fabric=Fabric(warp=omega**2, weft=0.0, shear=0.0, bend=0.0),
        solver=Solver(solver, substeps, iterations, damping=0.0),
        forces=Forces(gravity=0.0),
    )
    with Simulation(scene) as simulation:
        topology = simulation.topology
        start = topology.start.copy()
        start[2:, 1] -= 0.1
        simulation.place(start)
        for _ in range(round(1 / FRAME_SECONDS)):
            simulation.advance_frame()
        out = float(topology.start[2, 1] - simulation.positions()[2, 1])
        return float(np.hypot(out, simulation.velocities()[2, 1] / omega) / 0.1)


def points(curtains: list[Curtain], only: str | None) -> Iterator[tuple[Curtain, str, int, int]]:
    """All that is to be measured."""
    for curtain in curtains:
        for solver, settings in SETTINGS.items():
            if only in (None, solver):
                long = curtain.cells > LARGEST_FOR.get(solver, curtain.cells)
                for substeps, iterations in settings[:1] if long else settings:
                    yield curtain, solver, substeps, iterations


def once(found: list[Point]) -> list[Point]:
    """Without those that another setting came to as well: some methods take more substeps than they are asked for."""
    return list({(point.cells, point.setting): point for point in found}.values())


def pareto(found: list[Point]) -> list[Point]:
    """Those that nothing is both faster and more accurate than, from fast to accurate."""
    front: list[Point] = []
    for point in sorted(found, key=lambda p: (p.median_ms, p.max_error)):
        if np.isfinite(point.max_error) and (not front or point.max_error < front[-1].max_error):
            front.append(point)
    return front


def knee(front: list[Point]) -> Point:
    """Where the front bends most: farthest below the line between its ends, both axes by their logarithm."""
    t, e = (np.log([getattr(p, name) for p in front]) for name in ("median_ms", "max_error"))
    if len(front) < 3:
        return front[-1]
    below = (t - t[0]) / (t[-1] - t[0]) + (e - e[-1]) / (e[0] - e[-1])
    return front[int(below.argmin())]
