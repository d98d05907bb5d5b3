"""Colors: of the cloth by its pattern, at the corners of the triangles, and color scales of views with their legend.

There are no textures. Text is drawn as rectangles from a bitmap font, because images have no other font.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import floor, log10
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..geometry.grid import NO_GRID
from ..geometry.topology import Topology
from ..scene.fabric_schema import Look
from .image_files import Pixels
from .shading import FULL_STRAIN, strain_colors

Fractions = NDArray[np.float64]  # fraction of the second color at each corner, (T, 3), 0…1
Indices = NDArray[np.signedinteger[Any]]  # integer grid indices

HALF_DYED_FRACTION = 0.55  # fraction of the second color where only one of two crossing yarns of a gingham is dyed
TWILL_VALLEY_FRACTION = 0.5  # fraction of the second color in the valleys of a twill

FAMILY_COLORS = {"structural": (0.16, 0.33, 0.55), "shear": (0.62, 0.44, 0.24), "bend": (0.5, 0.5, 0.5)}  # of springs


def pattern_colors(topology: Topology, look: Look) -> NDArray[np.float32]:
    """Return the color of every corner without light, factors 0…1, (3·T, 3)."""
    if topology.shape == NO_GRID:  # a mesh file: rings around its middle
        rows, columns = (np.repeat(of_cells[:, None], 3, axis=1) for of_cells in topology.cells.T)
    else:
        rows, columns = np.divmod(topology.triangles, topology.shape[1])
    fraction = PATTERNS[look.pattern](topology.cells, rows, columns, look.pattern_scale)
    first, second = np.array(rgb(look.color)), np.array(rgb(look.second_color))
    colors: NDArray[np.float32] = (first + fraction.reshape(-1, 1) * (second - first)).astype(np.float32)
    return colors


def merge_vertices(
    triangles: NDArray[np.int32], colors: NDArray[np.float32]
) -> tuple[NDArray[np.int64], NDArray[np.uint8], NDArray[np.int64]]:
    """Merge triangle corners of equal particle and color into vertices.

    `triangles`: the particles of each, (T, 3). `colors`: of every corner, factors 0…1, (3·T, 3). Return the particle
    (V,) and the color (V, 3), 0…255, of every vertex, and the three vertices of every triangle (T, 3).
    """
    rgb = np.rint(255 * colors).astype(np.int64)
    key = (triangles.ravel().astype(np.int64) << 24) + (rgb << np.array([16, 8, 0])).sum(axis=1)
    unique, corners = np.unique(key, return_inverse=True)
    rgb_bytes = (unique[:, None] >> np.array([16, 8, 0]) & 255).astype(np.uint8)
    return unique >> 24, rgb_bytes, corners.reshape(-1, 3)


def family_colors(topology: Topology) -> NDArray[np.float32]:
    """Return the color of every spring, by its family, (E, 3)."""
    colors = [FAMILY_COLORS[batch.family] for batch in topology.batches for _ in range(batch.count)]
    return np.array(colors, np.float32).reshape(-1, 3)


def rgb(color: str) -> tuple[float, float, float]:
    """Return a color "#rrggbb" as factors 0…1."""
    red, green, blue = (int(color[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return red, green, blue


# -- patterns: cells (T, 2), rows and columns of the corners (T, 3), cells per repeat → fraction of the second color ---


def _plain(cells: Indices, rows: Indices, columns: Indices, n: int) -> Fractions:
    """The first color everywhere."""
    return np.zeros(rows.shape)


def _check(cells: Indices, rows: Indices, columns: Indices, n: int) -> Fractions:
    """Squares of n × n cells in alternating colors."""
    return _per_corner((cells // n).sum(axis=1) % 2)


def _stripe(cells: Indices, rows: Indices, columns: Indices, n: int) -> Fractions:
    """Stripes along the columns, n cells wide."""
    return _per_corner(cells[:, 1] // n % 2)


def _gingham(cells: Indices, rows: Indices, columns: Indices, n: int) -> Fractions:
    """Dyed and undyed yarns in both directions; an intermediate color where one of the two is undyed."""
    return _per_corner(np.array([0.0, HALF_DYED_FRACTION, 1.0])[(cells // n % 2).sum(axis=1)])


def _twill(cells: Indices, rows: Indices, columns: Indices, n: int) -> Fractions:
    """Diagonal ridges, 2·n cells apart."""
    fraction: Fractions = TWILL_VALLEY_FRACTION * np.abs((rows + columns) % (2 * n) - n) / n
    return fraction


def _ring(cells: Indices, rows: Indices, columns: Indices, n: int) -> Fractions:
    """A spot of the second color at every second particle in both directions."""
    fraction: Fractions = ((rows % 2 == 0) & (columns % 2 == 0)).astype(float)
    return fraction


def _per_corner(fraction: NDArray[np.generic]) -> Fractions:
    """Repeat the fraction of every triangle, (T,), at its three corners, (T, 3)."""
    return np.repeat(np.asarray(fraction, float)[:, None], 3, axis=1)


PATTERNS: dict[str, Callable[[Indices, Indices, Indices, int], Fractions]] = {
    "plain": _plain,
    "check": _check,
    "stripe": _stripe,
    "gingham": _gingham,
    "twill": _twill,
    "ring": _ring,
}


# -- bitmap font -------------------------------------------------------------------------------------------------------

GLYPH_HEIGHT = 5  # [units] of a glyph; most are 3 wide
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
    ".": ". . . . #",
    "%": "##..# ##.#. ..#.. .#.## #..##",
    "a": "... .## #.# #.# .##",
    "e": "... .#. #.# ##. .##",
    "f": ".## .#. ### .#. .#.",
    "m": "..... ##.#. #.#.# #.#.# #.#.#",
    "r": "... .## #.. #.. #..",
    "u": "... #.# #.# ### #..",
    " ": "... ... ... ... ...",
}


def text_width(text: str) -> int:
    """Return the width of a text [units]; glyphs are 1 unit apart."""
    return sum(glyph_width(letter) + 1 for letter in text) - 1


def glyph_width(letter: str) -> int:
    """Return the width of a glyph [units]. Raises KeyError for a character that is not in `GLYPHS`."""
    return GLYPHS[letter].index(" ")


def text_rectangles(text: str, left: float, top: float) -> NDArray[np.float64]:
    """Return a square of side 1 for every set pixel of the glyphs: rows of left, top, width, height [units], y down.

    Raises KeyError for a character that is not in `GLYPHS`.
    """
    found = []
    for letter in text:
        for row, cells in enumerate(GLYPHS[letter].split()):
            for column, cell in enumerate(cells):
                if cell == "#":
                    found.append((left + column, top + row, 1.0, 1.0))
        left += glyph_width(letter) + 1
    return np.array(found).reshape(-1, 4)


# -- color scales ------------------------------------------------------------------------------------------------------

UNIT = 1 / 216  # [image heights] a pixel of a glyph, before it is rounded to whole pixels of the image
STEPS = 40  # colors in the bar
BAR_WIDTH, BAR_HEIGHT, MARGIN = 5, 80, 8  # [units]
PADDING = 3  # [units] of the background around a scale
TEXT_COLOR = (0.22, 0.23, 0.25)
MAX_RECTANGLES = 500  # of a scale

Rectangles = NDArray[np.float64]


@dataclass(frozen=True)
class Scale:
    """A color scale: labels at fractions of its largest value, -1…1. It ends at the lowest and the highest label."""

    labels: dict[float, str]
    largest: float
    """The largest value: a strain, or a distance [m]."""
    caption: str = ""
    """Text above the bar, where charts do not cover it."""


STRAIN_SCALE = Scale(
    {f: f"{100 * f * FULL_STRAIN:+.0f}%" if f else "0%" for f in (-1.0, -0.5, 0.0, 0.5, 1.0)}, FULL_STRAIN
)


def distance_scale(largest: float, caption: str = "") -> Scale:
    """Return the scale of distances from 0 to `largest` [m]."""
    unit, name = (1e-3, "mm") if largest >= 1e-3 else (1e-6, "um")
    return Scale({f: f"{f * largest / unit:g}{name if f else ''}" for f in (0.0, 0.5, 1.0)}, largest, caption)


def rounded_up(value: float) -> float:
    """Return the least of 1, 1.5, 2, 3, 5 and 7 times a power of ten that is at least a positive `value`."""
    power = 10.0 ** floor(log10(value))
    return next(digit * power for digit in (1, 1.5, 2, 3, 5, 7, 10) if digit * power >= value * (1 - 1e-9))


def round_down_125(length: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above `length`."""
    power = 10.0 ** floor(log10(length))
    return float(max(k * power for k in (1, 2, 5) if k * power <= length))


