"""Edges through triangles, found with exact signs."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from taichi_cloth.geometry import intersections
from taichi_cloth.geometry.intersections import find_intersections

Floats = NDArray[np.float64]
TRIANGLE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]


def intersects(p: tuple[float, ...], q: tuple[float, ...], triangle: object = TRIANGLE) -> bool:
    found = find_intersections(np.array([*triangle, p, q]), np.array([[3, 4]]), np.array([[0, 1, 2]]))  # type: ignore[misc]
    assert found.shape[1] == 2
    return len(found) == 1


@pytest.mark.parametrize(
    ("p", "q", "expected"),
    [
        ((0.2, 0.2, -1.0), (0.2, 0.2, 1.0), True),
        ((0.2, 0.2, 0.1), (0.2, 0.2, 1.0), False),  # ends above it
        ((0.2, 0.2, 0.0), (0.2, 0.2, 1.0), False),  # touches it with an end
        ((0.5, 0.5, -1.0), (0.5, 0.5, 1.0), False),  # touches its edge
        ((0.5000001, 0.5, -1.0), (0.5, 0.5, 1.0), False),
        ((0.4999999, 0.5, -1.0), (0.4999999, 0.5, 1.0), True),
        ((0.8, 0.8, -1.0), (0.8, 0.8, 1.0), False),  # beside it
        ((-1.0, 0.2, 0.0), (2.0, 0.2, 0.0), False),  # in its plane
        ((0.2, 0.2, -1e-30), (0.2, 0.2, 1e-30), True),
    ],
)
def test_an_edge_and_a_triangle(p: tuple[float, ...], q: tuple[float, ...], expected: bool) -> None:
    assert intersects(p, q) is intersects(q, p) is expected


def test_an_edge_of_the_triangle_does_not_intersect_it() -> None:
    x = np.array([*TRIANGLE, (0.2, 0.2, 1.0)])
    assert len(find_intersections(x, np.array([[0, 3], [0, 1]]), np.array([[0, 1, 2]]))) == 0


def test_level_layers_in_one_plane_need_no_exact_arithmetic(monkeypatch: pytest.MonkeyPatch) -> None:
    """All products are exactly 0. In Python's fractions ten such layers took minutes."""
    monkeypatch.setattr(intersections, "_exact_orientation", None)
    rng = np.random.default_rng(0)
    x = rng.random((90, 3)) * [1.0, 0.0, 1.0] + [0.0, 0.37, 0.0]
    assert len(find_intersections(x, np.arange(90).reshape(-1, 2), np.arange(90).reshape(-1, 3))) == 0


def test_all_pairs_are_found_in_batches_of_any_size(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    x = rng.random((90, 3))
    triangles, edges = np.arange(90).reshape(-1, 3), np.arange(90).reshape(-1, 2)
    expected = {
        (e, t)
        for e in range(len(edges))
        for t in range(len(triangles))
        if len(find_intersections(x, edges[[e]], triangles[[t]]))
    }
    assert len(expected) > 20
    for size in (1, 7, 1 << 20):
        monkeypatch.setattr(intersections, "MAX_BATCH", size)
        found = [tuple(pair) for pair in find_intersections(x, edges, triangles).tolist()]
        assert len(found) == len(set(found))
        assert set(found) == expected


COORDINATE = st.integers(-8, 8).map(lambda k: k / 8) | st.floats(-1, 1, width=32)
POINTS: st.SearchStrategy[Floats] = st.lists(st.tuples(*[COORDINATE] * 3), min_size=4, max_size=4).map(np.array)


@given(POINTS, st.floats(0, 1), st.floats(0, 1))
def test_signs_are_exact_also_for_points_near_a_plane(points: Floats, u: float, v: float) -> None:
    a, b, c, d = points
    near = a + u * (b - a) + v * (c - a)
    for last in (d, near, np.nextafter(near, 2)):
        found = intersections._orientation(a[None], b[None], c[None], last[None])[0]
        rows = [
            [Fraction(float(p)) - Fraction(float(q)) for p, q in zip(point, last, strict=True)] for point in (a, b, c)
        ]
        exact = sum(
            sign * rows[0][i] * rows[1][j] * rows[2][k]
            for i, j, k, sign in ((0, 1, 2, 1), (1, 2, 0, 1), (2, 0, 1, 1), (0, 2, 1, -1), (1, 0, 2, -1), (2, 1, 0, -1))
        )
        assert found == (exact > 0) - (exact < 0)
