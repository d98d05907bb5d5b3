"""The SIMD layout of a grid (AoSoA), and the springs of a grid as lines. NumPy only.

The grid is cut into eight vertical strips of `row_stride` columns. Column `strip·row_stride + i` of a row is in lane
`strip` of packet i of that row. So one SIMD instruction processes eight particles, one from each strip, and a neighbor
in the same strip is a fixed number of packets away. The second end of a spring that crosses the border of its strip is
in the next lane. Columns that pad the last strip are empty.

A line is a row, column or diagonal of springs, each of which begins where the previous one ends.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .grid import DIRECTIONS
from .topology import Topology

Scalar = TypeVar("Scalar", bound=np.generic)
LANES = 8  # particles per packet

# Row classes: rows of one class have springs of the same stiffness. Even and odd rows differ if diagonals alternate.
# The springs of the first and last row lie on an edge of the sheet. ROW_CLASSES is the number of classes.
EVEN_ROW, ODD_ROW, EDGE_ROW, ROW_CLASSES = range(4)

# Steps down and along from the first end of a spring to the second, by direction. The first end is the left one, or the
# upper one of a vertical spring. No step is longer than MAX_REACH.
FORWARD_STEPS = tuple((down, along) if along >= 0 else (-down, -along) for _, down, along in DIRECTIONS)
MAX_REACH = 2

# Columns of the table of color passes. A pass is a loop over rows and packets: the springs of one direction and color.
#   DIRECTION: index in `grid.DIRECTIONS`
#   DOWN, ALONG: rows and columns between both ends of a spring
#   A_ROW, B_ROW: row of the first and of the second end, relative to row y of the loop
#   COLOR, ROW_SHIFT, ROW_MASK: row y belongs to the pass if (y >> ROW_SHIFT) & ROW_MASK == COLOR
#   FIRST, STRIDE, LINK_SHIFT, LINK_MASK: spring n of a row begins in packet
#       FIRST + (n >> LINK_SHIFT)·STRIDE + (n & LINK_MASK)
#   INNER_COUNT: springs of a row that stay within their strip; they come first
#   BORDER_COUNT: springs of a row that cross the border of their strip
# Shifts and masks, because a division by a variable takes longer than solving a spring.
PASS_COLUMNS = 14
DIRECTION, DOWN, A_ROW, B_ROW, ALONG, COLOR, ROW_SHIFT, ROW_MASK = range(8)
FIRST, STRIDE, LINK_SHIFT, LINK_MASK, INNER_COUNT, BORDER_COUNT = range(8, 14)


def column_reach(directions: NDArray[np.bool_]) -> int:
    """Return the largest number of columns that a spring of the used directions spans, at least 1."""
    return max([1, *(abs(along) for (_, _, along), used in zip(DIRECTIONS, directions, strict=True) if used)])


def row_stride(columns: int, multiple: int = 2 * MAX_REACH) -> int:
    """Return the number of packets per row, a multiple of `multiple`.

    A multiple of twice the longest reach makes every strip begin with the same color in all directions. It also puts
    both ends of a spring in different packets: where a strip ends, the second end is processed in a copy.
    """
    return -(-columns // (LANES * multiple)) * multiple


def pack(values: NDArray[Scalar], row_stride: int) -> NDArray[Scalar]:
    """Arrange values (…, rows, columns) as packets (…, rows, row_stride, 8); zero in empty columns."""
    padded = np.zeros((*values.shape[:-1], LANES * row_stride), values.dtype)
    padded[..., : values.shape[-1]] = values
    packed: NDArray[Scalar] = padded.reshape(*values.shape[:-1], LANES, row_stride).swapaxes(-1, -2)
    return packed


def row_classes(rows: int) -> list[int]:
    """Return the number of a row of each class. (A grid of two or three rows does not have all classes.)"""
    return [min(2, rows - 1), 1, 0]


def color_passes(directions: NDArray[np.bool_], row_stride: int) -> NDArray[np.int32]:
    """Return the table of color passes of a sweep over the used directions, (passes, PASS_COLUMNS).

    Each direction has two passes. Springs of one pass share no particle. The order is that of `grid.springs`.
    """
    table = []
    for direction, (_, down, along) in enumerate(DIRECTIONS):
        if not directions[direction]:
            continue
        for color in (0, 1):
            entry = np.zeros(PASS_COLUMNS, np.int32)
            entry[DIRECTION], entry[DOWN], entry[ALONG] = direction, down, abs(along)
            entry[A_ROW if along < 0 else B_ROW] = down
            starts = np.arange(row_stride)
            entry[LINK_SHIFT], entry[LINK_MASK] = 31, -1
            if down:  # colors alternate from spring to spring of a line: down the rows …
                entry[ROW_SHIFT], entry[ROW_MASK], entry[COLOR] = down - 1, 1, color
            else:  # … or along the row
                starts = starts[starts // along % 2 == color]
                entry[FIRST], entry[STRIDE] = color * along, 2 * along
                entry[LINK_SHIFT], entry[LINK_MASK] = along - 1, along - 1
            entry[INNER_COUNT] = (starts + abs(along) < row_stride).sum()
            entry[BORDER_COUNT] = len(starts) - entry[INNER_COUNT]
            table.append(entry)
    return np.array(table, np.int32).reshape(-1, PASS_COLUMNS)


# -- lines of springs --------------------------------------------------------------------------------------------------

# Directions with lines: all but the bend springs. They are the first of `grid.DIRECTIONS`.
LINE_DIRECTIONS = tuple(d for d, (family, _, _) in enumerate(DIRECTIONS) if family != "bend")

# Columns of the table of lines.
#   PARTICLE: first particle
#   LINE_STRIDE: index difference between consecutive particles
#   LINE_FIRST: first spring, in the order of the lines
#   COUNT: number of springs
PARTICLE, LINE_STRIDE, LINE_FIRST, COUNT, LINE_COLUMNS = range(5)

# Eight lines are solved at once, each from row to row of a SIMD layout. Lines along the rows of the grid use a
# transposed layout of their own, all others the layout of the grid (`state/solver_data.py`).
# Columns of the table of these two layouts, the transposed one first.
#   ROWS, ROW_STRIDE: number of rows, and of packets per row
#   MASS_FIRST, LINK_FIRST: where its masses and its links begin
#   START, END: first direction in the table of directions, and one after the last
ROWS, ROW_STRIDE, MASS_FIRST, LINK_FIRST, START, END, LAYOUT_COLUMNS = range(7)

# Columns of the table of directions.
#   COLUMN_STEP: columns from one row to the next
#   SPRING_FIRST: where its springs begin
#   CLASS_FIRST: where the stiffnesses of its row classes begin
COLUMN_STEP, SPRING_FIRST, CLASS_FIRST, DIRECTION_COLUMNS = range(4)


def spring_lines(topology: Topology) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the table of lines, (lines, LINE_COLUMNS), and the indices of their springs in order of the lines.

    Lines are sorted by direction. A missing spring ends a line.
    """
    columns, direction = topology.shape[1], topology.direction
    table: list[NDArray[np.int32]] = []
    order: list[NDArray[np.int64]] = []
    first = 0
    for d in LINE_DIRECTIONS:
        _, down, along = DIRECTIONS[d]
        stride = down * columns + along
        springs = np.flatnonzero(direction == d)
        begin = topology.ends[springs].min(axis=1)
        row, column = np.divmod(begin, columns)
        line = row * along - column * down  # constant along a line
        line_order = np.lexsort((begin, line))
        springs, begin, line = springs[line_order], begin[line_order], line[line_order]
        breaks = np.ones(len(springs), bool)
        breaks[1:] = (begin[1:] != begin[:-1] + stride) | (line[1:] != line[:-1])
        starts = np.flatnonzero(breaks)
        lines = np.zeros((len(starts), LINE_COLUMNS), np.int32)
        lines[:, PARTICLE], lines[:, LINE_STRIDE], lines[:, LINE_FIRST] = begin[starts], stride, first + starts
        lines[:, COUNT] = np.diff(np.append(starts, len(springs)))
        table.append(lines)
        order.append(springs)
        first += len(springs)
    return np.concatenate(table), np.concatenate(order).astype(np.int32)