def mean_spring_length(topology: Topology) -> float:
    """Return the mean rest length of the springs [m]; 0.1 m if there are none."""
    return float(topology.rest.mean()) if topology.spring_count else 0.1


MIN_MARKER_RADIUS = 0.008  # smallest radius of a marker, relative to the longer side of the cloth; used on fine grids


def marker_radius(topology: Topology) -> float:
    """Return the radius of the markers on grabbed particles and marked pins [m]."""
    return max(0.3 * mean_spring_length(topology), MIN_MARKER_RADIUS * topology.longest_side)


def unit_pixels(height: int) -> int:
    """Return the side of a pixel of a glyph in an image of `height` [pixels], as whole pixels: strokes of one width."""
    return max(1, round(UNIT * height))


def legend_rectangles(scale: Scale) -> tuple[Rectangles, Rectangles]:
    """Return the rectangles of a scale, as rows of left, top, width, height [units], and their colors, (N, 3).

    x grows to the right from the right edge of the image, y grows down from the middle of its height.
    """
    low, high = min(scale.labels), max(scale.labels)
    colors = np.zeros((STEPS, 3), np.float32)
    strain_colors(np.linspace(high * FULL_STRAIN, low * FULL_STRAIN, STEPS, dtype=np.float32), colors)
    left, step = -MARGIN - BAR_WIDTH, BAR_HEIGHT / STEPS
    tops = step * np.arange(STEPS) - BAR_HEIGHT / 2
    bar = [(left, top, BAR_WIDTH, step) for top in tops]
    ink = []
    for fraction, text in scale.labels.items():
        y = BAR_HEIGHT * (0.5 - (fraction - low) / (high - low))
        ink += [(left - 2, y - 0.5, 2, 1), *text_rectangles(text, left - 4 - text_width(text), y - GLYPH_HEIGHT / 2)]
    ink += [*text_rectangles(scale.caption, -MARGIN - text_width(scale.caption), -BAR_HEIGHT / 2 - 2 * GLYPH_HEIGHT)]
    return np.array([*bar, *ink]), np.concatenate([colors, np.tile(TEXT_COLOR, (len(ink), 1))])


