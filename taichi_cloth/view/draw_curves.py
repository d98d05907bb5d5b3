"""Draws the curves with the toolkit, over the picture."""

from typing import Any

import taichi as ti

from . import curves
from .curves import History

LINE = 0.002  # width [heights of the picture]


class CurveDrawing:
    """Fields for the toolkit to draw from: make it once a window."""

    def __init__(self) -> None:
        self._ends = ti.Vector.field(2, ti.f32, 2 * curves.SEGMENTS)
        self._colours = ti.Vector.field(3, ti.f32, 2 * curves.SEGMENTS)
        self._paper = ti.Vector.field(2, ti.f32, 6 * len(curves.CHARTS))

    def draw(self, canvas: Any, history: History, aspect: float) -> None:
        """Over what is on the canvas."""
        ends, colours = curves.lines(history.rows, aspect)
        self._ends.from_numpy(ends)
        self._colours.from_numpy(colours)
        self._paper.from_numpy(curves.paper(aspect))
        canvas.triangles(self._paper, color=curves.PAPER)
        canvas.lines(self._ends, LINE, per_vertex_color=self._colours)
