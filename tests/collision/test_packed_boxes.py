"""Packed moving boxes, against the same comparison in NumPy."""

import numpy as np
import pytest
import taichi as ti
import taichi.math as tm
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from taichi_cloth.collision.pair_geometry import STEP, are_apart, box_around, pack_box
from taichi_cloth.kernels.tensor_fields import f32_matrix

pytestmark = pytest.mark.bounds

Floats = NDArray[np.float32]


@ti.func
def corner(rows: ti.template(), k: int):
    return tm.vec3(rows[k, 0], rows[k, 1], rows[k, 2])


@ti.kernel
def apart(a: f32_matrix, b: f32_matrix) -> int:
    """Return whether two boxes, of four corners each, stay apart; and whether one and the box around both do: 2."""
    p = pack_box(corner(a, 0), corner(a, 1), corner(a, 2), corner(a, 3))
    q = pack_box(corner(b, 0), corner(b, 1), corner(b, 2), corner(b, 3))
    around = box_around(p, q)
    return (
        are_apart(p, q)
        + 2 * ti.max(are_apart(around, p), are_apart(around, q))
        + 4 * (are_apart(p, q) - are_apart(q, p))
    )


NUMBER = st.floats(-20, 20, width=32) | st.integers(-40, 40).map(lambda k: k * STEP / 2)
BOX: st.SearchStrategy[Floats] = st.lists(st.tuples(*[NUMBER] * 3), min_size=4, max_size=4).map(
    lambda rows: np.concatenate([np.sort(rows[:2], axis=0), np.sort(rows[2:], axis=0)]).astype(np.float32)
)


def margin(a: Floats, b: Floats) -> float:
    """Return by how much two moving boxes are apart along the best axis [m]; negative if they meet."""
    below = np.minimum(a[0] - b[1], a[2] - b[3])
    above = np.minimum(b[0] - a[1], b[2] - a[3])
    return float(np.maximum(below, above).max())


@given(BOX, BOX)
def test_boxes_that_meet_are_never_apart(a: Floats, b: Floats) -> None:
    found = apart(a, b)
    assert found in (0, 1)  # symmetric, and the box around both is apart from none
    gap = margin(a, b)
    if gap <= 0:
        assert found == 0
    if gap > 2.01 * STEP:  # both are rounded outward
        assert found == 1


def test_beyond_the_range_boxes_meet_rather_than_be_apart() -> None:
    far = np.array([[100.0, 0, 0], [101.0, 1, 1]] * 2, np.float32)
    assert apart(far, far + np.float32([10, 0, 0])) == 0
    assert apart(far, far + np.float32([10, 3, 0])) == 1
    assert apart(far, far - np.float32([200, 0, 0])) == 1
