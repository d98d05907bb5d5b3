"""Distances along rays to triangles, against known values."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.viewer.dragging import triangle_distances

DOWN = np.array([0.0, -1.0, 0.0])
A, B, C = (np.array([corner], np.float64) for corner in ((0, 0, 0), (2, 0, 0), (0, 0, 2)))


@pytest.mark.parametrize(
    ("origin", "distance"),
    [((0.5, 3, 0.5), 3), ((1.5, 3, 1.5), np.inf), ((-0.1, 3, 0.5), np.inf), ((0.5, -3, 0.5), np.inf)],
    ids=["inside", "beyond the hypotenuse", "beside", "behind the origin"],
)
def test_distances_to_a_known_triangle(origin: tuple[float, float, float], distance: float) -> None:
    assert triangle_distances(np.array(origin), DOWN, A, B, C) == pytest.approx([distance])
    assert triangle_distances(np.array(origin), DOWN, A, C, B) == pytest.approx([distance])  # from the back


def test_a_ray_in_the_plane_of_a_triangle_misses_it_without_a_warning() -> None:
    assert triangle_distances(np.array([-1.0, 0, 0.5]), np.array([1.0, 0, 0]), A, B, C)[0] == np.inf


@given(st.tuples(st.floats(0.05, 0.9), st.floats(0.05, 0.9)), st.integers(0, 2**32 - 1))
def test_a_ray_to_a_point_inside_a_triangle_hits_that_point(at: tuple[float, float], seed: int) -> None:
    random = np.random.default_rng(seed)
    a, b, c, origin = random.normal(size=(4, 3))
    beta, gamma = at[0] * (1 - at[1]), at[1] * (1 - at[0]) * 0.5
    point = a + beta * (b - a) + gamma * (c - a)
    sight = point - origin
    distance = float(np.linalg.norm(sight))
    if abs(np.dot(np.cross(b - a, c - a), sight)) < 1e-3:
        return  # nearly edge-on
    found = triangle_distances(origin, sight / distance, a[None], b[None], c[None])
    assert found == pytest.approx([distance], rel=1e-6)
