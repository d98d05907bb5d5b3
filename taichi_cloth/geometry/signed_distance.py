"""Signed distance grids of closed surfaces, and of mesh colliders. NumPy only.

Nodes near the surface get the exact distance. From there on, each node takes the nearest of its neighbors' nearest
faces, and moves on to adjacent faces while these are nearer.

Surfaces and distance grids of mesh colliders are cached. `check_solid`, which every scene that is loaded calls, looks
for changed files.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..scene.collider_schema import Mesh
from ..scene.presets import mesh_path
from ..system.files import Version, file_version, new_versions
from .closed_surface import Faces, Surface, closed_surface, closest_point_on_triangle, feature_normals
from .mesh_reader import ObjError, clip_of, clip_path, read_obj
from .topology import adjacency

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

NEAR = 2.0  # [cells] nodes within this distance of a face are tested against it
SPARE = 2  # nodes added beyond the required reach
MAX_NODES, MAX_PAIRS = 2_000_000, 40_000_000  # grids of this size take about ten seconds
CHUNK = 500_000  # node-face pairs processed at once


@dataclass(frozen=True, eq=False)
class DistanceGrid:
    """Signed distances to a surface at the nodes of a grid, which is centered on the surface's bounding box."""

    values: NDArray[np.float32]
    """Signed distance at every node [m], negative inside, (nx, ny, nz)."""
    spacing: float
    """Distance between nodes [m]."""

    @property
    def half(self) -> Floats:
        """Half the sides of the box of nodes [m], (3,)."""
        return (np.array(self.values.shape) - 1) * (self.spacing / 2)

    def at(self, points: Floats) -> Floats:
        """Return the signed distance at points (N, 3) [m], (N,), with linear interpolation between nodes.

        Points are in the local frame of the surface. Outside the grid the distance is a lower bound: the box of nodes
        is convex, so the surface is at least √((distance to the box)² + (distance there)²) away.
        """
        clamped = np.clip(points, -self.half, self.half)
        steps = (clamped + self.half) / self.spacing
        cell = np.minimum(steps.astype(np.int64), np.array(self.values.shape) - 2)
        fraction = steps - cell
        distance: Floats = np.zeros(len(points))
        for corner in np.ndindex(2, 2, 2):
            weight = np.where(corner, fraction, 1 - fraction).prod(axis=1)
            distance += weight * self.values[tuple((cell + corner).T)]
        squared_excess = ((points - clamped) ** 2).sum(axis=1)
        return np.where(squared_excess > 0, np.sqrt(squared_excess + distance**2), distance)


@dataclass(frozen=True, eq=False)
class _Plan:
    """The size of a distance grid, and the nodes to test against each face."""

    shape: tuple[int, int, int]
    """Number of nodes along each axis."""
    spacing: float
    """Distance between nodes [m]."""
    half: Floats
    """Half the sides of the box of nodes [m], (3,)."""
    low: Ints
    """First node of the box of nodes that are tested against each face, (T, 3)."""
    sizes: Ints
    """Size of that box in nodes, (T, 3)."""

    @property
    def pairs(self) -> Ints:
        """Number of nodes that are tested against each face, (T,)."""
        count: Ints = self.sizes.prod(axis=1)
        return count


def _plan(surface: Surface, cells: int, reach: float) -> _Plan:
    """Return the plan of a distance grid. Raises ValueError if it would take too much memory or time."""
    spacing = 2 * float(surface.half.max()) / cells
    x, y, z = (int(n) for n in 2 * np.ceil((surface.half + reach) / spacing + SPARE) + 1)
    if x * y * z > MAX_NODES:
        raise ValueError(f"its grid needs {x}×{y}×{z} nodes, more than {MAX_NODES}: reduce resolution or margin")
    half = (np.array([x, y, z]) - 1) * (spacing / 2)
    corners, near = surface.corners, NEAR * spacing
    low = np.ceil((corners.min(axis=1) - near + half) / spacing).astype(np.int64)
    high = np.floor((corners.max(axis=1) + near + half) / spacing).astype(np.int64)
    plan = _Plan((x, y, z), spacing, half, low, high + 1 - low)
    if plan.pairs.sum() > MAX_PAIRS:
        raise ValueError(f"its {len(corners)} faces span too many grid cells: use fewer faces or a lower resolution")
    return plan


def check_size(surface: Surface, cells: int, reach: float) -> None:
    """Raise ValueError with a one-line message if the distance grid would take too much memory or time."""
    _plan(surface, cells, reach)


