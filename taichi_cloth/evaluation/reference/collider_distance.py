"""Signed distances to colliders and their gradients, along the collider's own axes, negative inside. In float64."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...geometry.signed_distance import collider_surface
from ...geometry.spring_model import Floats, Ints
from ...scene.collider_schema import Box, Capsule, Collider, Ground, Mesh, Sphere

DIFFERENCE_STEP = 1e-5  # [s] half of the interval over which velocities are differenced
CLIP_STEP = 1e-3  # [s] the same for vertices of a clip, which are numbers of float32
CHUNK = 200  # particles whose candidate lists are built at once


class MeshDistance:
    """Signed distance to a closed triangle mesh; exact up to `reach` from the surface, a lower bound beyond.

    It is meant for particles that move little from call to call: each keeps a list of the triangles that can be closest
    to it, which is valid until the particle has moved by half the skin. The sign is that of the angle-weighted normal
    at the closest vertex, edge or face (Bærentzen and Aanæs 2005).
    """

    def __init__(self, mesh: Mesh) -> None:
        surface = collider_surface(mesh)
        self._corners = surface.vertices[surface.faces].transpose(1, 2, 0)  # (3 corners, 3, T)
        self._half = np.abs(surface.vertices).max(axis=0)[:, None]
        self._normals = _feature_normals(surface.vertices, surface.faces.astype(np.int64))
        self.reach = mesh.margin + 0.02 * float(surface.half.max())
        self._skin = self.reach - mesh.margin
        self._list_positions: Floats | None = None  # positions of the particles when the lists were built
        self._particle = self._face = np.zeros(0, np.int64)  # candidate pairs, sorted by particle
        self._first_pair = np.zeros(0, np.int64)
        self._bound = np.zeros(0)  # lower bound of the distance at that time, for particles without a list
        self._shift = 0.0  # [m] largest distance of a triangle from where it was at that time
        # Of the last call: particles with a list, their nearest faces, and the nearest points (3, P).
        self._found = np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((3, 0))

    def __call__(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the distance [m] (M,) and the normal (3, M) at positions (3, M) along the mesh's own axes."""
        stale = True
        if self._list_positions is not None and self._list_positions.shape == x.shape:
            moved = np.sqrt(((x - self._list_positions) ** 2).sum(axis=0)) + self._shift
            stale = bool((moved > self._skin / 2).any())
        if stale:
            self._build_lists(x)
            moved = np.zeros(x.shape[1])
        distance = self._bound - moved
        normal = np.zeros_like(x)
        normal[1] = 1.0
        if len(self._particle):
            closest, feature = _nearest(x[:, self._particle], self._corners[:, :, self._face])
            offset = x[:, self._particle] - closest
            squared = (offset * offset).sum(axis=0)
            smallest = np.minimum.reduceat(squared, self._first_pair)
            count = np.diff(np.append(self._first_pair, len(squared)))
            pair = np.flatnonzero(squared == np.repeat(smallest, count))
            _, first = np.unique(self._particle[pair], return_index=True)
            pair = pair[first]
            particle, length = self._particle[pair], np.sqrt(squared[pair])
            self._found = particle, self._face[pair], closest[:, pair]
            outward = self._normals[self._face[pair], feature[pair]].T
            sign = np.where((offset[:, pair] * outward).sum(axis=0) < 0, -1.0, 1.0)
            distance[particle] = sign * length
            apart = length > 1e-12
            normal[:, particle] = np.where(apart, sign * offset[:, pair] / np.where(apart, length, 1.0), outward)
        return distance, normal

    def _build_lists(self, x: Floats) -> None:
        """List, for each particle near the surface, all faces that may be closest to it."""
        self._list_positions = x.copy()
        outside = np.maximum(np.abs(x) - self._half, 0.0)
        self._bound = np.sqrt((outside * outside).sum(axis=0))
        center = self._corners.mean(axis=0)
        radius = np.sqrt(((self._corners - center) ** 2).sum(axis=1)).max(axis=0)
        particles: list[Ints] = []
        faces: list[Ints] = []
        near = np.flatnonzero(self._bound < self.reach + self._skin)
        for begin in range(0, len(near), CHUNK):
            chunk = near[begin : begin + CHUNK]
            distance = np.sqrt(((x[:, chunk, None] - center[:, None, :]) ** 2).sum(axis=0))
            lower = (distance - radius).min(axis=1)  # bounds of the distance to the surface
            upper = (distance + radius).min(axis=1)
            self._bound[chunk] = np.maximum(self._bound[chunk], lower)
            possible = distance - radius <= (upper + self._skin)[:, None]
            possible[lower > self.reach + self._skin] = False
            row, face = np.nonzero(possible)
            particles.append(chunk[row])
            faces.append(face)
        self._particle = np.concatenate([np.zeros(0, np.int64), *particles])
        self._face = np.concatenate([np.zeros(0, np.int64), *faces])
        self._first_pair = np.flatnonzero(np.diff(self._particle, prepend=-1))


