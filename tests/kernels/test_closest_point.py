"""Closest points, against a fine search and values computed by hand."""

import numpy as np
import pytest
import taichi as ti
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from taichi_cloth.kernels.constraint_math import closest_between_segments, closest_on_triangle

pytestmark = pytest.mark.bounds

Floats = NDArray[np.float64]
CORNER = st.tuples(*[st.floats(-1, 1, width=32)] * 3)
POINTS: st.SearchStrategy[Floats] = st.lists(CORNER, min_size=4, max_size=4).map(np.array)


@ti.kernel
def on_triangle(p: ti.math.vec3, a: ti.math.vec3, b: ti.math.vec3, c: ti.math.vec3) -> ti.math.vec3:
    return closest_on_triangle(p, a, b, c)


@ti.kernel
def of_segments(a: ti.math.vec3, b: ti.math.vec3, c: ti.math.vec3, d: ti.math.vec3) -> ti.math.vec2:
    s, t = closest_between_segments(a, b, c, d)
    return ti.math.vec2(s, t)


def vectors(points: Floats) -> list[ti.Vector]:
    return [ti.Vector(list(map(float, point))) for point in points]


def triangle_weights(points: Floats) -> Floats:
    """Return the weights of points[1:] at the point of their triangle closest to points[0]."""
    return np.array(on_triangle(*vectors(points)))


def segment_shares(points: Floats) -> Floats:
    return np.array(of_segments(*vectors(points)))


@pytest.mark.parametrize(
    ("p", "weights"),
    [
        ((0.25, 0.25, 0.3), (0.5, 0.25, 0.25)),  # above the interior
        ((-1.0, -1.0, 0.2), (1.0, 0.0, 0.0)),  # beyond a corner
        ((0.5, -1.0, 0.0), (0.5, 0.5, 0.0)),  # beyond an edge
        ((1.0, 1.0, 0.0), (0.0, 0.5, 0.5)),  # beyond the long edge
    ],
)
def test_closest_point_on_a_right_triangle(p: tuple[float, ...], weights: tuple[float, ...]) -> None:
    assert triangle_weights(np.array([p, (0, 0, 0), (1, 0, 0), (0, 1, 0)])) == pytest.approx(
        np.array(weights), abs=1e-6
    )


GRID = np.array([(1 - u - v, u, v) for u in np.linspace(0, 1, 41) for v in np.linspace(0, 1, 41) if u + v <= 1 + 1e-9])


@settings(max_examples=150)
@given(POINTS)
def test_no_point_of_a_triangle_is_closer(points: Floats) -> None:
    weights = triangle_weights(points)
    assert weights.sum() == pytest.approx(1.0, abs=1e-5)
    assert weights.min() >= -1e-6
    found = np.linalg.norm(weights @ points[1:] - points[0])
    best = np.linalg.norm(GRID @ points[1:] - points[0], axis=1).min()
    assert found <= best + 2e-3  # slivers: an area of 1e-9 of that of its sides counts as zero


@settings(max_examples=150)
@given(POINTS)
def test_no_points_of_two_segments_are_closer(points: Floats) -> None:
    s, t = segment_shares(points)
    assert 0 <= min(s, t) <= max(s, t) <= 1
    a, b, c, d = points
    along = np.linspace(0, 1, 61)[:, None]
    first, second = a + (b - a) * along, c + (d - c) * along
    best = np.linalg.norm(first[:, None] - second[None], axis=2).min()
    assert np.linalg.norm(a + (b - a) * s - c - (d - c) * t) <= best + 2e-3


def test_closest_points_of_parallel_and_degenerate_segments() -> None:
    a, b = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)
    assert segment_shares(np.array([a, b, (0, 1, 0), (1, 1, 0)])) == pytest.approx([0.5, 0.5])
    s, t = segment_shares(np.array([a, b, (2, 1, 0), (3, 1, 0)]))
    assert (s, t) == (1.0, 0.0)
    assert segment_shares(np.array([a, a, (2, 1, 0), (2, 1, 0)])) == pytest.approx([0.5, 0.0])
