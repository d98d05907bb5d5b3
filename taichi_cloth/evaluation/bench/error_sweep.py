"""Frame time and error of every solver at many settings on the swinging curtain (`bench --error`).

The curtain is flat at the start, pinned along its top edge, and has structural springs only. Every column then moves as
the same plane chain of equal masses, so that one chain is the solution for any number of rows, angle and stiffness.
The report has a table, JSON and plots, and names the settings on the Pareto front.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from math import ceil, cos, pi, radians, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scene.fabric_schema import Fabric, VerletSprings
from ...scene.schema import FRAME_SECONDS, Cloth, Forces, Scene, Solver
from ...simulation.copies import timed_frame
from ...simulation.simulation import Simulation
from ...solvers import SOLVERS
from ...system.console import machine, new_file, printed_table, wide_console
from ...system.errors import UsageError, install_command
from ...system.files import cached
from .bench_report import finite, run_info
from .cases import FRAME_RATES

Floats = NDArray[np.float64]
GRAVITY = 9.81  # [m/s²]
STEPS_PER_INVERSE_FREQUENCY = 8  # time steps in 1/ω of the highest frequency, which is half the longest stable step


@dataclass(frozen=True)
class Curtain:
    """A square of 1 m × 1 m that swings about its top edge."""

    cells: int = 64
    """Cells along a side."""
    stiffness: float = 1000.0
    """Stiffness of every spring [N/m]."""
    area_density: float = 0.2  # [kg/m²]
    degrees: float = 45.0
    """Initial angle from the vertical, forward."""

    @property
    def mass(self) -> float:
        """Mass of a particle [kg]."""
        return self.area_density / self.cells**2

    @property
    def rest(self) -> float:
        """Rest length of a spring [m]."""
        return 1.0 / self.cells

    @property
    def start(self) -> Floats:
        """Initial position of every row, forward and up from the top edge [m], (cells + 1, 2)."""
        along = np.arange(self.cells + 1)[:, None] * self.rest
        angle = radians(self.degrees)
        positions: Floats = along * np.array([sin(angle), -cos(angle)])
        return positions

    @property
    def max_frequency(self) -> float:
        """Upper bound of the chain's angular frequencies [rad/s]."""
        return 2 * sqrt(self.stiffness / self.mass)

    def acceleration(self, x: Floats) -> Floats:
        """Return the acceleration of every particle [m/s²], (cells + 1, 2); 0 for the pinned one."""
        gap = np.diff(x, axis=0)
        length = np.sqrt((gap * gap).sum(axis=1, keepdims=True))
        pull = gap * (self.stiffness / self.mass * (1 - self.rest / length))
        a = np.zeros_like(x)
        a[1:] = -pull
        a[1:-1] += pull[1:]
        a[1:, 1] -= GRAVITY
        return a


def verlet(curtain: Curtain, frames: int, steps: int) -> Floats:
    """Return the positions after each frame by velocity Verlet, (frames, cells + 1, 2) [m]. `steps`: in a frame."""
    h = FRAME_SECONDS / steps
    x, v, a = curtain.start, np.zeros((curtain.cells + 1, 2)), curtain.acceleration(curtain.start)
    positions = []
    for _ in range(frames):
        for _ in range(steps):
            v += h / 2 * a
            x = x + h * v
            a = curtain.acceleration(x)
            v += h / 2 * a
        positions.append(x)
    return np.array(positions)


def richardson_verlet(curtain: Curtain, frames: int) -> Floats:
    """Return the positions after each frame by Richardson extrapolation of velocity Verlet, (frames, cells + 1, 2) [m].

    (4·fine − coarse)/3 of two step lengths has no error of second order. This checks `curtain_solution`.
    """
    steps = STEPS_PER_INVERSE_FREQUENCY * ceil(curtain.max_frequency * FRAME_SECONDS)
    return (4 * verlet(curtain, frames, 2 * steps) - verlet(curtain, frames, steps)) / 3


@cache
def curtain_solution(curtain: Curtain, frames: int = 60) -> Floats:
    """Return the position of every row after each frame, (frames, cells + 1, 2) [m], to 1e-9. It is cached on disk."""
    return cached(f"Runge-Kutta {curtain} {frames}", lambda: runge_kutta(curtain, frames))


