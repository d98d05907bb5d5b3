"""Closed triangle meshes: checks, normals, closest points, and the triangles of simple solids. NumPy only.

Triangles of simple solids. A solid is two (3·T, 3) arrays, corners [m] and normals; faces are counter-clockwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .topology import adjacency

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]

FLAT = 1e-9  # smallest volume of a closed surface, relative to the cube of the longest side of its bounding box
CREASE = float(np.cos(np.radians(50.0)))  # cosine of the largest angle between faces that are shaded smoothly


@dataclass(frozen=True, eq=False)
class Surface:
    """A closed triangle mesh of N vertices and T faces, centered on its bounding box."""

    vertices: Floats
    """Position of every vertex relative to the center of the bounding box [m], (N, 3)."""
    faces: Faces
    """The three vertices of every face, (T, 3), counter-clockwise seen from outside."""
    half: Floats
    """Half the sides of the bounding box [m], (3,)."""

    @property
    def corners(self) -> Floats:
        """Corners of every face [m], (T, 3, 3)."""
        return self.vertices[self.faces]

    def scaled(self, scale: float) -> Surface:
        """Return the surface enlarged by the factor `scale`."""
        return Surface(self.vertices * scale, self.faces, self.half * scale)


def closed_surface(points: Floats, faces: Faces) -> Surface:
    """Return the closed surface of `points`, (N, 3) [m], and triangles `faces`, (T, 3), centered at the origin.

    All faces are flipped if they point inward. Raises ValueError with a one-line message if the mesh is not closed or
    encloses no volume.
    """
    _check_edges(faces)
    used = points[np.unique(faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    centered = points - (low + high) / 2
    a, b, c = (centered[faces[:, k]] for k in range(3))
    volume = float((a * np.cross(b, c)).sum()) / 6
    if not abs(volume) > FLAT * float((high - low).max()) ** 3:
        raise ValueError("the surface encloses no volume")
    outwards = faces if volume > 0 else np.ascontiguousarray(faces[:, ::-1])
    return Surface(centered, outwards, (high - low) / 2)


def _check_edges(faces: Faces) -> None:
    """Check that every edge belongs to two faces, which contain it in opposite directions.

    Raises ValueError with a message that counts vertices from 1, as OBJ files do.
    """
    forward, backward = _edge_keys(faces)
    unique_edges, counts = np.unique(forward, return_counts=True)
    repeated = counts[np.searchsorted(unique_edges, forward)] > 1
    bad = repeated | ~np.isin(backward, unique_edges)
    if bad.any():
        k = int(bad.argmax())
        a, b = faces[k // 3, k % 3] + 1, faces[k // 3, (k + 1) % 3] + 1
        reason = "has the same direction in two faces" if repeated[k] else "belongs to only one face"
        raise ValueError(f"the surface is not closed: the edge from vertex {a} to {b} {reason}")


def _edge_keys(faces: Faces) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return a number for each directed edge of each face, (3·T,), and that of the opposite direction, (3·T,)."""
    start, end = faces.astype(np.int64).ravel(), np.roll(faces, -1, axis=1).astype(np.int64).ravel()
    count = int(faces.max()) + 1
    return start * count + end, end * count + start


