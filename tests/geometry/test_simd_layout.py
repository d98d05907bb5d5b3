"""The SIMD layout of a grid: the columns of each lane, and passes in which no particle occurs twice."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.geometry import simd_layout
from taichi_cloth.geometry.grid import DIRECTIONS, springs
from taichi_cloth.geometry.simd_layout import (
    A_ROW,
    ALONG,
    B_ROW,
    BORDER_COUNT,
    COLOR,
    DIRECTION,
    DOWN,
    FIRST,
    INNER_COUNT,
    LINK_MASK,
    LINK_SHIFT,
    ROW_MASK,
    ROW_SHIFT,
    STRIDE,
)


def test_eight_lanes_hold_all_columns() -> None:
    assert [simd_layout.row_stride(c) for c in (2, 30, 32, 33, 128, 129)] == [4, 4, 4, 8, 16, 20]
    assert [simd_layout.row_stride(c, 2) for c in (2, 16, 17, 65)] == [2, 2, 4, 10]


def test_column_reach_is_that_of_the_longest_springs() -> None:
    """Structural and shear springs reach to the next column, bend springs to the one after it."""
    assert simd_layout.column_reach(np.array([True, True, True, True, False, False])) == 1
    assert simd_layout.column_reach(np.array([True, False, False, False, True, False])) == 2
    assert simd_layout.column_reach(np.array([False, True, False, False, False, True])) == 1  # both along columns
    assert simd_layout.column_reach(np.zeros(6, bool)) == 1


def test_column_c_is_in_lane_c_divided_by_the_row_stride() -> None:
    packed = simd_layout.pack(np.arange(30.0)[None], 4)
    assert packed.shape == (1, 4, 8)
    assert packed[0, 2, 3] == 3 * 4 + 2
    assert packed[0, 1, 7] == 29
    assert (packed[0, 2:, 7] == 0).all()


def visited(table: np.ndarray, rows: int, columns: int, stride: int) -> list[list[tuple[int, int, int]]]:
    """Return the springs (direction, particle, particle) of each pass, in the order of `kernels/simd_sweep.py`."""
    found = []
    for p in table:
        of_pass = []
        for y in range(rows - p[DOWN]):
            if (y >> p[ROW_SHIFT]) & p[ROW_MASK] == p[COLOR]:
                for n in range(p[INNER_COUNT] + p[BORDER_COUNT]):
                    i = p[FIRST] + (n >> p[LINK_SHIFT]) * p[STRIDE] + (n & p[LINK_MASK])
                    assert (i + p[ALONG] < stride) == (n < p[INNER_COUNT])
                    for lane in range(8):
                        a, b = lane * stride + i, lane * stride + i + p[ALONG]
                        if b < columns:
                            of_pass.append(
                                (int(p[DIRECTION]), (y + p[A_ROW]) * columns + a, (y + p[B_ROW]) * columns + b)
                            )
        found.append(of_pass)
    return found


@given(st.integers(2, 9), st.integers(2, 40), st.booleans())
def test_color_passes_are_the_batches_of_the_serial_layout(rows: int, columns: int, bends: bool) -> None:
    used = np.array([True] * 4 + [bends] * 2)
    stride = simd_layout.row_stride(columns, 2 * simd_layout.column_reach(used))
    table = simd_layout.color_passes(used, stride)
    for p in table:  # the last springs of a lane end at a copy of the first columns of the next lane, not of their own
        assert p[ALONG] < stride
    passes = [p for p in visited(table, rows, columns, stride) if p]
    batches = [
        {frozenset(map(int, pair)) for pair in batch}
        for (_, down, along), is_used in zip(DIRECTIONS, used, strict=True)
        for batch in springs(rows, columns, down, along)
        if is_used and len(batch)
    ]
    assert [{frozenset((a, b)) for _, a, b in p} for p in passes] == batches


def test_unused_directions_have_no_pass() -> None:
    table = simd_layout.color_passes(np.array([True, False, False, False, True, False]), 4)
    assert [p[DIRECTION] for p in table] == [0, 0, 4, 4]


@pytest.mark.parametrize(("rows", "classes"), [(2, [1, 1, 0]), (3, [2, 1, 0]), (9, [2, 1, 0])])
def test_there_is_one_row_of_each_class(rows: int, classes: list[int]) -> None:
    assert simd_layout.row_classes(rows) == classes
