"""Rays against triangles, balls and boxes whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.interact.rays import ball_distance, box_distance, triangle_distances

DOWN = np.array([0.0, -1.0, 0.0])
A, B, C = (np.array([corner], np.float64) for corner in ((0, 0, 0), (2, 0, 0), (0, 0, 2)))


@pytest.mark.parametrize(
    ("origin", "distance"),
    [((0.5, 3, 0.5), 3), ((1.5, 3, 1.5), np.inf), ((-0.1, 3, 0.5), np.inf), ((0.5, -3, 0.5), np.inf)],
    ids=["inside", "beyond the long side", "beside", "behind the start"],
)
def test_a_known_triangle(origin: tuple[float, float, float], distance: float) -> None:
    assert triangle_distances(np.array(origin), DOWN, A, B, C) == pytest.approx([distance])
    assert triangle_distances(np.array(origin), DOWN, A, C, B) == pytest.approx([distance])  # from its back


def test_a_triangle_seen_edge_on_is_missed_without_a_warning() -> None:
    assert triangle_distances(np.array([-1.0, 0, 0.5]), np.array([1.0, 0, 0]), A, B, C)[0] == np.inf


@given(st.tuples(st.floats(0.05, 0.9), st.floats(0.05, 0.9)), st.integers(0, 2**32 - 1))
def test_a_ray_to_a_point_inside_a_triangle_meets_it_there(at: tuple[float, float], seed: int) -> None:
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


@pytest.mark.parametrize(
    ("origin", "distance"),
    [((0, 3, 0), 2), ((0.6, 3, 0), 2.2), ((1.1, 3, 0), np.inf), ((0, -3, 0), np.inf), ((0, 0.2, 0), np.inf)],
    ids=["through the middle", "off the middle", "beside", "behind", "from inside"],
)
def test_a_known_ball(origin: tuple[float, float, float], distance: float) -> None:
    assert ball_distance(np.array(origin), DOWN, np.zeros(3), 1.0) == pytest.approx(distance)


@pytest.mark.parametrize(
    ("origin", "distance"),
    [((0, 3, 0), 2.5), ((0.9, 3, 2.9), 2.5), ((1.1, 3, 0), np.inf), ((0, -3, 0), np.inf), ((1, 3, 0), 2.5)],
    ids=["through the middle", "near a corner", "beside", "behind", "in a face"],
)
def test_a_known_box(origin: tuple[float, float, float], distance: float) -> None:
    assert box_distance(np.array(origin), DOWN, np.zeros(3), np.array([2.0, 1.0, 6.0])) == pytest.approx(distance)


def test_a_box_from_aside() -> None:
    direction = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    size = np.full(3, 2.0)
    assert box_distance(np.array([-2.0, -2.0, 0]), direction, np.zeros(3), size) == pytest.approx(np.sqrt(2))
    assert box_distance(np.array([-4.0, -1.5, 0]), direction, np.zeros(3), size) == np.inf
