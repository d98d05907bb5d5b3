"""Distances to a closed surface, kept at the nodes of a grid. NumPy only.

Nodes near the surface have the exact distance. From there on each takes the nearest of the faces that are nearest to
its neighbours, and walks on to faces around it while they are nearer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .incidence import incidence
from .surface import Faces, Surface, feature_normals, nearest

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

NEAR = 2.0  # cells from the surface within which a node looks at all faces
SPARE = 2  # nodes beyond whatever is near enough to count
MOST_NODES, MOST_PAIRS = 2_000_000, 40_000_000  # some ten seconds
CHUNK = 500_000  # pairs of a node and a face at once


@dataclass(frozen=True, eq=False)
class DistanceGrid:
    """Signed distances [m], negative inside, around the middle of the surface's box."""

    values: NDArray[np.float32]  # [m] (nx, ny, nz)
    spacing: float  # [m] between nodes

    @property
    def half(self) -> Floats:
        """[m] (3,) half sides of the box of nodes."""
        return (np.array(self.values.shape) - 1) * (self.spacing / 2)

    def at(self, places: Floats) -> Floats:
        """Distance of places (N, 3) along the surface's own axes [m], (N,), linear between nodes.

        Beyond the nodes it is the least that it can be: the box of nodes is convex, so the surface is at least the
        root of (way to the box)² + (distance there)² away.
        """
        inside = np.clip(places, -self.half, self.half)
        steps = (inside + self.half) / self.spacing
        cell = np.minimum(steps.astype(np.int64), np.array(self.values.shape) - 2)
        share = steps - cell
        found: Floats = np.zeros(len(places))
        for corner in np.ndindex(2, 2, 2):
            weight = np.where(corner, share, 1 - share).prod(axis=1)
            found += weight * self.values[tuple((cell + corner).T)]
        beyond = ((places - inside) ** 2).sum(axis=1)
        return np.where(beyond > 0, np.sqrt(beyond + found**2), found)


@dataclass(frozen=True, eq=False)
class _Plan:
    """A grid before it is filled."""

    shape: tuple[int, int, int]
    spacing: float  # [m]
    half: Floats  # [m] (3,)
    low: Whole  # (T, 3) first node of the box around each face in which nodes look at it
    sizes: Whole  # (T, 3) of that box, in nodes

    @property
    def pairs(self) -> Whole:
        """How many nodes look at each face, (T,)."""
        count: Whole = self.sizes.prod(axis=1)
        return count


def _plan(surface: Surface, cells: int, reach: float) -> _Plan:
    spacing = 2 * float(surface.half.max()) / cells
    x, y, z = (int(n) for n in 2 * np.ceil((surface.half + reach) / spacing + SPARE) + 1)
    if x * y * z > MOST_NODES:
        raise ValueError(f"its distances need {x}×{y}×{z} nodes, more than {MOST_NODES}: fewer cells, or less margin")
    half = (np.array([x, y, z]) - 1) * (spacing / 2)
    corners, near = surface.corners, NEAR * spacing
    low = np.ceil((corners.min(axis=1) - near + half) / spacing).astype(np.int64)
    high = np.floor((corners.max(axis=1) + near + half) / spacing).astype(np.int64)
    plan = _Plan((x, y, z), spacing, half, low, high + 1 - low)
    if plan.pairs.sum() > MOST_PAIRS:
        raise ValueError(f"its {len(corners)} faces reach over too many cells: take fewer of either")
    return plan


def check_size(surface: Surface, cells: int, reach: float) -> None:
    """Raises ValueError, one line, for distances that would take too much memory or time."""
    _plan(surface, cells, reach)


