"""The scale beside the view `strain`, in pictures and in the window: its colours and the strains they stand for."""

from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from .fill import FULL_STRAIN, strain_colours
from .lettering import HEIGHT, text_rectangles, text_width
from .png import Pixels

UNIT = 1 / 216  # of the picture's height: a pixel of a letter
STEPS = 40  # colours in the bar
BAR_WIDTH, BAR_HEIGHT, MARGIN = 5, 80, 8  # [units]
INK = (0.22, 0.23, 0.25)

Rectangles = NDArray[np.float64]


def rectangles() -> tuple[Rectangles, Rectangles]:
    """Rows of left, top, width and height, and their colours (N, 3).

    In units; x goes right from the picture's right edge and y down from the middle of its height.
    """
    strains = np.linspace(FULL_STRAIN, -FULL_STRAIN, STEPS, dtype=np.float32)
    colours = np.zeros((STEPS, 3), np.float32)
    strain_colours(strains, colours)
    left, step = -MARGIN - BAR_WIDTH, BAR_HEIGHT / STEPS
    tops = step * np.arange(STEPS) - BAR_HEIGHT / 2
    bar = [(left, top, BAR_WIDTH, step) for top in tops]
    ink = []
    for share in (1.0, 0.5, 0.0, -0.5, -1.0):
        text = f"{100 * share * FULL_STRAIN:+.0f}%" if share else "0%"
        y = -share * BAR_HEIGHT / 2
        ink += [(left - 2, y - 0.5, 2, 1), *text_rectangles(text, left - 4 - text_width(text), y - HEIGHT / 2)]
    return np.array([*bar, *ink]), np.concatenate([colours, np.tile(INK, (len(ink), 1))])


def stamp(picture: Pixels) -> Pixels:
    """The picture, uint8 of shape (height, width, 3), with the scale drawn into it at the right."""
    height, width, _ = picture.shape
    unit = max(1, round(UNIT * height))
    for (left, top, wide, high), colour in zip(*rectangles(), strict=True):
        x, y = (max(0, round(c)) for c in (width + unit * left, height / 2 + unit * top))
        x_end, y_end = (max(0, round(c)) for c in (width + unit * (left + wide), height / 2 + unit * (top + high)))
        picture[y:y_end, x:x_end] = np.rint(255 * colour)
    return picture


class WindowScale:
    """The same as triangles of the window's canvas."""

    def __init__(self) -> None:
        self._places, colours = rectangles()
        corners = 6 * len(self._places)
        self._position, self._colour = ti.Vector.field(2, ti.f32, corners), ti.Vector.field(3, ti.f32, corners)
        self._colour.from_numpy(np.repeat(colours, 6, axis=0).astype(np.float32))
        self._stands: tuple[tuple[int, int], float] | None = None

    def show(self, canvas: Any, size: tuple[int, int], bottom: float = 0.0) -> None:
        """Draws it onto a canvas of so many pixels, whose points run from (0, 0) at the bottom left to (1, 1).

        It stands in the middle, or higher: all of it above `bottom`.
        """
        if (size, bottom) != self._stands:
            self._stands = size, bottom
            middle = max(0.5, bottom + UNIT * (BAR_HEIGHT + HEIGHT) / 2)
            left, top, wide, high = self._places.T
            x, x_end = (1 + UNIT * c * size[1] / size[0] for c in (left, left + wide))
            y, y_end = (middle - UNIT * c for c in (top, top + high))
            corners = [(x, y), (x_end, y), (x_end, y_end), (x, y), (x_end, y_end), (x, y_end)]
            points = np.stack([np.stack(corner, axis=-1) for corner in corners], axis=1)
            self._position.from_numpy(points.reshape(-1, 2).astype(np.float32))
        canvas.triangles(self._position, per_vertex_color=self._colour)