def face_normals(surface: Surface) -> Floats:
    """Return the unit normal of every face, (T, 3); zero for a face of zero area."""
    corners = surface.corners
    return _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def feature_normals(surface: Surface) -> Floats:
    """Return normals of every face and of its edges and vertices, (T, 8, 3). They are not normalized.

    The second index is the feature on which a point of the face lies: the sum of 1, 2 and 4 for the first, second and
    third corner if its barycentric coordinate is not zero. The normal of an edge is the sum of the normals of both its
    faces. The normal of a vertex is the sum of the normals of all faces around it, each times its angle there.

    For any point in space, the normal of the closest feature shows whether the point is inside or outside (Bærentzen
    and Aanæs 2005, *Signed distance computation using the angle weighted pseudonormal*, theorem 1).
    """
    faces, corners, normals = surface.faces, surface.corners, face_normals(surface)
    to_next, to_previous = _unit(np.roll(corners, -1, axis=1) - corners), _unit(np.roll(corners, 1, axis=1) - corners)
    angles = np.arccos(np.clip((to_next * to_previous).sum(axis=2), -1, 1))
    vertex_normals = np.zeros_like(surface.vertices)
    np.add.at(vertex_normals, faces, angles[:, :, None] * normals[:, None])
    forward, backward = _edge_keys(faces)
    order = np.argsort(forward)
    neighbor = order[np.searchsorted(forward[order], backward)].reshape(-1, 3) // 3  # the face across each edge
    result = np.zeros((len(faces), 8, 3))
    result[:, 7] = normals
    for k in range(3):
        result[:, 1 << k] = vertex_normals[faces[:, k]]
        result[:, 1 << k | 1 << (k + 1) % 3] = normals + normals[neighbor[:, k]]
    return result


def smooth_normals(surface: Surface) -> Floats:
    """Return a unit normal for each corner of each face, (T, 3, 3), for smooth shading.

    It is the normalized sum of the normals of the faces around the corner that meet this face at less than the crease
    angle.
    """
    normals = face_normals(surface)
    first, rows = adjacency(surface.faces, len(surface.vertices))
    begin, count = first[surface.faces], np.diff(first)[surface.faces]
    total = np.zeros_like(surface.corners)
    for k in range(int(count.max())):
        neighbor = normals[rows[np.minimum(begin + k, len(rows) - 1)]]
        is_smooth = (k < count) & ((neighbor * normals[:, None]).sum(axis=2) > CREASE)
        total += is_smooth[:, :, None] * neighbor
    return _unit(total)