def runge_kutta(curtain: Curtain, frames: int) -> Floats:
    """Return the positions after each frame by the classical Runge–Kutta method, (frames, cells + 1, 2) [m]."""
    steps = STEPS_PER_INVERSE_FREQUENCY * ceil(curtain.max_frequency * FRAME_SECONDS)
    h = FRAME_SECONDS / steps
    x, v = curtain.start, np.zeros((curtain.cells + 1, 2))
    positions = []
    for _ in range(frames):
        for _ in range(steps):
            a1 = curtain.acceleration(x)
            v2 = v + h / 2 * a1
            a2 = curtain.acceleration(x + h / 2 * v)
            v3 = v + h / 2 * a2
            a3 = curtain.acceleration(x + h / 2 * v2)
            v4 = v + h * a3
            a4 = curtain.acceleration(x + h * v3)
            x = x + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
            v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        positions.append(x)
    return np.array(positions)


FRAMES = 60
GRIDS = (32, 64)  # cells along a side
ALL_GRIDS = (16, 32, 64, 128, 256)
DAMPING_TEST_FREQUENCY = 5.0  # [Hz] frequency of the vibration whose numerical damping is measured
# (substeps, iterations), from cheap to accurate; of explicit solvers, multiples of the fewest stable substeps.
RELAXED = ((5, 4), (5, 12), (5, 40), (10, 12), (20, 1), (20, 12), (30, 1), (60, 1), (60, 4), (120, 1))
SETTINGS = {
    "verlet": RELAXED,
    "xpbd": RELAXED,
    "lines": ((5, 1), (10, 1), (20, 1), (40, 1), (80, 1)),
    "explicit": ((1, 1), (2, 1)),
    "rk4": ((1, 1), (2, 1)),
    "implicit": ((5, 1), (10, 1), (20, 1), (40, 1), (80, 1)),
}


@dataclass(frozen=True)
class Point:
    """Frame time and error of one setting on one grid."""

    solver: str
    cells: int
    """Cells along a side."""
    substeps: int
    iterations: int
    median_ms: float
    """Median frame time [ms]."""
    p95_ms: float
    """95th percentile of the frame time [ms]."""
    rms_error: float
    """Root mean square over all particles and frames, as a share of the side."""
    max_error: float
    """Largest error of a particle in a frame, as a share of the side."""
    stretch: float
    """Excess length of the middle column at the end, as a share of the side."""
    max_strain: float
    """Largest strain after the last frame."""
    remaining_amplitude: float | None
    """Share of its amplitude that a 5 Hz spring has after one second; None for a solver without SI constants."""

    @property
    def setting(self) -> str:
        """Solver with substeps and iterations: `xpbd 5×12`."""
        iterations = f"×{self.iterations}" if not SOLVERS[self.solver].info.is_explicit else ""
        return f"{self.solver} {self.substeps}{iterations}"


def scene_of(curtain: Curtain, solver: str, substeps: int, iterations: int) -> Scene:
    """Return the curtain as a scene; its top edge lies along the x axis."""
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
            mass_lumping="uniform",
        ),
        verlet=VerletSprings(shear=0.0, bend=0.0),
        fabric=Fabric(warp=curtain.stiffness, weft=curtain.stiffness, shear=0.0, bend_spring=0.0),
        solver=Solver(solver, substeps, iterations, damping=0.0),
    )


