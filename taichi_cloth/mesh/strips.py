"""A grid cut into eight vertical strips that are worked on side by side, as arrays. NumPy only.

Column `strip·pitch + i` of a row stands in lane `strip` of the row's slot `i`, so that one SIMD instruction
treats eight particles of eight strips, and a neighbour in the same strip is some slots away. The second end
of a spring that leaves its strip stands in the next lane. Columns that fill up the last strip are empty.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .grid import DIRECTIONS

STRIPS = 8

# The springs that begin in a row differ from row to row in three ways only: where diagonals alternate, rows of even
# and odd number; and the first and the last row, whose own springs run along an edge.
EVEN_ROW, ODD_ROW, EDGE_ROW, ROW_KINDS = range(4)

# A spring begins at its left end, or at its upper: the steps down and along to the other. None is longer than REACH.
ONWARD = tuple((down, along) if along >= 0 else (-down, -along) for _, down, along in DIRECTIONS)
REACH = 2

# Columns of a pass: the springs of one direction and one colour, as a loop over rows and slots. (A division by a
# variable takes longer than a spring: so shifts and masks.) Row y belongs to the pass if (y >> ROW_SHIFT) & ROW_MASK is
# its colour. Within a row, spring n begins in slot FIRST + (n >> LINK_SHIFT)·STRIDE + (n & LINK_MASK); first come
# those INSIDE their strip, then those OVER its border.
PASS_COLUMNS = 14
DIRECTION, DOWN, A_ROW, B_ROW, ALONG, COLOUR, ROW_SHIFT, ROW_MASK = range(8)
FIRST, STRIDE, LINK_SHIFT, LINK_MASK, INSIDE, OVER = range(8, 14)


def reach(directions: NDArray[np.bool_]) -> int:
    """How many columns a spring of the directions in use spans at most."""
    return max([1, *(abs(along) for (_, _, along), used in zip(DIRECTIONS, directions, strict=True) if used)])


def pitch(columns: int, multiple: int = 2 * REACH) -> int:
    """Slots of a row. A multiple of twice the longest reach lets every strip begin with the same colour in all
    directions, and keeps both ends of a spring in different slots: where a strip ends, one is worked on in a copy.
    """
    return -(-columns // (STRIPS * multiple)) * multiple


def pack(values: NDArray[Any], pitch: int) -> NDArray[Any]:
    """(…, rows, columns) → (…, rows, pitch, 8): zero in empty columns."""
    padded = np.zeros((*values.shape[:-1], STRIPS * pitch), values.dtype)
    padded[..., : values.shape[-1]] = values
    strips: NDArray[Any] = padded.reshape(*values.shape[:-1], STRIPS, pitch).swapaxes(-1, -2)
    return strips


def row_kinds(rows: int) -> list[int]:
    """For each kind of row, the number of one that is of this kind (a grid of two or three rows lacks some)."""
    return [min(2, rows - 1), 1, 0]


def passes(directions: NDArray[np.bool_], pitch: int) -> NDArray[np.int32]:
    """The sweep over the directions in use, shape (passes, PASS_COLUMNS).

    Each direction is two passes whose springs share no particle, in the order of `grid.springs`.
    """
    table = []
    for direction, (_, down, along) in enumerate(DIRECTIONS):
        if not directions[direction]:
            continue
        for colour in (0, 1):
            row = np.zeros(PASS_COLUMNS, np.int32)
            row[DIRECTION], row[DOWN], row[ALONG] = direction, down, abs(along)
            row[A_ROW if along < 0 else B_ROW] = down
            starts = np.arange(pitch)
            row[LINK_SHIFT], row[LINK_MASK] = 31, -1
            if down:  # the colour changes from chain link to chain link, down the rows …
                row[ROW_SHIFT], row[ROW_MASK], row[COLOUR] = down - 1, 1, colour
            else:  # … or along the row
                starts = starts[starts // along % 2 == colour]
                row[FIRST], row[STRIDE] = colour * along, 2 * along
                row[LINK_SHIFT], row[LINK_MASK] = along - 1, along - 1
            row[INSIDE] = (starts + abs(along) < pitch).sum()
            row[OVER] = len(starts) - row[INSIDE]
            table.append(row)
    return np.array(table, np.int32).reshape(-1, PASS_COLUMNS)
