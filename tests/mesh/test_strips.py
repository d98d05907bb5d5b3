"""The grid in strips: what stands in which lane, and that a pass never meets a particle twice."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.mesh import strips
from taichi_cloth.mesh.grid import DIRECTIONS, springs
from taichi_cloth.mesh.strips import (
    A_ROW,
    ALONG,
    B_ROW,
    COLOUR,
    DIRECTION,
    DOWN,
    FIRST,
    INSIDE,
    LINK_MASK,
    LINK_SHIFT,
    OVER,
    ROW_MASK,
    ROW_SHIFT,
    STRIDE,
)


def test_pitch_holds_every_column_in_eight_strips() -> None:
    assert [strips.pitch(c) for c in (2, 30, 32, 33, 128, 129)] == [4, 4, 4, 8, 16, 20]
    assert [strips.pitch(c, 2) for c in (2, 16, 17, 65)] == [2, 2, 4, 10]


def test_strips_are_as_wide_as_the_longest_springs_ask_for() -> None:
    """Threads and diagonals reach to the next column, springs against bending to the one after it."""
    assert strips.reach(np.array([True, True, True, True, False, False])) == 1
    assert strips.reach(np.array([True, False, False, False, True, False])) == 2
    assert strips.reach(np.array([False, True, False, False, False, True])) == 1  # both straight down
    assert strips.reach(np.zeros(6, bool)) == 1


def test_column_c_stands_in_lane_c_over_pitch() -> None:
    packed = strips.pack(np.arange(30.0)[None], 4)
    assert packed.shape == (1, 4, 8)
    assert packed[0, 2, 3] == 3 * 4 + 2
    assert packed[0, 1, 7] == 29
    assert (packed[0, 2:, 7] == 0).all()


def visited(table: np.ndarray, rows: int, columns: int, pitch: int) -> list[list[tuple[int, int, int]]]:
    """The springs (direction, particle, particle) of each pass, in the order of `kernels/strips.py`."""
    found = []
    for p in table:
        of_pass = []
        for y in range(rows - p[DOWN]):
            if (y >> p[ROW_SHIFT]) & p[ROW_MASK] == p[COLOUR]:
                for n in range(p[INSIDE] + p[OVER]):
                    i = p[FIRST] + (n >> p[LINK_SHIFT]) * p[STRIDE] + (n & p[LINK_MASK])
                    assert (i + p[ALONG] < pitch) == (n < p[INSIDE])
                    for lane in range(8):
                        a, b = lane * pitch + i, lane * pitch + i + p[ALONG]
                        if b < columns:
                            of_pass.append(
                                (int(p[DIRECTION]), (y + p[A_ROW]) * columns + a, (y + p[B_ROW]) * columns + b)
                            )
        found.append(of_pass)
    return found


@given(st.integers(2, 9), st.integers(2, 40), st.booleans())
def test_coloured_passes_are_the_batches_of_the_list(rows: int, columns: int, bends: bool) -> None:
    used = np.array([True] * 4 + [bends] * 2)
    pitch = strips.pitch(columns, 2 * strips.reach(used))
    table = strips.passes(used, pitch)
    for p in table:  # a strip's last springs end at a copy of the next one's first slots: not at their own
        assert p[ALONG] < pitch
    passes = [p for p in visited(table, rows, columns, pitch) if p]
    batches = [
        {frozenset(map(int, pair)) for pair in batch}
        for (_, down, along), there in zip(DIRECTIONS, used, strict=True)
        for batch in springs(rows, columns, down, along)
        if there and len(batch)
    ]
    assert [{frozenset((a, b)) for _, a, b in p} for p in passes] == batches


def test_directions_that_are_not_used_have_no_pass() -> None:
    table = strips.passes(np.array([True, False, False, False, True, False]), 4)
    assert [p[DIRECTION] for p in table] == [0, 0, 4, 4]


@pytest.mark.parametrize(("rows", "kinds"), [(2, [1, 1, 0]), (3, [2, 1, 0]), (9, [2, 1, 0])])
def test_a_row_of_each_kind(rows: int, kinds: list[int]) -> None:
    assert strips.row_kinds(rows) == kinds
