"""Colors of the cloth by its pattern, at the corners of the triangles; there are no textures. NumPy only."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.topology import NO_GRID, Topology
from ..scene.schema import Look

Fractions = NDArray[np.float64]  # fraction of the second color at each corner, (T, 3), 0…1
Indices = NDArray[np.signedinteger[Any]]  # integer grid indices

HALF_DYED_FRACTION = 0.55  # fraction of the second color where only one of two crossing yarns of a gingham is dyed
TWILL_VALLEY_FRACTION = 0.5  # fraction of the second color in the valleys of a twill


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
