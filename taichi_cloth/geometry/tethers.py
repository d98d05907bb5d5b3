"""Tethers: the pins that limit each particle, and their geodesic distances. NumPy only.

Kim, Chentanez and Müller 2012, *Long range attachments*: adjacent pins form a run. A particle is tethered to the
nearest pin of each run, for the `MAX_TETHERS` nearest runs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .grid import NO_GRID, particle_indices
from .topology import Topology, adjacency

CLOSE = 1e-8  # smallest relative decrease of a distance that keeps the front moving

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def geodesic_distances(
    sources: Ints, positions: Floats, triangles: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return the nearest source of each of N vertices, and the distance to it along the mesh [m], both (N,).

    `sources`: vertex indices. `positions`: (N, 3) [m]. `triangles`: (T, 3).

    A front propagates from two vertices of a triangle to the third, as if it came straight from one point in the plane
    of the triangle, or along a side (Kimmel and Sethian 1998, *Computing geodesic paths on manifolds*, with circular
    fronts as in Novotni and Klein 2002, *Computing geodesic distances on triangular meshes*). All triangles at the
    front are updated at once, until no distance decreases. On a flat sheet without holes, distances from one source are
    exact up to rounding. A vertex that is not connected to a source is its own source, at distance 0.
    """
    count = len(positions)
    distance = np.full(count, np.inf)
    nearest = np.arange(count, dtype=np.int32)
    distance[sources] = 0.0
    rotated = np.concatenate([np.roll(triangles, k, axis=1) for k in range(3)])  # with every corner once as the third
    a, b, c = rotated.T
    unfolded = _UnfoldedTriangles(positions[a], positions[b], positions[c])
    first_triangle, rows = adjacency(triangles, count)
    step = float(unfolded.base.mean()) if len(triangles) else 0.0
    changed = np.isin(np.arange(count), sources)
    while changed.any():
        front = np.flatnonzero(changed)
        front = front[distance[front] <= distance[front].min() + step]  # distances farther out may still decrease
        triangle_count = first_triangle[front + 1] - first_triangle[front]
        offset = np.arange(triangle_count.sum()) - np.repeat(triangle_count.cumsum() - triangle_count, triangle_count)
        neighbors = np.unique(rows[np.repeat(first_triangle[front], triangle_count) + offset])
        active = np.concatenate([neighbors, neighbors + len(triangles), neighbors + 2 * len(triangles)])
        d_a, d_b = distance[a[active]], distance[b[active]]
        via_a, via_b = d_a + unfolded.from_a[active], d_b + unfolded.from_b[active]
        new = np.minimum(via_a, via_b)
        reached = np.isfinite(d_a) & np.isfinite(d_b)
        new[reached] = np.minimum(new[reached], unfolded.distance(d_a[reached], d_b[reached], active[reached]))
        source = np.where(via_a <= via_b, nearest[a[active]], nearest[b[active]])
        order = np.lexsort((new, c[active]))
        targets, first = np.unique(c[active][order], return_index=True)
        best = order[first]
        nearer = new[best] < distance[targets] * (1 - CLOSE)
        targets, best = targets[nearer], best[nearer]
        distance[targets], nearest[targets] = new[best], source[best]
        changed[front] = False
        changed[targets] = True
    distance[np.isinf(distance)] = 0.0
    # Where fronts of two sources meet, the result can be less than the distance to either source.
    return nearest, np.maximum(distance, np.linalg.norm(positions - positions[nearest], axis=1))


class _UnfoldedTriangles:
    """Triangles a, b, c in their own planes: a at the origin, b at (base, 0), c above the base."""

    def __init__(self, a: Floats, b: Floats, c: Floats) -> None:
        self.from_a, self.from_b = np.linalg.norm(c - a, axis=1), np.linalg.norm(c - b, axis=1)
        self.base = np.linalg.norm(b - a, axis=1)
        self.x = ((c - a) * (b - a)).sum(axis=1) / self.base
        self.y = np.sqrt(np.maximum(self.from_a**2 - self.x**2, 0.0))

    def distance(self, d_a: Floats, d_b: Floats, which: Ints) -> Floats:
        """Return the distance of c [m] from a source below the base, at distance `d_a` from a and `d_b` from b [m].

        `which`: indices of the triangles. The result is infinite where the straight line from the source to c does not
        cross the base.
        """
        base, x, y = self.base[which], self.x[which], self.y[which]
        u = (d_a**2 - d_b**2 + base**2) / (2 * base)
        v = -np.sqrt(np.maximum(d_a**2 - u**2, 0.0))
        crossing = u + (x - u) * -v / np.maximum(y - v, 1e-300)
        inside = (d_a**2 >= u**2) & (crossing >= 0) & (crossing <= base)
        return np.where(inside, np.hypot(x - u, y - v), np.inf)


