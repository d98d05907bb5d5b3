"""What was measured: charts of energy and strain over the last seconds, in a corner of the window, and lines of text.

All geometry is computed in NumPy and needs no display. Only `CurveDrawing` uses the UI toolkit.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..geometry.topology import ClothMetrics, Topology
from ..scene.overrides import with_solver
from ..scene.schema import FRAME_SECONDS
from ..scene.solver_catalog import SOLVER_CATALOG
from ..simulation.builder import unsupported_by
from ..simulation.convergence import TORN_APART
from ..simulation.error_estimate import faster_solver
from ..simulation.simulation import Simulation
from .error_process import MEASURED_AGAINST, error_lines, unfinished
from .input import OWN_FABRIC, SPEEDS

if TYPE_CHECKING:
    from .session import Session

CHART_SECONDS = 5.0  # [s] simulated time that a chart shows
MAX_SAMPLES = 320  # samples in that time: one a frame, and some to spare
CHART_SIZE = (0.42, 0.16)  # width and height of a chart [heights of the window]
CHART_GAP = 0.02  # between charts, and from the edge of the window [heights of the window]

# Lowest upper limits of the charts. With smaller ones a cloth at rest would fill them with rounding errors and with its
# creep on colliders, which reach 4e-6 of m·g·L on the shipped scenes.
MIN_RISE = 1e-4  # energy that raises the cloth by this part of its longer side: a tenth of a pixel in a large image
STANDARD_GRAVITY = 9.80665  # [m/s²] not the slider, which would change the scale
MIN_STRAIN = 0.1  # [%] resolution of the strain in the statistics

Rgb = tuple[float, float, float]
FRAME_COLOR: Rgb = (0.45, 0.45, 0.48)
BACKGROUND_COLOR: Rgb = (0.07, 0.07, 0.08)


# What each solver is for (docs/choosing.md), in the words of a list.
SOLVER_USES = {
    "verlet": "games and demos, small grids",
    "xpbd": "soft cloth",
    "explicit": "accurate, for moderate stiffness",
    "lines": "stiff or fine grids, few substeps",
    "rk4": "most accurate, to verify others",
    "implicit": "stiff cloth, also triangle meshes",
}


class Curve(NamedTuple):
    """One curve of a chart."""

    name: str
    unit: str
    column: int
    """Its column in `History.rows`."""
    color: Rgb


CHARTS = (
    (
        Curve("kinetic energy", "J", 1, (1.0, 0.62, 0.2)),
        Curve("potential energy change", "J", 2, (0.45, 0.75, 1.0)),
    ),
    (Curve("max strain", "%", 3, (1.0, 0.38, 0.38)), Curve("mean strain", "%", 4, (0.55, 0.9, 0.5))),
)
MIN_TIMES = 3  # samples for a median, so that a frame that compiled does not count
SEGMENTS = sum(
    4 + len(curves) * (MAX_SAMPLES - 1) for curves in CHARTS
)  # capacity: line segments of all frames and curves


class History:
    """Metrics of the last `CHART_SECONDS` seconds, and times of frames.

    A row has the time [s], kinetic and potential energy [J], and max and mean strain [%].
    """

    def __init__(self, topology: Topology) -> None:
        self._rows: deque[tuple[float, ...]] = deque(maxlen=MAX_SAMPLES)
        self._times: deque[tuple[float, float]] = deque(maxlen=MAX_SAMPLES)  # number of frames, and time of one [ms]
        self.min_limits = MIN_RISE * topology.mass.sum() * STANDARD_GRAVITY * topology.longest_side, MIN_STRAIN
        """Lowest upper limit of each chart, in the unit of its curves."""

    def add(self, seconds: float, metrics: ClothMetrics, frame_ms: float = 0.0) -> None:
        """Add the metrics at a simulated time [s], and the time of a frame [ms]. An earlier time clears the history.

        Ignores a second sample at the last time, and metrics that are not finite.
        """
        if self._rows and seconds < self._rows[-1][0]:
            self._rows.clear()
            self._times.clear()
        if (self._rows and seconds == self._rows[-1][0]) or not metrics.finite:
            return
        if self._rows:
            self._times.append(((seconds - self._rows[-1][0]) / FRAME_SECONDS, frame_ms))
        strains = 100 * metrics.max_strain, 100 * metrics.mean_strain
        self._rows.append((seconds, metrics.kinetic_energy, metrics.potential_energy, *strains))
        while self._rows[-1][0] - self._rows[0][0] > CHART_SECONDS:
            self._rows.popleft()

    @property
    def rows(self) -> NDArray[np.float64]:
        """All samples, (samples, 5). Potential energy is relative to its lowest sample: only its changes matter."""
        rows = np.array(self._rows, np.float64).reshape(-1, 5)
        rows[:, 2] -= rows[:, 2].min(initial=np.inf) if len(rows) else 0.0
        return rows

    @property
    def frame_ms(self) -> float:
        """Median time of the frames that took the last second of wall time [ms]; 0 if all took less than that."""
        recent: list[float] = []
        total = 0.0
        for frames, ms in reversed(self._times):
            recent.append(ms)
            total += frames * ms
            if total >= 1000.0 and len(recent) >= MIN_TIMES:
                return median(recent)
        return 0.0

    @property
    def limits(self) -> list[float]:
        """Upper limit of each chart: its largest value, but not less than `min_limits`."""
        rows = self.rows
        columns = [[curve.column for curve in curves] for curves in CHARTS]
        return [float(rows[:, c].max(initial=lowest)) for c, lowest in zip(columns, self.min_limits, strict=True)]


def legend(history: History) -> list[tuple[str, Rgb]]:
    """Return a line of text and the color of every curve: its current value, and the upper limit of its chart."""
    rows, lines = history.rows, []
    for curves, full_scale in zip(CHARTS, history.limits, strict=True):
        for curve in curves:
            now = rows[-1, curve.column] if len(rows) else 0.0
            line = f"{curve.name}: {now:.3g} {curve.unit} (scale to {full_scale:.3g})"
            lines.append((line, curve.color))
    return lines


def chart_boxes(aspect: float) -> list[NDArray[np.float64]]:
    """Return the lower left and upper right corner of each chart, from the top chart down: screen points, (2, 2)."""
    width, height, right = CHART_SIZE[0] / aspect, CHART_SIZE[1], 1 - CHART_GAP / aspect
    bottoms = [CHART_GAP + k * (height + CHART_GAP) for k in reversed(range(len(CHARTS)))]
    return [np.array([[right - width, bottom], [right, bottom + height]]) for bottom in bottoms]


def top() -> float:
    """Return the upper end of the area that charts use, with the gap above them [heights of the window]."""
    return CHART_GAP + len(CHARTS) * (CHART_SIZE[1] + CHART_GAP)


def line_segments(history: History, aspect: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the ends of all line segments as screen points, (2·`SEGMENTS`, 2), and their colors, (2·`SEGMENTS`, 3).

    Time runs to the right, and the right edge is now. Unused segments at the end of the arrays lie outside the window.
    """
    ends, colors = np.full((SEGMENTS, 2, 2), -1.0), np.zeros((SEGMENTS, 2, 3))
    rows, first = history.rows, 0
    for box, curves, full_scale in zip(chart_boxes(aspect), CHARTS, history.limits, strict=True):
        (left, bottom), (right, top) = box
        corners = np.array([[left, bottom], [right, bottom], [right, top], [left, top], [left, bottom]])
        paths = [(corners, FRAME_COLOR)]
        for curve in curves:
            if len(rows) > 1:
                time = 1 + (rows[:, 0] - rows[-1, 0]) / CHART_SECONDS
                points = np.stack([time, rows[:, curve.column] / full_scale], axis=1)
                paths.append((box[0] + np.clip(points, 0.0, 1.0) * (box[1] - box[0]), curve.color))
        for path, color in paths:
            count = len(path) - 1
            ends[first : first + count, 0], ends[first : first + count, 1] = path[:-1], path[1:]
            colors[first : first + count] = color
            first += count
    return ends.reshape(-1, 2).astype(np.float32), colors.reshape(-1, 3).astype(np.float32)


