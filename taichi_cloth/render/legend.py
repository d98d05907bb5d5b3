"""The color scale of the view `strain`, for images and for the window: a color bar with strains in percent.

Text is drawn as rectangles from a bitmap font, because images have no other font.
"""

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from .fill import FULL_STRAIN, strain_colors
from .image_files import Pixels

# -- bitmap font -------------------------------------------------------------------------------------------------------

GLYPH_WIDTH, GLYPH_HEIGHT = 3, 5  # [units] of a glyph
GLYPHS = {
    "0": "### #.# #.# #.# ###",
    "1": ".#. ##. .#. .#. ###",
    "2": "### ..# ### #.. ###",
    "3": "### ..# .## ..# ###",
    "4": "#.# #.# ### ..# ..#",
    "5": "### #.. ### ..# ###",
    "6": "### #.. ### #.# ###",
    "7": "### ..# ..# .#. .#.",
    "8": "### #.# ### #.# ###",
    "9": "### #.# ### ..# ###",
    "+": "... .#. ### .#. ...",
    "-": "... ... ### ... ...",
    ".": "... ... ... ... .#.",
    "%": "#.# ..# .#. #.. #.#",
    " ": "... ... ... ... ...",
}


def text_width(text: str) -> int:
    """Return the width of a text [units]; glyphs are 1 unit apart."""
    return (GLYPH_WIDTH + 1) * len(text) - 1


def text_rectangles(text: str, left: float, top: float) -> NDArray[np.float64]:
    """Return a square of side 1 for every set pixel of the glyphs: rows of left, top, width, height [units], y down.

    Raises KeyError for a character that is not in `GLYPHS`.
    """
    found = []
    for k, letter in enumerate(text):
        for row, cells in enumerate(GLYPHS[letter].split()):
            for column, cell in enumerate(cells):
                if cell == "#":
                    found.append((left + (GLYPH_WIDTH + 1) * k + column, top + row, 1.0, 1.0))
    return np.array(found).reshape(-1, 4)


# -- color scale -------------------------------------------------------------------------------------------------------

UNIT = 1 / 216  # [image heights] a pixel of a glyph
STEPS = 40  # colors in the bar
BAR_WIDTH, BAR_HEIGHT, MARGIN = 5, 80, 8  # [units]
TEXT_COLOR = (0.22, 0.23, 0.25)

Rectangles = NDArray[np.float64]


def legend_rectangles() -> tuple[Rectangles, Rectangles]:
    """Return the rectangles of the scale, as rows of left, top, width, height [units], and their colors, (N, 3).

    x grows to the right from the right edge of the image, y grows down from the middle of its height.
    """
    strains = np.linspace(FULL_STRAIN, -FULL_STRAIN, STEPS, dtype=np.float32)
    colors = np.zeros((STEPS, 3), np.float32)
    strain_colors(strains, colors)
    left, step = -MARGIN - BAR_WIDTH, BAR_HEIGHT / STEPS
    tops = step * np.arange(STEPS) - BAR_HEIGHT / 2
    bar = [(left, top, BAR_WIDTH, step) for top in tops]
    ink = []
    for fraction in (1.0, 0.5, 0.0, -0.5, -1.0):
        text = f"{100 * fraction * FULL_STRAIN:+.0f}%" if fraction else "0%"
        y = -fraction * BAR_HEIGHT / 2
        ink += [(left - 2, y - 0.5, 2, 1), *text_rectangles(text, left - 4 - text_width(text), y - GLYPH_HEIGHT / 2)]
    return np.array([*bar, *ink]), np.concatenate([colors, np.tile(TEXT_COLOR, (len(ink), 1))])


def draw_legend(image: Pixels) -> Pixels:
    """Draw the scale into an image, uint8 (height, width, 3), at the right edge, and return the image."""
    height, width, _ = image.shape
    unit = max(1, round(UNIT * height))
    for (left, top, w, h), color in zip(*legend_rectangles(), strict=True):
        x, y = (max(0, round(c)) for c in (width + unit * left, height / 2 + unit * top))
        x_end, y_end = (max(0, round(c)) for c in (width + unit * (left + w), height / 2 + unit * (top + h)))
        image[y:y_end, x:x_end] = np.rint(255 * color)
    return image


class WindowLegend:
    """The color scale as triangles on the canvas of the window."""

    def __init__(self) -> None:
        self._rectangles, colors = legend_rectangles()
        corners = 6 * len(self._rectangles)
        self._position, self._color = ti.Vector.field(2, ti.f32, corners), ti.Vector.field(3, ti.f32, corners)
        self._color.from_numpy(np.repeat(colors, 6, axis=0).astype(np.float32))
        self._laid_out_for: tuple[tuple[int, int], float] | None = None
        """Size and `bottom` of the last call of `show`."""

    def show(self, canvas: ti.ui.Canvas, size: tuple[int, int], bottom: float = 0.0) -> None:
        """Draw the scale on a canvas of `size` [pixels], whose points run from (0, 0) at the bottom left to (1, 1).

        It is centered vertically, or moved up until it is entirely above `bottom`.
        """
        if (size, bottom) != self._laid_out_for:
            self._laid_out_for = size, bottom
            middle = max(0.5, bottom + UNIT * (BAR_HEIGHT + GLYPH_HEIGHT) / 2)
            left, top, w, h = self._rectangles.T
            x, x_end = (1 + UNIT * c * size[1] / size[0] for c in (left, left + w))
            y, y_end = (middle - UNIT * c for c in (top, top + h))
            corners = [(x, y), (x_end, y), (x_end, y_end), (x, y), (x_end, y_end), (x, y_end)]
            points = np.stack([np.stack(corner, axis=-1) for corner in corners], axis=1)
            self._position.from_numpy(points.reshape(-1, 2).astype(np.float32))
        canvas.triangles(self._position, per_vertex_color=self._color)