def connected_components(edges: NDArray[np.int32], chosen: NDArray[np.bool_]) -> list[Ints]:
    """Return the connected components of the chosen vertices, in order of their first vertex.

    `chosen`: which of the N vertices, (N,). `edges`: (E, 2). Each component is a sorted array of vertex indices.
    """
    first, rows = adjacency(edges, len(chosen))
    remaining = set(np.flatnonzero(chosen).tolist())
    components = []
    for start in sorted(remaining):
        if start not in remaining:
            continue
        remaining.remove(start)
        component = [start]
        for point in component:  # grows during the loop (breadth-first search)
            for other in edges[rows[first[point] : first[point + 1]]].reshape(-1).tolist():
                if other in remaining:
                    remaining.remove(other)
                    component.append(other)
        components.append(np.array(sorted(component)))
    return components


MAX_TETHERS = 4  # per particle


def tethers_of(topology: Topology) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return the pin of each tether and its distance from the particle [m], both (tethers, N), nearest first.

    A grid starts flat, so its distances at the start are those on the sheet. On a mesh, distances are geodesic. A pin
    is tethered to itself, and so is a particle of a component without pins.
    """
    start, count = topology.start, topology.particle_count
    pins = np.zeros((0, count), np.int32)
    distances = np.zeros((0, count))
    is_grid = topology.shape != NO_GRID
    runs = (
        pin_runs(topology.pinned.reshape(topology.shape))
        if is_grid
        else connected_components(topology.edges, topology.pinned)
    )
    for run in runs:
        if is_grid:
            nearest = nearest_pin(run, topology.shape, start)
            distance = np.linalg.norm(start - start[nearest], axis=1)
        else:
            nearest, distance = geodesic_distances(run, topology.flat, topology.triangles)
        pins = np.concatenate([pins, nearest[None]])
        distances = np.concatenate([distances, distance[None]])
        order = np.argsort(distances, axis=0, kind="stable")[:MAX_TETHERS]
        pins, distances = np.take_along_axis(pins, order, 0), np.take_along_axis(distances, order, 0)
    return pins, distances


def pin_runs(pinned: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """Return the runs of adjacent pins of a grid, as arrays of particle indices, in order of their first particle.

    `pinned`: (rows, columns). Each particle has four neighbors in the grid.
    """
    index = particle_indices(*pinned.shape)
    neighbors = [(index[:, :-1], index[:, 1:]), (index[:-1], index[1:])]
    edges = np.concatenate([np.stack(pair, axis=-1).reshape(-1, 2) for pair in neighbors])
    return connected_components(edges, pinned.reshape(-1))


def nearest_pin(run: NDArray[np.int64], shape: tuple[int, int], start: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return the pin of a run that is nearest to each particle on the flat sheet, (N,).

    Pins are grouped into lines: rows or columns, whichever are fewer. In each line, the pin nearest to a particle is
    the one nearest along the line, so each line has one candidate per particle.
    """
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    pin_coords = np.stack(np.unravel_index(run, shape))  # row and column of every pin
    cell = np.linalg.norm(start[[shape[1], 1]] - start[0], axis=1)  # [m] height and width
    across = int(len(set(pin_coords[1].tolist())) < len(set(pin_coords[0].tolist())))  # 1: lines are columns
    along = 1 - across
    coords = np.unravel_index(index.reshape(-1), shape)  # row and column of every particle
    best = np.full(index.size, np.inf)
    nearest = np.zeros(index.size, np.int32)
    for line in np.unique(pin_coords[across]):
        pins = np.sort(pin_coords[along][pin_coords[across] == line])
        steps = np.arange(shape[along])
        after = np.minimum(np.searchsorted(pins, steps), len(pins) - 1)
        before = np.maximum(after - 1, 0)
        closest = np.where(steps - pins[before] <= np.abs(pins[after] - steps), pins[before], pins[after])
        candidate = closest[coords[along]]
        squared = ((candidate - coords[along]) * cell[along]) ** 2 + ((line - coords[across]) * cell[across]) ** 2
        closer = squared < best
        best[closer] = squared[closer]
        pin = index[line, candidate] if across == 0 else index[candidate, line]
        nearest[closer] = pin[closer]
    return nearest
