"""How far sheets are from each other: particles of one from the triangles of the next. NumPy, in float64."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .watch import Floats

Whole = NDArray[np.int32]


def to_segments(p: Floats, a: Floats, b: Floats) -> Floats:
    """Distance of each point from its segment [m]; all (M, 3)."""
    way = b - a
    along = np.einsum("ij,ij->i", p - a, way) / np.maximum(np.einsum("ij,ij->i", way, way), 1e-300)
    distances: Floats = np.linalg.norm(p - a - np.clip(along, 0.0, 1.0)[:, None] * way, axis=1)
    return distances


def to_triangles(p: Floats, a: Floats, b: Floats, c: Floats) -> Floats:
    """Distance of each point from its triangle [m]; all (M, 3)."""
    normal = np.cross(b - a, c - a)
    squared = np.maximum(np.einsum("ij,ij->i", normal, normal), 1e-300)
    over = np.ones(len(p), bool)  # whether the point is over the inside
    for q, r in ((a, b), (b, c), (c, a)):
        over &= np.einsum("ij,ij->i", np.cross(r - q, p - q), normal) >= 0
    plane = np.abs(np.einsum("ij,ij->i", p - a, normal)) / np.sqrt(squared)
    edges = np.minimum(np.minimum(to_segments(p, a, b), to_segments(p, b, c)), to_segments(p, c, a))
    return np.where(over, np.minimum(plane, edges), edges)


def nearest(points: Floats, x: Floats, triangles: Whole, reach: float) -> float:
    """Least distance of points (P, 3) from triangles (T, 3) of the particles x [m]: exact up to `reach`, else that."""
    a, b, c = (x[triangles[:, k]] for k in range(3))
    middle = (a + b + c) / 3
    largest = max(float(np.linalg.norm(corner - middle, axis=1).max()) for corner in (a, b, c))
    origin = middle.mean(axis=0)  # float32 is enough to tell what is near, from here
    p32, m32 = (points - origin).astype(np.float32), (middle - origin).astype(np.float32)
    squares = (p32 * p32).sum(1)[:, None] + (m32 * m32).sum(1)[None] - 2 * p32 @ m32.T
    k, t = np.nonzero(squares < 1.01 * (reach + largest) ** 2)
    found = to_triangles(points[k], a[t], b[t], c[t])
    return min(reach, float(found.min(initial=reach)))


def least_gap(x: Floats, triangles: Whole, sheets: int, reach: float) -> float:
    """Least distance between each sheet's particles and the next one's triangles, either way round [m].

    `x` (N, 3) are the sheets' particles one after the other, and `triangles` those of the first. Up to `reach`.
    """
    layers = x.reshape(sheets, -1, 3)
    return min(nearest(p, q, triangles, reach) for a, b in pairwise(layers) for p, q in ((a, b), (b, a)))


def is_stacked(x: Floats, sheets: int) -> bool:
    """Whether the mean heights of the sheets still grow from the first to the last."""
    heights = x.reshape(sheets, -1, 3)[:, :, 1].mean(axis=1)
    return bool((np.diff(heights) > 0).all())