def background(aspect: float) -> NDArray[np.float32]:
    """Return the background of the charts: two triangles for each, as screen points, (6·charts, 2)."""
    corner = np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]])
    return np.concatenate([box[0] + corner * (box[1] - box[0]) for box in chart_boxes(aspect)]).astype(np.float32)


LINE_WIDTH = 0.002  # line width [heights of the window]


class CurveDrawing:
    """Draws the charts with the UI toolkit. It owns Taichi fields: make one for each window."""

    def __init__(self) -> None:
        self._ends = ti.Vector.field(2, ti.f32, 2 * SEGMENTS)
        self._colors = ti.Vector.field(3, ti.f32, 2 * SEGMENTS)
        self._background = ti.Vector.field(2, ti.f32, 6 * len(CHARTS))

    def draw(self, canvas: ti.ui.Canvas, history: History, aspect: float) -> None:
        """Draw the charts over the image on the canvas. `aspect`: width over height of the window."""
        ends, colors = line_segments(history, aspect)
        self._ends.from_numpy(ends)
        self._colors.from_numpy(colors)
        self._background.from_numpy(background(aspect))
        canvas.triangles(self._background, color=BACKGROUND_COLOR)
        canvas.lines(self._ends, LINE_WIDTH, per_vertex_color=self._colors)


