"""Edges of a cloth that pass through its triangles, with exact signs, in NumPy. It shares nothing with contact code.

The sign of a determinant is that of its float64 value if that is greater than its rounding error (Shewchuk 1997,
*Adaptive precision floating-point arithmetic and fast robust geometric predicates*, bound of the orientation test), and
is else computed in integers. Parts that only touch do not intersect.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ERROR = 8e-16  # rounding error of a determinant, over the sum of the magnitudes of its products
MAX_BATCH = 1 << 20  # pairs of an edge and a triangle that are tested at once


def find_intersections(
    positions: NDArray[np.floating], edges: NDArray[np.integer], triangles: NDArray[np.integer]
) -> Ints:
    """Return the edges that pass through a triangle, with that triangle, (K, 2).

    `positions` (N, 3) [m]; `edges` (E, 2) and `triangles` (T, 3) are particles. An edge does not intersect a triangle
    with which it shares a particle.
    """
    x = positions.astype(np.float64)
    found = [np.zeros((0, 2), np.int64)]
    for e, t in _near(x, edges, triangles):
        share = (edges[e][:, :, None] == triangles[t][:, None, :]).any(axis=(1, 2))
        e, t = e[~share], t[~share]
        hit = _pass_through(x[edges[e]], x[triangles[t]])
        found.append(np.stack([e[hit], t[hit]], axis=1))
    return np.concatenate(found)


def _near(x: Floats, edges: NDArray[np.integer], triangles: NDArray[np.integer]) -> Iterator[tuple[Ints, Ints]]:
    """Yield batches of all pairs of an edge and a triangle whose bounding boxes meet."""
    low, high = x[edges].min(axis=1), x[edges].max(axis=1)
    t_low, t_high = x[triangles].min(axis=1), x[triangles].max(axis=1)
    axis = int(np.ptp(x, axis=0).argmax()) if len(x) else 0
    order = np.argsort(t_low[:, axis], kind="stable")
    longest = float((t_high - t_low)[:, axis].max(initial=0.0))
    first = np.searchsorted(t_low[order, axis], low[:, axis] - longest)
    last = np.searchsorted(t_low[order, axis], high[:, axis], side="right")
    counts = last - first
    ends = np.cumsum(counts)
    begin = 0
    while begin < len(edges):
        done = ends[begin - 1] if begin else 0
        end = max(int(np.searchsorted(ends, done + MAX_BATCH, side="right")), begin + 1)
        part = np.arange(begin, end)
        e = np.repeat(part, counts[part])
        offset = np.arange(len(e)) - np.repeat(np.cumsum(counts[part]) - counts[part], counts[part])
        t = order[first[e] + offset]
        meet = ((low[e] <= t_high[t]) & (t_low[t] <= high[e])).all(axis=1)
        yield e[meet], t[meet]
        begin = end


def _pass_through(segments: Floats, triangles: Floats) -> NDArray[np.bool_]:
    """Return which segments, (K, 2, 3), pass through the interior of the triangle beside them, (K, 3, 3)."""
    p, q = segments[:, 0], segments[:, 1]
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    passes: NDArray[np.bool_] = _orientation(a, b, c, p) * _orientation(a, b, c, q) < 0
    p, q, a, b, c = (points[passes] for points in (p, q, a, b, c))
    inside = np.stack([_orientation(p, q, a, b), _orientation(p, q, b, c), _orientation(p, q, c, a)])
    passes[passes] = (inside > 0).all(axis=0) | (inside < 0).all(axis=0)
    return passes


def _orientation(a: Floats, b: Floats, c: Floats, d: Floats) -> Ints:
    """Return the exact sign of det(a − d, b − d, c − d), (K,)."""
    u, v, w = a - d, b - d, c - d
    terms = np.stack([u[:, i] * v[:, j] * w[:, k] for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1))])
    minus = np.stack([u[:, i] * v[:, j] * w[:, k] for i, j, k in ((0, 2, 1), (1, 0, 2), (2, 1, 0))])
    value = terms.sum(axis=0) - minus.sum(axis=0)
    sign: Ints = np.sign(value).astype(np.int64)
    size = np.abs(terms).sum(axis=0) + np.abs(minus).sum(axis=0)
    # If all four points are in a plane across an axis, the sign is 0. Bits are compared: after a start of Taichi
    # the processor takes tiny numbers for 0.
    ours, *others = (np.ascontiguousarray(point).view(np.int64) for point in (d, a, b, c))
    level = np.all([other == ours for other in others], axis=0).any(axis=1)
    for k in np.flatnonzero((np.abs(value) <= ERROR * size) & ~level):
        sign[k] = _exact_orientation(a[k], b[k], c[k], d[k])
    return sign


def _exact_orientation(a: Floats, b: Floats, c: Floats, d: Floats) -> int:
    u, v, w = ([Fraction(float(p)) - Fraction(float(q)) for p, q in zip(point, d, strict=True)] for point in (a, b, c))
    value = u[0] * (v[1] * w[2] - v[2] * w[1]) - u[1] * (v[0] * w[2] - v[2] * w[0]) + u[2] * (v[0] * w[1] - v[1] * w[0])
    return (value > 0) - (value < 0)
