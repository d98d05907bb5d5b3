"""Charts of energy and strain over the last seconds, in a corner of the window.

All geometry is computed in NumPy and needs no display. Only `CurveDrawing` uses the UI toolkit.
"""

from collections import deque
from typing import NamedTuple

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..geometry.topology import ClothMetrics

CHART_SECONDS = 5.0  # [s] simulated time that a chart shows
MAX_SAMPLES = 320  # samples in that time: one a frame, and some to spare
CHART_SIZE = (0.42, 0.16)  # width and height of a chart [heights of the window]
CHART_GAP = 0.02  # between charts, and from the edge of the window [heights of the window]
MIN_RANGE = 1e-9  # upper limit of a chart whose values are all zero

Rgb = tuple[float, float, float]
FRAME_COLOR: Rgb = (0.45, 0.45, 0.48)
BACKGROUND_COLOR: Rgb = (0.07, 0.07, 0.08)


class Curve(NamedTuple):
    """One curve of a chart."""

    name: str
    unit: str
    column: int
    """Its column in `History.rows`."""
    color: Rgb


CHARTS = (
    (Curve("kinetic energy", "J", 1, (1.0, 0.62, 0.2)), Curve("potential energy", "J", 2, (0.45, 0.75, 1.0))),
    (Curve("max strain", "%", 3, (1.0, 0.38, 0.38)), Curve("mean strain", "%", 4, (0.55, 0.9, 0.5))),
)
SEGMENTS = sum(
    4 + len(curves) * (MAX_SAMPLES - 1) for curves in CHARTS
)  # capacity: line segments of all frames and curves


class History:
    """Metrics of the last `CHART_SECONDS` seconds.

    A row has the time [s], kinetic and potential energy [J], and max and mean strain [%].
    """

    def __init__(self) -> None:
        self._rows: deque[tuple[float, ...]] = deque(maxlen=MAX_SAMPLES)

    def add(self, seconds: float, metrics: ClothMetrics) -> None:
        """Add the metrics at a simulated time [s]. A time before the last one clears the history first.

        Ignores a second sample at the last time, and metrics that are not finite.
        """
        if self._rows and seconds < self._rows[-1][0]:
            self._rows.clear()
        if (self._rows and seconds == self._rows[-1][0]) or not metrics.finite:
            return
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


def legend(rows: NDArray[np.float64]) -> list[tuple[str, Rgb]]:
    """Return a line of text and the color of every curve: its current value, and the upper limit of its chart."""
    line_segments = []
    for curves in CHARTS:
        full_scale = upper_limit(rows, curves)
        for curve in curves:
            now = rows[-1, curve.column] if len(rows) else 0.0
            line_segments.append(
                (f"{curve.name}: {now:.3g} {curve.unit}, full scale {full_scale:.3g} {curve.unit}", curve.color)
            )
    return line_segments


def upper_limit(rows: NDArray[np.float64], curves: tuple[Curve, ...]) -> float:
    """Return the largest value in a chart."""
    return max(float(rows[:, curve.column].max(initial=0.0)) for curve in curves)


def chart_boxes(aspect: float) -> list[NDArray[np.float64]]:
    """Return the lower left and upper right corner of each chart, from the top chart down: screen points, (2, 2)."""
    width, height, right = CHART_SIZE[0] / aspect, CHART_SIZE[1], 1 - CHART_GAP / aspect
    bottoms = [CHART_GAP + k * (height + CHART_GAP) for k in reversed(range(len(CHARTS)))]
    return [np.array([[right - width, bottom], [right, bottom + height]]) for bottom in bottoms]


def top() -> float:
    """Return the upper end of the area that charts use, with the gap above them [heights of the window]."""
    return CHART_GAP + len(CHARTS) * (CHART_SIZE[1] + CHART_GAP)


def line_segments(rows: NDArray[np.float64], aspect: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the ends of all line segments as screen points, (2·`SEGMENTS`, 2), and their colors, (2·`SEGMENTS`, 3).

    Time runs to the right, and the right edge is now. Unused segments at the end of the arrays lie outside the window.
    """
    ends, colors = np.full((SEGMENTS, 2, 2), -1.0), np.zeros((SEGMENTS, 2, 3))
    first = 0
    for box, curves in zip(chart_boxes(aspect), CHARTS, strict=True):
        (left, bottom), (right, top) = box
        corners = np.array([[left, bottom], [right, bottom], [right, top], [left, top], [left, bottom]])
        paths = [(corners, FRAME_COLOR)]
        full_scale = max(upper_limit(rows, curves), MIN_RANGE)
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
        ends, colors = line_segments(history.rows, aspect)
        self._ends.from_numpy(ends)
        self._colors.from_numpy(colors)
        self._background.from_numpy(background(aspect))
        canvas.triangles(self._background, color=BACKGROUND_COLOR)
        canvas.lines(self._ends, LINE_WIDTH, per_vertex_color=self._colors)
