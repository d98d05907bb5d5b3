"""Energy and strain of the last seconds as curves in a corner of the picture. NumPy only: it runs without a display."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..measure.cloth import Measures

SPAN = 5.0  # [s] of simulated time
MOST = 320  # samples in it: a frame each, and some to spare
BOX = (0.42, 0.16)  # width and height of a chart [heights of the picture]
GAP = 0.02  # between charts, and from the edge of the picture [heights of it]
LEAST = 1e-9  # height of a chart whose curves are all zero

Rgb = tuple[float, float, float]
FRAME: Rgb = (0.45, 0.45, 0.48)
PAPER: Rgb = (0.07, 0.07, 0.08)


class Curve(NamedTuple):
    """One of the curves: what it is, its unit, and its column in the history."""

    name: str
    unit: str
    column: int
    colour: Rgb


CHARTS = (
    (Curve("kinetic energy", "J", 1, (1.0, 0.62, 0.2)), Curve("energy of height", "J", 2, (0.45, 0.75, 1.0))),
    (Curve("largest strain", "%", 3, (1.0, 0.38, 0.38)), Curve("mean strain", "%", 4, (0.55, 0.9, 0.5))),
)
SEGMENTS = sum(4 + len(curves) * (MOST - 1) for curves in CHARTS)  # room for all lines


class History:
    """What was measured in the last seconds: rows of time [s], two energies [J], two strains [%]."""

    def __init__(self) -> None:
        self._rows: deque[tuple[float, ...]] = deque(maxlen=MOST)

    def add(self, seconds: float, measures: Measures) -> None:
        """Takes what was measured at this simulated time. One that lies before the last begins anew."""
        if self._rows and seconds < self._rows[-1][0]:
            self._rows.clear()
        if (self._rows and seconds == self._rows[-1][0]) or not measures.finite:
            return
        strains = 100 * measures.max_strain, 100 * measures.mean_strain
        self._rows.append((seconds, measures.kinetic_energy, measures.potential_energy, *strains))
        while self._rows[-1][0] - self._rows[0][0] > SPAN:
            self._rows.popleft()

    @property
    def rows(self) -> NDArray[np.float64]:
        """(samples, 5). The energy of height counts from the lowest in sight: only its changes say something."""
        rows = np.array(self._rows, np.float64).reshape(-1, 5)
        rows[:, 2] -= rows[:, 2].min(initial=np.inf) if len(rows) else 0.0
        return rows


def legend(rows: NDArray[np.float64]) -> list[tuple[str, Rgb]]:
    """A line for every curve, in its colour: its value now; and how high its chart is."""
    lines = []
    for curves in CHARTS:
        top = top_of(rows, curves)
        for curve in curves:
            now = rows[-1, curve.column] if len(rows) else 0.0
            lines.append((f"{curve.name}: {now:.3g} of {top:.3g} {curve.unit}", curve.colour))
    return lines


def top_of(rows: NDArray[np.float64], curves: tuple[Curve, ...]) -> float:
    """The largest number in a chart."""
    return max(float(rows[:, curve.column].max(initial=0.0)) for curve in curves)


def boxes(aspect: float) -> list[NDArray[np.float64]]:
    """Lower left and upper right corner of each chart, (2, 2), as screen points; the first stands at the top."""
    width, height, right = BOX[0] / aspect, BOX[1], 1 - GAP / aspect
    bottoms = [GAP + k * (height + GAP) for k in reversed(range(len(CHARTS)))]
    return [np.array([[right - width, bottom], [right, bottom + height]]) for bottom in bottoms]


def top() -> float:
    """Where the picture is free of charts, with the gap above them [heights of the picture]."""
    return GAP + len(CHARTS) * (BOX[1] + GAP)


def lines(rows: NDArray[np.float64], aspect: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Ends of all segments as screen points, (2·`SEGMENTS`, 2), and their colours, (2·`SEGMENTS`, 3).

    Time runs to the right and ends at the right edge; behind the last one all are outside of the picture.
    """
    ends, colours = np.full((SEGMENTS, 2, 2), -1.0), np.zeros((SEGMENTS, 2, 3))
    first = 0
    for box, curves in zip(boxes(aspect), CHARTS, strict=True):
        (left, bottom), (right, top) = box
        corners = np.array([[left, bottom], [right, bottom], [right, top], [left, top], [left, bottom]])
        paths = [(corners, FRAME)]
        height = max(top_of(rows, curves), LEAST)
        for curve in curves:
            if len(rows) > 1:
                along = 1 + (rows[:, 0] - rows[-1, 0]) / SPAN
                share = np.stack([along, rows[:, curve.column] / height], axis=1)
                paths.append((box[0] + np.clip(share, 0.0, 1.0) * (box[1] - box[0]), curve.colour))
        for path, colour in paths:
            count = len(path) - 1
            ends[first : first + count, 0], ends[first : first + count, 1] = path[:-1], path[1:]
            colours[first : first + count] = colour
            first += count
    return ends.reshape(-1, 2).astype(np.float32), colours.reshape(-1, 3).astype(np.float32)


def paper(aspect: float) -> NDArray[np.float32]:
    """The ground that the charts are drawn on: six corners of triangles for each, as screen points."""
    corner = np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]])
    return np.concatenate([box[0] + corner * (box[1] - box[0]) for box in boxes(aspect)]).astype(np.float32)
