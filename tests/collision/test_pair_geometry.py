"""Nearest points and separating directions of a particle and a triangle, and of two edges."""

from typing import NamedTuple

import numpy as np
import pytest
import taichi as ti
import taichi.math as tm
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from taichi_cloth.collision.pair_geometry import (
    EDGE_EDGE,
    VERTEX_TRIANGLE,
    nearest_weights,
    separating_direction,
    separation,
)
from taichi_cloth.kernels.tensor_fields import f32_matrix

pytestmark = pytest.mark.bounds

Floats = NDArray[np.float64]


@ti.func
def row(points: ti.template(), k: int):
    return tm.vec3(points[k, 0], points[k, 1], points[k, 2])


@ti.kernel
def weights_of(kind: int, points: f32_matrix) -> tm.vec4:
    return nearest_weights(kind, row(points, 0), row(points, 1), row(points, 2), row(points, 3))


def nearest(kind: int, points: Floats) -> tuple[Floats, float]:
    """Return the weights of the corners, and the distance."""
    found = np.array(weights_of(kind, points.astype(np.float32)))
    return found, float(np.linalg.norm(found @ points.astype(np.float32)))


def distance(kind: int, points: Floats, steps: int = 40) -> float:
    """Return the distance of the parts by a search, to within the length of a side over `steps`."""
    s = np.linspace(0, 1, steps + 1)
    if kind == EDGE_EDGE:
        a = points[0] + s[:, None] * (points[1] - points[0])
        b = points[2] + s[:, None] * (points[3] - points[2])
    else:
        u, v = np.meshgrid(s, s)
        inside = u + v <= 1 + 1e-9
        u, v = u[inside][:, None], v[inside][:, None]
        a, b = points[:1], points[1] + u * (points[2] - points[1]) + v * (points[3] - points[1])
    return float(np.linalg.norm(a[:, None] - b[None], axis=2).min())


CORNER = st.tuples(*[st.floats(-1, 1, width=32) | st.integers(-2, 2).map(lambda k: k / 2)] * 3)
POINTS: st.SearchStrategy[Floats] = st.lists(CORNER, min_size=4, max_size=4).map(np.array)
KINDS = st.sampled_from([VERTEX_TRIANGLE, EDGE_EDGE])


@given(KINDS, POINTS)
def test_the_nearest_points_are_on_the_parts_and_nearest(kind: int, points: Floats) -> None:
    weights, found = nearest(kind, points)
    in_a = 2 if kind == EDGE_EDGE else 1
    assert weights[:in_a].sum() == pytest.approx(1.0, abs=1e-5)
    assert weights[in_a:].sum() == pytest.approx(-1.0, abs=1e-5)
    assert (weights[:in_a] >= -1e-6).all()
    assert (weights[in_a:] <= 1e-6).all()
    assert found <= distance(kind, points) + 1e-4


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([(0, 0, 0), (1, 0, 0), (0.5, -1, 1), (0.5, 1, 1)], (0.5, 0.5, -0.5, -0.5)),  # crossing above each other
        ([(0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0)], (0, 1, -1, 0)),  # one behind the other
        ([(0, 0, 0), (1, 0, 0), (0, 1, 0), (-1, 2, 0)], (1, 0, -1, 0)),  # end to end
    ],
)
def test_two_edges(points: list[tuple[float, ...]], expected: tuple[float, ...]) -> None:
    assert nearest(EDGE_EDGE, np.array(points, float))[0] == pytest.approx(np.array(expected), abs=1e-6)


def test_nearly_parallel_edges() -> None:
    """The formula for two lines is ill-conditioned there."""
    for tilt in (0.0, 1e-6, 1e-4, 1e-3):
        points = np.array([(0, 0, 0), (1, 0, 0), (0.25, 0.1, 0), (0.75, 0.1 - tilt, 0)])
        assert nearest(EDGE_EDGE, points)[1] == pytest.approx(0.1 - tilt, abs=1e-6)


# -- separating directions -------------------------------------------------------------------------------------------


class Pair(NamedTuple):
    """Four particles."""

    x_safe: ti.MatrixField


@ti.kernel
def separate(data: ti.template(), kind: int, last: tm.vec3) -> tm.vec4:
    """Return the direction of the greatest gap, and the gap."""
    n, gap, _weights = separating_direction(data, tm.ivec4(0, 1, 2, 3), kind, last)
    return tm.vec4(n.x, n.y, n.z, gap)


@ti.kernel
def gap_along(data: ti.template(), kind: int, n: tm.vec3) -> float:
    return separation(data.x_safe, tm.ivec4(0, 1, 2, 3), kind, n)


@pytest.fixture(scope="module")
def pair(taichi: None) -> Pair:
    return Pair(ti.Vector.field(3, ti.f32, 4))


def narrowness(kind: int, points: Floats) -> float:
    """Return the longest side of the triangle over its height, or 1 over the sine between the edges; at least 1."""
    sides = [points[1] - points[0], points[3] - points[2]]
    if kind == VERTEX_TRIANGLE:
        sides = [points[2] - points[1], points[3] - points[2], points[1] - points[3]]
    lengths = sorted(float(np.linalg.norm(side)) for side in sides)
    return max(1.0, lengths[-1] * lengths[-2] / max(float(np.linalg.norm(np.cross(*sides[:2]))), 1e-30))


@given(KINDS, POINTS)
def test_parts_that_are_apart_have_a_separating_direction(pair: Pair, kind: int, points: Floats) -> None:
    pair.x_safe.from_numpy(points.astype(np.float32))
    *n, gap = separate(pair, kind, tm.vec3(0.0))
    found = nearest(kind, points)[1]
    if found > 1e-3:
        assert np.linalg.norm(n) == pytest.approx(1.0, abs=1e-5)
        # Squared distances tell the nearest points to the square root of a rounding error, and those of narrow parts
        # are off by many rounding errors of the longest side. That tilts the direction by this length over the
        # distance, and the ends of the longest side lose gap by as much.
        longest = float(np.linalg.norm(points[:, None] - points[None], axis=2).max())
        rounding = float(np.finfo(np.float32).eps)
        tilt = rounding**0.5 + 10 * rounding * longest * narrowness(kind, points) / found
        assert gap == pytest.approx(found, abs=1e-5 + tilt * longest)
        places = points @ np.array(n)
        in_a = 2 if kind == EDGE_EDGE else 1
        assert places[:in_a].min() - places[in_a:].max() == pytest.approx(gap, abs=1e-5)
    assert gap <= found + 1e-5


def test_the_last_direction_is_kept_where_the_nearest_points_give_none(pair: Pair) -> None:
    """A particle that touches the inside of a triangle: the direction between the nearest points has no length."""
    pair.x_safe.from_numpy(np.array([(0.25, 0.25, 0), (0, 0, 0), (1, 0, 0), (0, 1, 0)], np.float32))
    for z in (1.0, -1.0):
        *n, gap = separate(pair, VERTEX_TRIANGLE, tm.vec3(0.0, 0.0, z))
        assert n == pytest.approx([0.0, 0.0, z])
        assert gap == pytest.approx(0.0)
    assert gap_along(pair, VERTEX_TRIANGLE, tm.vec3(1.0, 0.0, 0.0)) == pytest.approx(-0.75)