def measure(curtain: Curtain, solver: str, substeps: int, iterations: int) -> Point:
    """Measure one setting, for one second of the swing."""
    exact = curtain_solution(curtain, FRAMES)
    scene = scene_of(curtain, solver, substeps, iterations)
    if SOLVERS[solver].info.is_explicit:
        with Simulation(scene) as simulation:
            substeps = min(substeps * simulation.substeps, 1000)  # the most that a scene can have
        scene = scene_of(curtain, solver, substeps, 1)
    with Simulation(scene) as simulation:
        simulation.step()  # compiles
        simulation.reset()
        ms, squares, largest = [], [], 0.0
        across = simulation.topology.start[:, 0].reshape(curtain.cells + 1, -1)  # nothing should move along x
        for frame in range(FRAMES):
            ms.append(timed_frame(simulation))
            x = simulation.positions().reshape(*across.shape, 3)
            difference = np.dstack([x[:, :, [2, 1]] - exact[frame][:, None], x[:, :, 0] - across])
            distance = np.linalg.norm(difference, axis=2)
            squares.append(float((distance**2).mean()))
            largest = float(np.maximum(largest, distance.max()))  # `max` would drop NaN
        column = x[:, curtain.cells // 2]
        length, exact_length = (float(np.linalg.norm(np.diff(c, axis=0), axis=1).sum()) for c in (column, exact[-1]))
        return Point(
            solver=solver,
            cells=curtain.cells,
            substeps=simulation.substeps,
            iterations=iterations,
            median_ms=float(np.median(ms)),
            p95_ms=float(np.percentile(ms, 95)),
            rms_error=sqrt(float(np.mean(squares))),
            max_error=largest,
            stretch=length - exact_length,
            max_strain=simulation.metrics().max_strain,
            remaining_amplitude=remaining_amplitude(solver, simulation.substeps, iterations),
        )


def remaining_amplitude(solver: str, substeps: int, iterations: int) -> float | None:
    """Return the share of its amplitude that a 5 Hz spring has after one second; below 1 by numerical damping.

    None for a solver without SI constants.
    """
    if SOLVERS[solver].info.stiffness_section == "verlet":
        return None
    omega = 2 * pi * DAMPING_TEST_FREQUENCY
    scene = Scene(
        # Particles of 1 kg.
        cloth=Cloth(rows=2, columns=2, width=1.0, height=1.0, area_density=1.0, mass_lumping="uniform"),
        fabric=Fabric(warp=omega**2, weft=0.0, shear=0.0, bend_spring=0.0),
        solver=Solver(solver, substeps, iterations, damping=0.0),
        forces=Forces(gravity=0.0),
    )
    with Simulation(scene) as simulation:
        topology = simulation.topology
        start = topology.start.copy()
        start[2:, 1] -= 0.1
        simulation.set_state(start)
        for _ in range(round(1 / FRAME_SECONDS)):
            simulation.step()
        displacement = float(topology.start[2, 1] - simulation.positions()[2, 1])
        return float(np.hypot(displacement, simulation.velocities()[2, 1] / omega) / 0.1)


def points(curtains: list[Curtain], only: str | None) -> Iterator[tuple[Curtain, str, int, int]]:
    """Yield the arguments of every measurement, of all solvers or of one."""
    for curtain in curtains:
        for solver, settings in SETTINGS.items():
            if only in (None, solver):
                for substeps, iterations in settings:
                    yield curtain, solver, substeps, iterations


def without_duplicates(found: list[Point]) -> list[Point]:
    """Return the points without duplicates, which arise where a solver uses more substeps than requested."""
    return list({(point.cells, point.setting): point for point in found}.values())


def pareto(found: list[Point]) -> list[Point]:
    """Return the Pareto front, from fast to accurate: finite, and no other point is both faster and more accurate."""
    front: list[Point] = []
    for point in sorted(found, key=lambda p: (p.median_ms, p.max_error)):
        if np.isfinite(point.max_error + point.rms_error) and (not front or point.max_error < front[-1].max_error):
            front.append(point)
    return front


def elbow(front: list[Point]) -> Point:
    """Return the elbow of the front: the point farthest below the line between its ends, on logarithmic axes."""
    t, e = (np.log([getattr(p, name) for p in front]) for name in ("median_ms", "max_error"))
    if len(front) < 3:
        return front[-1]
    below = (t - t[0]) / (t[-1] - t[0]) + (e - e[-1]) / (e[0] - e[-1])
    return front[int(below.argmin())]


# -- report ------------------------------------------------------------------------------------------------------------

HEADINGS = ("setting", "cells", "ms", "p95", "RMS error", "max error", "stretch", "strain", "5 Hz left", "")
LEGEND = (
    "Swinging curtain: pinned along its top, released at 45°, one second. Error: distance of the particles from the\n"
    "converged motion, as a share of the side · stretch: how much too long a column is at the end · 5 Hz left: share\n"
    "of the amplitude of a 5 Hz spring after one second · ← no setting is both faster and more accurate"
)


def grids(points: Sequence[Point]) -> dict[int, list[Point]]:
    """Return the points of each grid, by its cells along a side."""
    found: dict[int, list[Point]] = {}
    for point in points:
        found.setdefault(point.cells, []).append(point)
    return found


def summary_lines(points: Sequence[Point]) -> list[str]:
    """Return lines of text: the elbow of each grid's front, and the most accurate setting for each frame rate."""
    lines = []
    for cells, on_grid in grids(points).items():
        if not (front := pareto(on_grid)):
            lines.append(f"{cells} cells: no setting is finite")
            continue
        best = elbow(front)
        lines.append(
            f"{cells} cells: {best.setting} is the elbow of the Pareto front, {best.median_ms:.2f} ms a frame, largest"
            f" error {best.max_error:.2g} of the side"
        )
        for rate in FRAME_RATES:
            fits = [point for point in front if point.p95_ms <= 1000 / rate]
            if fits:
                lines.append(f"  most accurate at {rate} frames/s, {fits[-1].setting}: {fits[-1].max_error:.2g}")
    return lines


def print_report(points: Sequence[Point]) -> None:
    """Print a table of all points, the summary lines, and the machine in the last line."""
    console = wide_console()
    lines: list[Sequence[str]] = [HEADINGS]
    for on_grid in grids(points).values():
        front = pareto(on_grid)
        for p in on_grid:
            numbers = map(finite, (p.rms_error, p.max_error, p.stretch, p.max_strain), (".1e", ".1e", "+.2%", ".2%"))
            amplitude = "-" if p.remaining_amplitude is None else finite(p.remaining_amplitude, ".4f")
            times = (f"{p.median_ms:.3f}", f"{p.p95_ms:.3f}")
            lines.append((p.setting, str(p.cells), *times, *numbers, amplitude, "←" if p in front else ""))
    console.print(printed_table(lines))
    for line in (LEGEND, *summary_lines(points), " · ".join(machine().values())):
        console.print(line, soft_wrap=True)


def write_json(path: Path, points: Sequence[Point]) -> None:
    """Write all results as JSON. Raises OSError."""
    results = {**run_info(), "points": [asdict(point) for point in points], "summary": summary_lines(points)}
    with new_file(path) as file:
        file.write(json.dumps(results, indent=1).encode())


def load_pyplot() -> Any:
    """Return `matplotlib.pyplot`, set to write files only. Raises UsageError if matplotlib is not installed."""
    try:
        import matplotlib
    except ImportError:
        raise UsageError(f"--plot needs matplotlib: {install_command('plot')}") from None
    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def plot(folder: Path, points: Sequence[Point]) -> list[Path]:
    """Write a plot for each grid: error against frame time, on logarithmic axes. Return the paths. Raises OSError."""
    pyplot = load_pyplot()
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for cells, on_grid in grids(points).items():
        figure, axes = pyplot.subplots(figsize=(8, 5), dpi=120)
        for solver in dict.fromkeys(point.solver for point in on_grid):
            own = sorted((p for p in on_grid if p.solver == solver), key=lambda p: p.median_ms)
            axes.plot([p.median_ms for p in own], [p.max_error for p in own], "o", label=solver)
        front = pareto(on_grid)
        axes.plot([p.median_ms for p in front], [p.max_error for p in front], "-", color="0.6", zorder=0, label="front")
        for number, point in enumerate(front):  # alternately above and below, so that neighboring labels do not overlap
            offset, alignment = (((5, 5), "left"), ((-5, -12), "right"))[number % 2]
            position = (point.median_ms, point.max_error)
            axes.annotate(point.setting, position, offset, textcoords="offset points", ha=alignment, fontsize=8)
        axes.margins(x=0.12)  # room for the label of the fastest setting
        for rate in FRAME_RATES:
            axes.axvline(1000 / rate, color="0.8", linestyle=":", zorder=0)
            axes.text(1000 / rate, 0.98, f" {rate}/s", transform=axes.get_xaxis_transform(), va="top", fontsize=8)
        axes.set(xscale="log", yscale="log", xlabel="frame time [ms]", ylabel="largest error, as a share of the side")
        axes.set_title(f"Swinging curtain, {cells} × {cells} cells, one second")
        axes.legend()
        figure.tight_layout()
        path = folder / f"error_{cells}.png"
        with new_file(path) as file:
            figure.savefig(file, format="png", metadata={"Software": None})
        pyplot.close(figure)
        paths.append(path)
    return paths
