"""Distances along a mesh of triangles. NumPy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .incidence import incidence

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]


def distances_from(
    sources: Whole, places: Floats, triangles: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """For each of N points, at places (N, 3) [m], the nearest source and how far it is along the mesh [m], both (N,).

    A front goes on from two corners of a triangle to the third as if it came straight from one point in the triangle's
    plane, or along a side (Kimmel and Sethian 1998, *Computing geodesic paths on manifolds*, with round fronts as in
    Novotni and Klein 2002, *Computing geodesic distances on triangular meshes*). All triangles go on at once, until
    none brings a point nearer. On a flat sheet without holes distances from one source are exact but for rounding. A
    point that no way leads to is its own source, 0 away.
    """
    count = len(places)
    away = np.full(count, np.inf)
    nearest = np.arange(count, dtype=np.int32)
    away[sources] = 0.0
    turns = np.concatenate([np.roll(triangles, k, axis=1) for k in range(3)])  # every corner once as the third
    a, b, c = turns.T
    ways = _Ways(places[a], places[b], places[c])
    while True:
        reached = np.isfinite(away[a]) & np.isfinite(away[b])
        new = np.minimum(away[a] + ways.from_a, away[b] + ways.from_b)
        new[reached] = np.minimum(new[reached], ways.straight(away[a], away[b], reached))
        source = np.where(away[a] + ways.from_a <= away[b] + ways.from_b, nearest[a], nearest[b])
        order = np.lexsort((new, c))
        points, first = np.unique(c[order], return_index=True)
        best = order[first]
        nearer = new[best] < away[points] * (1 - 1e-9)
        if not nearer.any():
            break
        away[points[nearer]], nearest[points[nearer]] = new[best][nearer], source[best][nearer]
    away[np.isinf(away)] = 0.0
    # Between two sources the front is nearer than each of them.
    return nearest, np.maximum(away, np.linalg.norm(places - places[nearest], axis=1))


class _Ways:
    """Triangles a, b, c in their own planes: a at the origin, b at (base, 0), c above."""

    def __init__(self, a: Floats, b: Floats, c: Floats) -> None:
        self.from_a, self.from_b = np.linalg.norm(c - a, axis=1), np.linalg.norm(c - b, axis=1)
        self.base = np.linalg.norm(b - a, axis=1)
        self.x = ((c - a) * (b - a)).sum(axis=1) / self.base
        self.y = np.sqrt(np.maximum(self.from_a**2 - self.x**2, 0.0))

    def straight(self, to_a: Floats, to_b: Floats, which: NDArray[np.bool_]) -> Floats:
        """Distance of c from a point below the base that is so far from a and from b; infinite where the way to it
        passes beside the base.
        """
        p, q, base, x, y = to_a[which], to_b[which], self.base[which], self.x[which], self.y[which]
        u = (p**2 - q**2 + base**2) / (2 * base)
        v = -np.sqrt(np.maximum(p**2 - u**2, 0.0))
        crossing = u + (x - u) * -v / np.maximum(y - v, 1e-300)
        inside = (p**2 >= u**2) & (crossing >= 0) & (crossing <= base)
        return np.where(inside, np.hypot(x - u, y - v), np.inf)


def pieces_of(edges: NDArray[np.int32], chosen: NDArray[np.bool_]) -> list[Whole]:
    """The chosen of N points, (N,), that edges between them join, piece by piece in order of their first."""
    first, rows = incidence(edges, len(chosen))
    left = set(np.flatnonzero(chosen).tolist())
    found = []
    for start in sorted(left):
        if start not in left:
            continue
        left.remove(start)
        piece = [start]
        for point in piece:  # grows as neighbours are found
            for other in edges[rows[first[point] : first[point + 1]]].reshape(-1).tolist():
                if other in left:
                    left.remove(other)
                    piece.append(other)
        found.append(np.array(sorted(piece)))
    return found
