"""Distances along a mesh of triangles. NumPy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .incidence import incidence

CLOSE = 1e-8  # share of a distance that is not worth another round

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]


def distances_from(
    sources: Whole, places: Floats, triangles: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """For each of N points, at places (N, 3) [m], the nearest source and how far it is along the mesh [m], both (N,).

    A front goes on from two corners of a triangle to the third as if it came straight from one point in the triangle's
    plane, or along a side (Kimmel and Sethian 1998, *Computing geodesic paths on manifolds*, with round fronts as in
    Novotni and Klein 2002, *Computing geodesic distances on triangular meshes*). The triangles at the front go on at
    once, until none brings a point nearer. On a flat sheet without holes distances from one source are exact but for
    rounding. A point that no way leads to is its own source, 0 away.
    """
    count = len(places)
    away = np.full(count, np.inf)
    nearest = np.arange(count, dtype=np.int32)
    away[sources] = 0.0
    turns = np.concatenate([np.roll(triangles, k, axis=1) for k in range(3)])  # every corner once as the third
    a, b, c = turns.T
    ways = _Ways(places[a], places[b], places[c])
    first_row, rows = incidence(triangles, count)
    step = float(ways.base.mean()) if len(triangles) else 0.0
    moved = np.isin(np.arange(count), sources)
    while moved.any():
        front = np.flatnonzero(moved)
        front = front[away[front] <= away[front].min() + step]  # those farther off wait, or they would go on in vain
        count_there = first_row[front + 1] - first_row[front]
        within = np.arange(count_there.sum()) - np.repeat(count_there.cumsum() - count_there, count_there)
        beside = np.unique(rows[np.repeat(first_row[front], count_there) + within])
        here = np.concatenate([beside, beside + len(triangles), beside + 2 * len(triangles)])
        to_a, to_b = away[a[here]], away[b[here]]
        by_a, by_b = to_a + ways.from_a[here], to_b + ways.from_b[here]
        new = np.minimum(by_a, by_b)
        both = np.isfinite(to_a) & np.isfinite(to_b)
        new[both] = np.minimum(new[both], ways.straight(to_a[both], to_b[both], here[both]))
        source = np.where(by_a <= by_b, nearest[a[here]], nearest[b[here]])
        order = np.lexsort((new, c[here]))
        points, first = np.unique(c[here][order], return_index=True)
        best = order[first]
        nearer = new[best] < away[points] * (1 - CLOSE)
        points, best = points[nearer], best[nearer]
        away[points], nearest[points] = new[best], source[best]
        moved[front] = False
        moved[points] = True
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

    def straight(self, p: Floats, q: Floats, which: Whole) -> Floats:
        """Distance of c from a point below the base that is p from a and q from b, in some of the triangles; infinite
        where the way to it passes beside the base.
        """
        base, x, y = self.base[which], self.x[which], self.y[which]
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