def row_rectangles(scale: Scale) -> tuple[Rectangles, Rectangles]:
    """Return the rectangles of a scale that lies, as `legend_rectangles`: its lowest value at the left.

    x grows to the right from the middle of the image, y grows down from its lower edge.
    """
    low, high = min(scale.labels), max(scale.labels)
    colors = np.zeros((STEPS, 3), np.float32)
    strain_colors(np.linspace(low * FULL_STRAIN, high * FULL_STRAIN, STEPS, dtype=np.float32), colors)
    top, step = -MARGIN - GLYPH_HEIGHT - BAR_WIDTH, BAR_HEIGHT / STEPS
    bar = [(step * n - BAR_HEIGHT / 2, top, step, BAR_WIDTH) for n in range(STEPS)]
    ink = []
    for fraction, text in scale.labels.items():
        x = BAR_HEIGHT * ((fraction - low) / (high - low) - 0.5)
        ink += [
            (x - 0.5, top + BAR_WIDTH, 1, 2),
            *text_rectangles(text, x - text_width(text) / 2, 3 - MARGIN - GLYPH_HEIGHT),
        ]
    ink += [*text_rectangles(scale.caption, -text_width(scale.caption) / 2, top - 2 - GLYPH_HEIGHT)]
    return np.array([*bar, *ink]), np.concatenate([colors, np.tile(TEXT_COLOR, (len(ink), 1))])


