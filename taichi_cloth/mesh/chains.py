"""The rows, columns and diagonals of springs as chains: each spring begins where the one before it ends. NumPy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .grid import DIRECTIONS
from .topology import Topology

CHAINED = tuple(d for d, (family, _, _) in enumerate(DIRECTIONS) if family != "bend")  # the first in `DIRECTIONS`

# Columns of the table of chains.
PARTICLE, STRIDE, FIRST, COUNT, CHAIN_COLUMNS = range(5)

# Eight chains at once stand in strips where each goes from row to row: the chains of the grid's rows in strips of rows,
# all others in the grid's own (`state/chains.py`). Columns of the table of these two layouts, the rows' first: shape;
# where their masses and links begin; and their first and last direction in the table of directions.
ROWS, PITCH, MASSES, LINKS, START, END, LAYOUT_COLUMNS = range(7)

# Columns of the table of directions: step along the columns from row to row, and where its springs and the stiffness
# of its kinds of row begin.
ALONG, SPRINGS, KINDS, DIRECTION_COLUMNS = range(4)


def chains(topology: Topology) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Every chain (first particle, stride to the next, first place in the order, springs), and the springs in order.

    Direction after direction; a missing spring ends a chain.
    """
    columns, direction = topology.shape[1], topology.direction
    table: list[NDArray[np.int32]] = []
    order: list[NDArray[np.int64]] = []
    first = 0
    for d in CHAINED:
        _, down, along = DIRECTIONS[d]
        stride = down * columns + along
        springs = np.flatnonzero(direction == d)
        begin = topology.ends[springs].min(axis=1)
        row, column = np.divmod(begin, columns)
        line = row * along - column * down  # the same all along a chain
        sort = np.lexsort((begin, line))
        springs, begin, line = springs[sort], begin[sort], line[sort]
        breaks = np.ones(len(springs), bool)
        breaks[1:] = (begin[1:] != begin[:-1] + stride) | (line[1:] != line[:-1])
        starts = np.flatnonzero(breaks)
        rows = np.zeros((len(starts), CHAIN_COLUMNS), np.int32)
        rows[:, PARTICLE], rows[:, STRIDE], rows[:, FIRST] = begin[starts], stride, first + starts
        rows[:, COUNT] = np.diff(np.append(starts, len(springs)))
        table.append(rows)
        order.append(springs)
        first += len(springs)
    return np.concatenate(table), np.concatenate(order).astype(np.int32)