class ClipDistance(MeshDistance):
    """Signed distance to a closed mesh whose vertices follow a clip. `move_to` comes before a query."""

    def __init__(self, mesh: Mesh) -> None:
        super().__init__(replace(mesh, clip_time=0.0))
        self._mesh = mesh
        self._faces = collider_surface(mesh).faces.astype(np.int64)
        self._vertices = self._listed_vertices = self._vertices_at(0.0)
        self._seconds = 0.0

    def move_to(self, seconds: float) -> None:
        """Move the triangles to where they are at a time."""
        self._seconds, self._vertices = seconds, self._vertices_at(seconds)
        self._corners = self._vertices[self._faces].transpose(1, 2, 0)
        self._shift = float(np.sqrt(((self._vertices - self._listed_vertices) ** 2).sum(axis=1).max()))

    def velocity(self) -> Floats:
        """Return the velocity of the nearest points of the positions of the last call [m/s], (3, M).

        It is along the mesh's own axes, and 0 where the distance was a lower bound.
        """
        before, after = (self._vertices_at(self._seconds + t) for t in (-CLIP_STEP, CLIP_STEP))
        particle, face, point = self._found
        weights = barycentric(point, self._corners[:, :, face])
        velocity = np.zeros((3, len(self._bound)))
        moved = ((after - before) / (2 * CLIP_STEP))[self._faces[face]]  # (P, 3 corners, 3)
        velocity[:, particle] = np.einsum("kp,pki->ip", weights, moved)
        return velocity

    def _vertices_at(self, seconds: float) -> Floats:
        return collider_surface(replace(self._mesh, clip_time=seconds)).vertices

    def _build_lists(self, x: Floats) -> None:
        self._listed_vertices, self._shift = self._vertices, 0.0
        self._half = np.abs(self._vertices).max(axis=0)[:, None]
        self._normals = _feature_normals(self._vertices, self._faces)
        super()._build_lists(x)


def barycentric(points: Floats, corners: Floats) -> Floats:
    """Return the weights of the corners (3 corners, 3, P) at the projections of points (3, P), (3 corners, P)."""
    edge, other, offset = corners[1] - corners[0], corners[2] - corners[0], points - corners[0]
    a, b, c = (edge * edge).sum(axis=0), (edge * other).sum(axis=0), (other * other).sum(axis=0)
    d, e = (edge * offset).sum(axis=0), (other * offset).sum(axis=0)
    second, third = np.array([c * d - b * e, a * e - b * d]) / (a * c - b * b)
    weights: Floats = np.array([1 - second - third, second, third])
    return weights


