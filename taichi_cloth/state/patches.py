"""Fields of the triangles of a cloth in coloured order, for what moves their corners (`contact/triangles.py`)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti

from ..mesh.topology import NO_GRID, Topology
from . import fields
from .pool import attached

COLOURS = 8  # of a grid's triangles: cells of odd and even row and column, and two in each


@dataclass(eq=False)
class Patches:
    """Triangles of one colour share no particle."""

    corners: Any  # ivec3 (T,)
    first: Any  # (COLOURS + 1,) first triangle of each colour, and the count of all


def patch(work: Any, topology: Topology) -> None:
    """Gives a cloth its `patches`, filled."""
    count = work.triangles.shape[0]
    found = attached(
        work,
        "patches",
        lambda: Patches(ti.Vector.field(3, ti.i32, count), fields.numbers(COLOURS + 1, kind=ti.i32)),
    )
    cells = topology.cells
    if topology.shape == NO_GRID:
        colour = np.zeros(len(cells), np.int64)  # one after the other: no path in parallel
    else:
        row, column = cells.T % 2
        second = np.zeros(len(cells), int)  # of its cell
        second[1:] = (cells[1:] == cells[:-1]).all(axis=1)
        colour = 4 * row + 2 * column + second
    order = np.argsort(colour, kind="stable")
    first = np.searchsorted(colour[order], np.arange(COLOURS + 1))
    fields.put_all((found.corners, topology.triangles[order]), (found.first, first))