def with_background(rectangles: Rectangles, colors: Rectangles) -> tuple[Rectangles, Rectangles]:
    """Return the rectangles of a scale and their colors with a white rectangle behind them, which comes first."""
    left, top = rectangles[:, :2].min(axis=0) - PADDING
    width, height = (rectangles[:, :2] + rectangles[:, 2:]).max(axis=0) + PADDING - (left, top)
    return np.insert(rectangles, 0, (left, top, width, height), 0), np.insert(colors, 0, 1.0, 0)


def draw_legend(image: Pixels, scale: Scale) -> Pixels:
    """Draw a scale into an image, uint8 (height, width, 3), at its right edge, and return the image."""
    height, width, _ = image.shape
    return _draw(image, *legend_rectangles(scale), width, height / 2)


def draw_legend_below(image: Pixels, scale: Scale) -> Pixels:
    """Draw a scale that lies in the middle of the lower edge, where there is seldom cloth, and return the image.

    It has a white background, since it covers the seam of two images.
    """
    height, width, _ = image.shape
    return _draw(image, *with_background(*row_rectangles(scale)), width / 2, height)


def _draw(image: Pixels, rectangles: Rectangles, colors: Rectangles, x: float, y: float) -> Pixels:
    """Draw rectangles [units] into an image, from its point (x, y) [pixels]."""
    unit = unit_pixels(len(image))
    for (left, top, w, h), color in zip(rectangles, colors, strict=True):
        # Halves are rounded up: `round`, which rounds them to even numbers, would make rows of a glyph unequal.
        start, end = (max(0, floor(x + unit * c + 0.5)) for c in (left, left + w))
        first, last = (max(0, floor(y + unit * c + 0.5)) for c in (top, top + h))
        image[first:last, start:end] = np.rint(255 * color)
    return image


class WindowLegend:
    """A color scale as triangles on the canvas of the window."""

    def __init__(self) -> None:
        corners = 6 * MAX_RECTANGLES
        self._position, self._color = ti.Vector.field(2, ti.f32, corners), ti.Vector.field(3, ti.f32, corners)
        self._laid_out_for: tuple[Scale, tuple[int, int], float] | None = None
        """Arguments of the last call of `show`."""

    def show(self, canvas: ti.ui.Canvas, scale: Scale, size: tuple[int, int], bottom: float = 0.0) -> None:
        """Draw a scale on a canvas of `size` [pixels], whose points run from (0, 0) at the bottom left to (1, 1).

        It is centered vertically, or moved up until it is entirely above `bottom`.
        """
        if (scale, size, bottom) != self._laid_out_for:
            self._laid_out_for = scale, size, bottom
            rectangles, colors = with_background(*legend_rectangles(scale))  # cloth may be behind it
            unit = unit_pixels(size[1])
            middle = max(0.5 * size[1], bottom * size[1] + unit * ((BAR_HEIGHT + GLYPH_HEIGHT) / 2 + PADDING))
            left, top, w, h = rectangles.T
            x, x_end = (1 + np.floor(unit * c + 0.5) / size[0] for c in (left, left + w))
            y, y_end = (np.floor(middle - unit * c + 0.5) / size[1] for c in (top, top + h))
            ends = [(x, y), (x_end, y), (x_end, y_end), (x, y), (x_end, y_end), (x, y_end)]
            points = np.stack([np.stack(corner, axis=-1) for corner in ends], axis=1).reshape(-1, 2)
            unused = 6 * MAX_RECTANGLES - len(points)  # they repeat the last corner: triangles without area
            self._position.from_numpy(np.pad(points, ((0, unused), (0, 0)), "edge").astype(np.float32))
            all_colors = np.repeat(colors, 6, axis=0)
            self._color.from_numpy(np.pad(all_colors, ((0, unused), (0, 0)), "edge").astype(np.float32))
        canvas.triangles(self._position, per_vertex_color=self._color)