def _nearest(x: Floats, corners: Floats) -> tuple[Floats, Ints]:
    """Return the closest point of each triangle (3, 3, M) to its position (3, M), and its feature, (M,).

    Features: 0, 1, 2 are the corners; 3, 4, 5 the edges from those to the next corner; 6 the face.
    """
    edges = np.stack([corners[(k + 1) % 3] - corners[k] for k in range(3)])
    normal = _cross(edges[0], -edges[2])
    best = np.full(x.shape[1], np.inf)
    closest, feature = np.zeros_like(x), np.zeros(x.shape[1], np.int64)
    inside = np.ones(x.shape[1], bool)
    for k in range(3):
        offset = x - corners[k]
        t = np.clip((offset * edges[k]).sum(axis=0) / (edges[k] ** 2).sum(axis=0), 0.0, 1.0)
        point = corners[k] + t * edges[k]
        squared = ((x - point) ** 2).sum(axis=0)
        closer = squared < best
        best = np.where(closer, squared, best)
        closest = np.where(closer, point, closest)
        feature = np.where(closer, np.where(t == 0, k, np.where(t == 1, (k + 1) % 3, 3 + k)), feature)
        inside &= (_cross(edges[k], offset) * normal).sum(axis=0) >= 0
    height = ((x - corners[0]) * normal).sum(axis=0) / (normal**2).sum(axis=0)
    return np.where(inside, x - height * normal, closest), np.where(inside, 6, feature)


def _cross(a: Floats, b: Floats) -> Floats:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _feature_normals(points: Floats, faces: Ints) -> Floats:
    """Return the outward normals of the seven features of every face, (T, 7, 3), not normalized."""
    corners = points[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    point_normal = np.zeros_like(points)
    edge_normal: dict[tuple[int, int], Floats] = {}
    for k in range(3):
        u, v = (corners[:, (k + step) % 3] - corners[:, k] for step in (1, 2))
        cosine = (u * v).sum(axis=1) / np.linalg.norm(u, axis=1) / np.linalg.norm(v, axis=1)
        np.add.at(point_normal, faces[:, k], np.arccos(np.clip(cosine, -1, 1))[:, None] * normal)
        for pair, n in zip(np.sort(faces[:, [k, (k + 1) % 3]], axis=1).tolist(), normal, strict=True):
            edge_normal[tuple(pair)] = edge_normal.get(tuple(pair), 0.0) + n
    normals = np.zeros((len(faces), 7, 3))
    for k in range(3):
        normals[:, k] = point_normal[faces[:, k]]
        normals[:, 3 + k] = [edge_normal[tuple(p)] for p in np.sort(faces[:, [k, (k + 1) % 3]], axis=1).tolist()]
    normals[:, 6] = normal
    return normals


# -- signed distance to other shapes -----------------------------------------------------------------------------------

# Maps positions (3, M) [m] to distances [m] (M,) and outward unit normals (3, M).
Distance = Callable[[Floats], tuple[Floats, Floats]]


def distance_of(collider: Collider | Ground) -> Distance:
    """Return the distance function of a collider."""
    match collider:
        case Mesh():
            return ClipDistance(collider) if collider.clip else MeshDistance(collider)
        case Sphere():
            radius = collider.radius
            return lambda x: _from_core(x, radius)
        case Capsule():
            half, capsule_radius = collider.length / 2, collider.radius
            return lambda x: _from_core(x - _on_axis(x, half), capsule_radius)
        case Box():
            half_size = np.array(collider.size)[:, None] / 2
            return lambda x: _box(x, half_size)
        case _:
            return _half_space


def _from_core(offset: Floats, radius: float) -> tuple[Floats, Floats]:
    """Return distance and normal of a shape with this radius, from offsets (3, M) to its core."""
    length = np.sqrt((offset * offset).sum(axis=0))
    normal = offset / np.where(length > 0, length, 1.0)
    normal[1, length == 0] = 1.0
    return length - radius, normal


def _on_axis(x: Floats, half: float) -> Floats:
    """Return the closest points (3, M) on a capsule's axis."""
    core = np.zeros_like(x)
    core[1] = np.clip(x[1], -half, half)
    return core


def _box(x: Floats, half_size: Floats) -> tuple[Floats, Floats]:
    beyond = np.abs(x) - half_size
    outside = np.maximum(beyond, 0.0)
    distance, normal = _from_core(outside, 0.0)
    inside = distance == 0
    face = beyond[:, inside].argmax(axis=0)
    normal[:, inside] = np.eye(3)[:, face]
    distance[inside] = beyond[:, inside].max(axis=0)
    return distance, normal * np.where(x < 0, -1.0, 1.0)


def _half_space(x: Floats) -> tuple[Floats, Floats]:
    normal = np.zeros_like(x)
    normal[1] = 1.0
    return x[1].copy(), normal