def closest_point_on_triangle(points: Floats, corners: Floats) -> Floats:
    """Return the closest point of each triangle to a point, in barycentric coordinates, (M, 3).

    `points`: (M, 3). `corners` of the triangles: (M, 3, 3). The coordinate of a corner that does not contribute is
    exactly 0.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    u, v, to_point = b - a, c - a, points - a
    uu, uv, vv, up, vp = (_dot(p, q) for p, q in ((u, u), (u, v), (v, v), (u, to_point), (v, to_point)))
    area = uu * vv - uv * uv  # four times the squared area
    divisor = np.where(area > 1e-12 * uu * vv, area, 1.0)  # a triangle of zero area has only edges
    second, third = (vv * up - uv * vp) / divisor, (uu * vp - uv * up) / divisor
    weights = np.stack([1 - second - third, second, third], axis=1)
    outside = (area <= 1e-12 * uu * vv) | (weights.min(axis=1) <= 0)

    best = np.full(len(points), np.inf)
    best[~outside] = -1.0
    for k in range(3):
        start, side = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        t = np.clip(_dot(points - start, side) / np.maximum(_dot(side, side), 1e-300), 0, 1)
        squared_distance = _dot(points - start - t[:, None] * side, points - start - t[:, None] * side)
        nearer = squared_distance < best
        weights[nearer, k], weights[nearer, (k + 1) % 3], weights[nearer, (k + 2) % 3] = 1 - t[nearer], t[nearer], 0
        best[nearer] = squared_distance[nearer]
    return weights


def _dot(a: Floats, b: Floats) -> Floats:
    product: Floats = np.einsum("ij,ij->i", a, b)
    return product


def _unit(vectors: Floats) -> Floats:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    units: Floats = np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)
    return units


Corners = NDArray[np.float64]


def _grid_corners(points: Corners) -> Corners:
    """Return the corners of two triangles for every cell of a (rows, columns, 3) grid of points."""
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, :-1], points[1:, 1:]
    return np.stack([a, c, d, a, d, b], axis=2).reshape(-1, 3)


def unit_sphere(rings: int = 24) -> Corners:
    """Return the corners of a unit sphere around the origin; a corner is its own normal."""
    polar, around = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, 2 * rings + 1), indexing="ij"
    )
    return _grid_corners(
        np.stack([np.sin(polar) * np.sin(around), np.cos(polar), np.sin(polar) * np.cos(around)], axis=-1)
    )


def cylinder(start: Corners, end: Corners, radius: float, sides: int = 24) -> tuple[Corners, Corners]:
    """Return a cylinder from `start` to `end`, (3,) [m], with flat ends: corners and normals."""
    axis = (end - start) / np.linalg.norm(end - start)
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    angle = np.linspace(0, 2 * np.pi, sides + 1)[:, None]
    spoke = np.cos(angle) * across + np.sin(angle) * np.cross(axis, across)
    side = _grid_corners(np.stack([end + radius * spoke, start + radius * spoke]))
    side_normal = _grid_corners(np.stack([spoke, spoke]))
    caps, cap_normals = [], []
    for center, rim, normal in ((start, spoke[::-1], -axis), (end, spoke, axis)):
        fan = np.stack(
            [np.broadcast_to(center, (sides, 3)), center + radius * rim[:-1], center + radius * rim[1:]], axis=1
        )
        caps.append(fan.reshape(-1, 3))
        cap_normals.append(np.broadcast_to(normal, (3 * sides, 3)))
    return np.concatenate([side, *caps]), np.concatenate([side_normal, *cap_normals])


def capsule_triangles(half: float, radius: float) -> tuple[Corners, Corners]:
    """Return an upright capsule around the origin whose segment has half length `half` [m]: corners and normals."""
    normals = unit_sphere()
    offsets = np.array([0.0, half, 0.0]) * np.where(normals[:, 1:2] < -1e-9, -1.0, 1.0)
    return radius * normals + offsets, normals


def box_triangles(center: Corners, size: Corners) -> tuple[Corners, Corners]:
    """Return a box around `center` with sides `size`, each (3,) [m]: corners and normals."""
    corners, normals = [], []
    square = np.array([[[-1.0, 1.0], [1.0, 1.0]], [[-1.0, -1.0], [1.0, -1.0]]])
    for axis in range(3):
        for sign in (-1.0, 1.0):
            face = np.empty((2, 2, 3))
            face[..., axis] = sign
            face[..., (axis + 1) % 3] = square[..., 0] * sign
            face[..., (axis + 2) % 3] = square[..., 1]
            corners.append(center + _grid_corners(face) * size / 2)
            normals.append(np.broadcast_to(sign * np.eye(3)[axis], (6, 3)))
    return np.concatenate(corners), np.concatenate(normals)


def floor_triangles(middle: Corners, reach: float, cells: int = 80) -> Corners:
    """Return a horizontal square around `middle` (3,) that extends `reach` [m] in each direction.

    Cells are smaller near the middle, where shadows fall.
    """
    u = np.linspace(-1, 1, cells + 1)
    offsets = reach * (0.25 * u + 0.75 * u**5)
    x, z = np.meshgrid(middle[0] + offsets, middle[2] + offsets)
    return _grid_corners(np.stack([x, np.full_like(x, middle[1]), z], axis=-1))


def floor_lines(middle: Corners, reach: float, spacing: float, width: float) -> Corners:
    """Return lines along x and z at multiples of `spacing`, cut into pieces of length `spacing`. All lengths in [m]."""
    first, last = np.ceil((middle - reach) / spacing), np.floor((middle + reach) / spacing)
    x, z = (spacing * np.arange(first[k], last[k] + 1) for k in (0, 2))
    corners = []
    for across, along, end in ((x, z, False), (z, x, True)):
        cuts = along
        a, b = np.meshgrid(across, cuts, indexing="ij")
        lines = np.stack([a[:, None] + np.array([[-width / 2], [width / 2]]), np.stack([b, b], axis=1)], axis=-1)
        points = np.insert(lines[..., ::-1] if end else lines, 1, middle[1], axis=-1)  # (lines, 2, cuts, 3)
        corners += [_grid_corners(points[k]) for k in range(len(points))]
    return np.concatenate(corners)