# -- lines of text -----------------------------------------------------------------------------------------------------


def statistics(session: Session, times: dict[str, float], fps: float, view: str | None = None) -> str:
    """Return lines of text: what runs, with speed, accuracy and size of the simulation.

    `times`: of the steps of a displayed frame besides physics and measuring, by name [ms]. `fps`: displayed frames per
    second. `view`: shown in place of the session's, for a display with a view of its own.
    """
    simulation, metrics, topology = session.simulation, session.metrics, session.simulation.topology
    steps = times | {"measuring": session.measuring_ms}
    slow = "" if SPEEDS[session.speed] == 1 else f" · {session.speed} speed"
    clip = " · recording a clip" if session.capture.clip_is_on else ""
    strain, mean = 100 * metrics.max_strain, 100 * metrics.mean_strain
    error, *parts = error_lines(session.meter, frozen=session.frozen)
    fabric, links = simulation.scene.fabric.preset or OWN_FABRIC, "springs" if topology.membrane is None else "edges"
    lines = (
        f"{simulation.scene.name} · {simulation.method.partition(' · ')[0]} · {fabric} · {view or session.view}",
        f"frame {simulation.frame} · {'frozen' if session.frozen else f'{fps:.0f} fps'}{slow}{clip}",
        f"physics {milliseconds(session.physics_ms)} ms of {1e3 * FRAME_SECONDS:.1f} ms",
        ", ".join(f"{name} {milliseconds(ms)} ms" for name, ms in steps.items()),
        f"strain: max {strain:.1f} %, mean {mean:.1f} %",
        error,
        *([MEASURED_AGAINST] if session.meter and session.meter.error else []),
        *parts,
        f"energy: kinetic {metrics.kinetic_energy:.3g} J, potential {metrics.potential_energy:.3g} J",
        f"max collider penetration: {1e3 * metrics.penetration:.3g} mm",
        *intersection_lines(simulation, metrics),
        f"{simulation.method}: {' '.join(simulation.features)}",
        f"{topology.particle_count} particles, {topology.spring_count} {links}, {topology.pinned.sum()} pins",
        *filter(None, [simulation.warnings, unfinished(simulation)]),
    )
    return "\n".join(lines)


def intersection_lines(simulation: Simulation, metrics: ClothMetrics) -> list[str]:
    """Return how often an edge passes through a triangle, and whether contact keeps it 0; [] without contact."""
    if metrics.intersections is None:
        return []
    note = "" if simulation.penetration_free_since is None else " (guaranteed)"
    return [f"self-intersections: {metrics.intersections}{note}"]


def milliseconds(time: float) -> str:
    """Return a measured time [ms] as text: a number, or "-" if there is none yet."""
    return f"{time:.{int(time < 10)}f}" if time > 0 else "-"


def alert(session: Session) -> str:
    """Return what the user should know at once: that the cloth blew up, or is simulated too slowly; else ""."""
    return blown_up_line(session) or slow_line(session)


def blown_up_line(session: Session) -> str:
    """Return a line if a spring is stretched as no cloth survives, and no hand stretches it; else an empty one."""
    strain = session.metrics.max_strain
    if strain <= TORN_APART or len(session.simulation.grabbed):
        return ""
    return f"strain {100 * strain:.0f} %: the cloth may have blown up; Reset (R), Undo (Z) or more substeps help"


def slow_line(session: Session) -> str:
    """Return a line if the simulation falls behind the wall clock, with a faster choice; else an empty one."""
    simulation, ms, limit = session.simulation, session.history.frame_ms, 1e3 * FRAME_SECONDS / SPEEDS[session.speed]
    if session.frozen or session.deferred or ms <= limit:
        return ""
    scene, original, topology = simulation.scene, simulation.original_scene, simulation.topology
    iterations = 1 if simulation.solver.info.is_explicit else int(simulation.params["iterations"])
    running = replace(scene.solver, substeps=simulation.substeps, iterations=iterations)
    no_grid, model = unsupported_by(scene, topology).grid_only, scene.fabric.model
    others = [
        with_solver(scene, name, original).solver
        for name, info in SOLVER_CATALOG.items()
        # The substeps of explicit solvers depend on the fabric.
        if name != running.name and not info.is_explicit
        if not (info.grid_only and no_grid) and model in info.models
        if info.uses_si_constants or model == "springs"
    ]
    faster = faster_solver(math.sqrt(topology.particle_count) - 1, running, others, ms, limit)
    if not faster:
        fewer = {"iterations": iterations > 1, "substeps": simulation.substeps > simulation.min_stable_substeps}
        faster = next((f"fewer {name}" for name, possible in fewer.items() if possible), "a coarser cloth")
    return f"too slow: a frame needs {ms:.3g} ms of {limit:.1f}; try {faster}"
