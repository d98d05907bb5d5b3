"""Colours of a cloth by its pattern, at the corners of its triangles: there are no textures. NumPy only."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..mesh.topology import NO_GRID, Topology
from ..scene.model import Look

Shares = NDArray[np.float64]  # at each corner, (T, 3): 0 the first colour, 1 the second
Places = NDArray[np.signedinteger[Any]]

BLEACHED = 0.55  # share of the second colour where only one thread of a gingham is dyed
WALE = 0.5  # the same in the valleys of a twill


def pattern_colours(topology: Topology, look: Look) -> NDArray[np.float32]:
    """Colour of every corner, (3·T, 3), as factors 0…1 without light."""
    if topology.shape == NO_GRID:  # rings around its middle
        rows, columns = (np.repeat(of_cells[:, None], 3, axis=1) for of_cells in topology.cells.T)
    else:
        rows, columns = np.divmod(topology.triangles, topology.shape[1])
    share = PATTERNS[look.pattern](topology.cells, rows, columns, look.check_cells)
    first, second = np.array(rgb(look.cloth)), np.array(rgb(look.check))
    colours: NDArray[np.float32] = (first + share.reshape(-1, 1) * (second - first)).astype(np.float32)
    return colours


def rgb(colour: str) -> tuple[float, float, float]:
    """#rrggbb as three factors 0…1."""
    red, green, blue = (int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return red, green, blue


# Each: cells (T, 2), rows and columns of the corners (T, 3), cells to a repeat → shares (T, 3).


def _plain(cells: Places, rows: Places, columns: Places, n: int) -> Shares:
    return np.zeros(rows.shape)


def _check(cells: Places, rows: Places, columns: Places, n: int) -> Shares:
    return _flat((cells // n).sum(axis=1) % 2)


def _stripe(cells: Places, rows: Places, columns: Places, n: int) -> Shares:
    """Down the columns."""
    return _flat(cells[:, 1] // n % 2)


def _gingham(cells: Places, rows: Places, columns: Places, n: int) -> Shares:
    """Dyed and undyed threads both ways: where one of the two is undyed the colour is between."""
    return _flat(np.array([0.0, BLEACHED, 1.0])[(cells // n % 2).sum(axis=1)])


def _twill(cells: Places, rows: Places, columns: Places, n: int) -> Shares:
    """Diagonal ridges, 2·n cells apart."""
    share: Shares = WALE * np.abs((rows + columns) % (2 * n) - n) / n
    return share


def _ring(cells: Places, rows: Places, columns: Places, n: int) -> Shares:
    """A bright spot at every second particle each way."""
    share: Shares = ((rows % 2 == 0) & (columns % 2 == 0)).astype(float)
    return share


def _flat(share: NDArray[Any]) -> Shares:
    """The same on all corners of a triangle."""
    return np.repeat(np.asarray(share, float)[:, None], 3, axis=1)


PATTERNS: dict[str, Callable[[Places, Places, Places, int], Shares]] = {
    "plain": _plain,
    "check": _check,
    "stripe": _stripe,
    "gingham": _gingham,
    "twill": _twill,
    "ring": _ring,
}