def distance_grid(surface: Surface, cells: int, reach: float) -> DistanceGrid:
    """Return the distance grid of a surface.

    `cells`: number of cells along the longest side of the surface. `reach`: how far the grid extends around the surface
    [m]. Raises ValueError if the grid would take too much memory or time.
    """
    plan = _plan(surface, cells, reach)
    axes = [plan.spacing * np.arange(n) - h for n, h in zip(plan.shape, plan.half, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    face, distance = _nearest_faces(surface, nodes, plan)
    sign = np.zeros(len(nodes))
    near = np.flatnonzero(face >= 0)
    sign[near] = _signs(surface, nodes[near], face[near])
    _propagate(surface, nodes, plan.shape, face, distance, sign)
    return DistanceGrid((sign * distance).reshape(plan.shape).astype(np.float32), plan.spacing)


def _nearest_faces(surface: Surface, nodes: Floats, plan: _Plan) -> tuple[Ints, Floats]:
    """Return the nearest face and the distance [m] of every node near the surface.

    Other nodes have face −1 and an infinite distance.
    """
    corners, counts, ends = surface.corners, plan.pairs, np.cumsum(plan.pairs)
    face, distance = np.full(len(nodes), -1), np.full(len(nodes), np.inf)
    for begin in range(0, int(ends[-1]), CHUNK):
        pair = np.arange(begin, min(begin + CHUNK, int(ends[-1])))
        candidate = np.searchsorted(ends, pair, side="right")
        index = pair - ends[candidate] + counts[candidate]  # of the node in the box of the face
        _, y, z = plan.sizes[candidate].T
        offset = np.stack([index // (y * z), index // z % y, index % z])
        node = np.ravel_multi_index(tuple(plan.low[candidate].T + offset), plan.shape)
        pair_distance = _distances(nodes[node], corners[candidate])
        order = np.lexsort((pair_distance, node))
        node, first = np.unique(node[order], return_index=True)
        pair_distance, candidate = pair_distance[order][first], candidate[order][first]
        nearer = (pair_distance < distance[node]) & (pair_distance <= NEAR * plan.spacing)
        distance[node[nearer]], face[node[nearer]] = pair_distance[nearer], candidate[nearer]
    return face, distance


def _distances(points: Floats, corners: Floats) -> Floats:
    """Return the distance from each point (M, 3) to its triangle (M, 3, 3) [m], (M,)."""
    closest = np.einsum("ij,ijk->ik", closest_point_on_triangle(points, corners), corners)
    distance: Floats = np.linalg.norm(points - closest, axis=1)
    return distance


def _signs(surface: Surface, points: Floats, face: Ints) -> Floats:
    """Return 1 for points outside and −1 for points inside, (M,), from their nearest faces (`feature_normals`)."""
    corners = surface.corners[face]
    weights = closest_point_on_triangle(points, corners)
    normal = feature_normals(surface)[face, (weights > 0) @ np.array([1, 2, 4])]
    offset = points - np.einsum("ij,ijk->ik", weights, corners)
    return np.where((offset * normal).sum(axis=1) < 0, -1.0, 1.0)


def _propagate(
    surface: Surface, nodes: Floats, shape: tuple[int, ...], face: Ints, distance: Floats, sign: Floats
) -> None:
    """Fill the nodes that are not near the surface, layer by layer, in place.

    No surface lies between such a node and its neighbors, so it gets the sign of a neighbor.
    """
    strides = (shape[1] * shape[2], shape[2], 1)
    corners, adjacent = surface.corners, adjacency(surface.faces, len(surface.vertices))
    done = face >= 0
    layer = np.flatnonzero(done)
    while len(layer):
        for axis, stride in enumerate(strides):
            along = layer // stride % shape[axis]
            for direction in (-1, 1):
                inside = (along + direction >= 0) & (along + direction < shape[axis])
                source = layer[inside]
                node = source + direction * stride
                source, node = source[~done[node]], node[~done[node]]
                candidate = _distances(nodes[node], corners[face[source]])
                nearer = candidate < distance[node]
                source, node = source[nearer], node[nearer]
                distance[node], face[node], sign[node] = candidate[nearer], face[source], sign[source]
        layer = np.flatnonzero((face >= 0) & ~done)
        done[layer] = True
        moving = layer
        while len(moving):
            moving = moving[_move_to_nearer_faces(surface, adjacent, nodes, moving, face, distance)]


def _move_to_nearer_faces(
    surface: Surface, adjacent: tuple[Faces, Faces], positions: Floats, nodes: Ints, face: Ints, distance: Floats
) -> NDArray[np.bool_]:
    """Test the faces around the vertex closest to each node, and update the node's face where one is nearer.

    `adjacent`: the faces at each vertex, from `adjacency`. Returns which nodes have a new face.
    """
    first, rows = adjacent
    before = face[nodes]
    corner = closest_point_on_triangle(positions[nodes], surface.corners[before]).argmax(axis=1)
    point = surface.faces[before, corner]
    begin, count = first[point], first[point + 1] - first[point]
    for k in range(int(count.max())):
        valid = k < count
        node, neighbor = nodes[valid], rows[begin[valid] + k]
        candidate = _distances(positions[node], surface.corners[neighbor])
        nearer = candidate < distance[node]
        distance[node[nearer]], face[node[nearer]] = candidate[nearer], neighbor[nearer]
    moved: NDArray[np.bool_] = face[nodes] != before
    return moved


POINTS_AT_ONCE = 256
EXACT = 0.1  # longest sides of the surface: distances to points farther from its bounding box are lower bounds


def distances_to_surface(surface: Surface, points: Floats) -> Floats:
    """Return the signed distance from points (N, 3) to a surface [m], (N,), negative inside.

    It is exact near the surface. Far outside it is the distance to the bounding box, a lower bound.
    """
    corners = surface.corners
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    distance: Floats = np.linalg.norm(points - np.clip(points, low, high), axis=1)
    near = np.flatnonzero(distance <= EXACT * float((high - low).max()))
    centers = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centers[:, None], axis=2).max(axis=1)
    for some in np.array_split(near, -(-len(near) // POINTS_AT_ONCE) or 1):
        if len(some):
            apart = np.linalg.norm(points[some, None] - centers, axis=2)
            point, face = np.nonzero(apart - radii <= (apart + radii).min(axis=1, keepdims=True))
            found = _distances(points[some[point]], corners[face])
            order = np.lexsort((found, point))
            nearest = order[np.searchsorted(point[order], np.arange(len(some)))]
            distance[some] = found[nearest] * _signs(surface, points[some], face[nearest])
    return distance


# -- mesh colliders ----------------------------------------------------------------------------------------------------

CACHE_SIZE = 64  # meshes of a few megabytes each


def check_solid(mesh: Mesh) -> None:
    """Raise ValueError with a one-line message if a mesh cannot be used as a collider.

    Files that have changed are read again.
    """
    with new_versions(_path(mesh), *[clip_path(mesh)] * bool(mesh.clip)):
        surface = collider_surface(mesh)
        if not mesh.clip:
            check_size(surface, mesh.resolution, mesh.margin)


def _path(mesh: Mesh) -> Path:
    """Return the absolute path of the file of a mesh."""
    return mesh_path(mesh.file, mesh.folder).absolute()


def collider_surface(mesh: Mesh) -> Surface:
    """Return the surface of a mesh collider, centered on the bounding box of its file; of a clip at `mesh.clip_time`.

    Raises ValueError with a one-line message if the file is not a valid mesh, the mesh is not closed, or its clip
    cannot be used.
    """
    path = _path(mesh)
    surface, center = _cached_surface(path, file_version(path))
    if mesh.clip:
        points = clip_of(mesh, len(surface.vertices)).at(mesh.clip_time)
        surface = Surface(points - center, surface.faces, surface.half)
    return surface.scaled(mesh.scale)


def collider_sdf(mesh: Mesh) -> DistanceGrid:
    """Return the distance grid of a rigid mesh collider. It extends to the collider's margin.

    Raises ValueError with a one-line message if the mesh cannot be used as a collider.
    """
    path = _path(mesh)
    return _cached_distances(path, file_version(path), mesh.scale, mesh.resolution, mesh.margin)


@lru_cache(maxsize=CACHE_SIZE)
def _cached_surface(path: Path, version: Version) -> tuple[Surface, Floats]:
    """Return the surface of a file, and the center of its bounding box, (3,), in the unit of the file."""
    points, faces = read_obj(path)
    try:
        surface = closed_surface(points, faces)
    except ValueError as error:
        raise ObjError(path, 0, str(error)) from None
    return surface, points[0] - surface.vertices[0]


@lru_cache(maxsize=CACHE_SIZE)
def _cached_distances(path: Path, version: Version, scale: float, resolution: int, margin: float) -> DistanceGrid:
    return distance_grid(_cached_surface(path, version)[0].scaled(scale), resolution, margin)