def distance_grid(surface: Surface, cells: int, reach: float) -> DistanceGrid:
    """The distances to a surface, with so many cells along its longest side, and to `reach` [m] around it.

    Raises ValueError as `check_size` does.
    """
    plan = _plan(surface, cells, reach)
    axes = [plan.spacing * np.arange(n) - h for n, h in zip(plan.shape, plan.half, strict=True)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    face, distance = _near(surface, places, plan)
    sign = np.zeros(len(places))
    known = np.flatnonzero(face >= 0)
    sign[known] = _sides(surface, places[known], face[known])
    _spread(surface, places, plan.shape, face, distance, sign)
    return DistanceGrid((sign * distance).reshape(plan.shape).astype(np.float32), plan.spacing)


def _near(surface: Surface, places: Floats, plan: _Plan) -> tuple[Whole, Floats]:
    """For nodes near the surface their nearest face, else −1, and the distance, else infinity."""
    corners, counts, ends = surface.corners, plan.pairs, np.cumsum(plan.pairs)
    face, distance = np.full(len(places), -1), np.full(len(places), np.inf)
    for begin in range(0, int(ends[-1]), CHUNK):
        pair = np.arange(begin, min(begin + CHUNK, int(ends[-1])))
        here = np.searchsorted(ends, pair, side="right")
        number = pair - ends[here] + counts[here]  # of the node in the face's box
        _, y, z = plan.sizes[here].T
        within = np.stack([number // (y * z), number // z % y, number % z])
        node = np.ravel_multi_index(tuple(plan.low[here].T + within), plan.shape)
        away = _distances(places[node], corners[here])
        order = np.lexsort((away, node))
        node, first = np.unique(node[order], return_index=True)
        away, here = away[order][first], here[order][first]
        nearer = (away < distance[node]) & (away <= NEAR * plan.spacing)
        distance[node[nearer]], face[node[nearer]] = away[nearer], here[nearer]
    return face, distance


def _distances(places: Floats, corners: Floats) -> Floats:
    """From each place (M, 3) to its triangle (M, 3, 3) [m]."""
    foot = np.einsum("ij,ijk->ik", nearest(places, corners), corners)
    away: Floats = np.linalg.norm(places - foot, axis=1)
    return away


def _sides(surface: Surface, places: Floats, face: Whole) -> Floats:
    """1 outside and −1 inside for places with their nearest faces (`feature_normals`)."""
    corners = surface.corners[face]
    shares = nearest(places, corners)
    normal = feature_normals(surface)[face, (shares > 0) @ np.array([1, 2, 4])]
    away = places - np.einsum("ij,ijk->ik", shares, corners)
    return np.where((away * normal).sum(axis=1) < 0, -1.0, 1.0)


def _spread(
    surface: Surface, places: Floats, shape: tuple[int, ...], face: Whole, distance: Floats, sign: Floats
) -> None:
    """Fills the nodes that are not near, layer by layer; between neighbours of them there is no surface."""
    steps = (shape[1] * shape[2], shape[2], 1)
    corners, around = surface.corners, incidence(surface.faces, len(surface.points))
    settled = face >= 0
    layer = np.flatnonzero(settled)
    while len(layer):
        for axis, step in enumerate(steps):
            along = layer // step % shape[axis]
            for way in (-1, 1):
                inside = (along + way >= 0) & (along + way < shape[axis])
                here = layer[inside]
                node = here + way * step
                here, node = here[~settled[node]], node[~settled[node]]
                away = _distances(places[node], corners[face[here]])
                nearer = away < distance[node]
                here, node = here[nearer], node[nearer]
                distance[node], face[node], sign[node] = away[nearer], face[here], sign[here]
        layer = np.flatnonzero((face >= 0) & ~settled)
        settled[layer] = True
        walking = layer
        while len(walking):
            walking = walking[_walk(surface, around, places, walking, face, distance)]


def _walk(
    surface: Surface, around: tuple[Faces, Faces], places: Floats, nodes: Whole, face: Whole, distance: Floats
) -> NDArray[np.bool_]:
    """Looks for each node at the faces around the nearest corner of its face; which nodes took a nearer one.

    `around`: the faces at each point (`incidence`).
    """
    first, rows = around
    before = face[nodes]
    corner = nearest(places[nodes], surface.corners[before]).argmax(axis=1)
    point = surface.faces[before, corner]
    begin, count = first[point], first[point + 1] - first[point]
    for k in range(int(count.max())):
        here = k < count
        node, beside = nodes[here], rows[begin[here] + k]
        away = _distances(places[node], surface.corners[beside])
        nearer = away < distance[node]
        distance[node[nearer]], face[node[nearer]] = away[nearer], beside[nearer]
    went: NDArray[np.bool_] = face[nodes] != before
    return went
