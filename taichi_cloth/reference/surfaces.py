"""Exact signed distance to a closed triangle mesh in float64, for particles that move a little from call to call.

Each particle keeps a list of the triangles that can be nearest to it until it has moved by `skin`. The sign is that of
the angle-weighted normal at the nearest vertex, edge or face (Bærentzen and Aanæs 2005).
"""

from __future__ import annotations

import numpy as np

from ..mesh.solid import surface_of
from ..scene.model import Mesh
from .springs import Floats, Ints

CHUNK = 200  # particles whose lists are made at once


class MeshDistance:
    """Distance to a mesh collider; exact up to `reach` from the surface, a lower bound beyond."""

    def __init__(self, mesh: Mesh) -> None:
        surface = surface_of(mesh)
        self._corners = surface.points[surface.faces].transpose(1, 2, 0)  # (3 corners, 3, T)
        self._half = surface.half[:, None]
        self._normals = _feature_normals(surface.points, surface.faces.astype(np.int64))
        self.reach = mesh.margin + 0.02 * float(surface.half.max())
        self._skin = self.reach - mesh.margin
        self._listed: Floats | None = None  # where the particles were when the lists were made
        self._particle = self._face = np.zeros(0, np.int64)  # pairs, particle by particle
        self._first = np.zeros(0, np.int64)
        self._bound = np.zeros(0)  # a lower bound of the distance then, for particles without a list

    def __call__(self, x: Floats) -> tuple[Floats, Floats]:
        """Distance [m] (M,) and normal (3, M) of places (3, M) along its own axes."""
        stale = True
        if self._listed is not None and self._listed.shape == x.shape:
            moved = np.sqrt(((x - self._listed) ** 2).sum(axis=0))
            stale = bool((moved > self._skin / 2).any())
        if stale:
            self._list(x)
            moved = np.zeros(x.shape[1])
        distance = self._bound - moved
        normal = np.zeros_like(x)
        normal[1] = 1.0
        if len(self._particle):
            foot, feature = _nearest(x[:, self._particle], self._corners[:, :, self._face])
            away = x[:, self._particle] - foot
            squared = (away * away).sum(axis=0)
            least = np.minimum.reduceat(squared, self._first)
            count = np.diff(np.append(self._first, len(squared)))
            pair = np.flatnonzero(squared == np.repeat(least, count))
            _, once = np.unique(self._particle[pair], return_index=True)
            pair = pair[once]
            particle, long = self._particle[pair], np.sqrt(squared[pair])
            outward = self._normals[self._face[pair], feature[pair]].T
            sign = np.where((away[:, pair] * outward).sum(axis=0) < 0, -1.0, 1.0)
            distance[particle] = sign * long
            far = long > 1e-12
            normal[:, particle] = np.where(far, sign * away[:, pair] / np.where(far, long, 1.0), outward)
        return distance, normal

    def _list(self, x: Floats) -> None:
        """Lists for each particle near the surface all faces that may be nearest to it."""
        self._listed = x.copy()
        beyond = np.maximum(np.abs(x) - self._half, 0.0)
        self._bound = np.sqrt((beyond * beyond).sum(axis=0))
        center = self._corners.mean(axis=0)
        radius = np.sqrt(((self._corners - center) ** 2).sum(axis=1)).max(axis=0)
        particles: list[Ints] = []
        faces: list[Ints] = []
        near = np.flatnonzero(self._bound < self.reach + self._skin)
        for begin in range(0, len(near), CHUNK):
            some = near[begin : begin + CHUNK]
            away = np.sqrt(((x[:, some, None] - center[:, None, :]) ** 2).sum(axis=0))
            least = (away - radius).min(axis=1)  # a lower bound of the distance, and an upper one
            most = (away + radius).min(axis=1)
            self._bound[some] = np.maximum(self._bound[some], least)
            wanted = away - radius <= (most + self._skin)[:, None]
            wanted[least > self.reach + self._skin] = False
            row, face = np.nonzero(wanted)
            particles.append(some[row])
            faces.append(face)
        self._particle = np.concatenate([np.zeros(0, np.int64), *particles])
        self._face = np.concatenate([np.zeros(0, np.int64), *faces])
        self._first = np.flatnonzero(np.diff(self._particle, prepend=-1))


def _nearest(x: Floats, corners: Floats) -> tuple[Floats, Ints]:
    """Nearest point of each triangle (3, 3, M) to its place (3, M), and on which feature that lies (M,).

    Features: 0, 1, 2 the corners; 3, 4, 5 the edges from those to the next corner; 6 the face.
    """
    edges = np.stack([corners[(k + 1) % 3] - corners[k] for k in range(3)])
    normal = _cross(edges[0], -edges[2])
    best = np.full(x.shape[1], np.inf)
    foot, feature = np.zeros_like(x), np.zeros(x.shape[1], np.int64)
    inside = np.ones(x.shape[1], bool)
    for k in range(3):
        away = x - corners[k]
        share = np.clip((away * edges[k]).sum(axis=0) / (edges[k] ** 2).sum(axis=0), 0.0, 1.0)
        point = corners[k] + share * edges[k]
        squared = ((x - point) ** 2).sum(axis=0)
        nearer = squared < best
        best = np.where(nearer, squared, best)
        foot = np.where(nearer, point, foot)
        feature = np.where(nearer, np.where(share == 0, k, np.where(share == 1, (k + 1) % 3, 3 + k)), feature)
        inside &= (_cross(edges[k], away) * normal).sum(axis=0) >= 0
    above = ((x - corners[0]) * normal).sum(axis=0) / (normal**2).sum(axis=0)
    return np.where(inside, x - above * normal, foot), np.where(inside, 6, feature)


def _cross(a: Floats, b: Floats) -> Floats:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _feature_normals(points: Floats, faces: Ints) -> Floats:
    """Outward normal of the seven features of every face, (T, 7, 3), of no particular length."""
    corners = points[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    at_point = np.zeros_like(points)
    at_edge: dict[tuple[int, int], Floats] = {}
    for k in range(3):
        u, v = (corners[:, (k + step) % 3] - corners[:, k] for step in (1, 2))
        cosine = (u * v).sum(axis=1) / np.linalg.norm(u, axis=1) / np.linalg.norm(v, axis=1)
        np.add.at(at_point, faces[:, k], np.arccos(np.clip(cosine, -1, 1))[:, None] * normal)
        for pair, n in zip(np.sort(faces[:, [k, (k + 1) % 3]], axis=1).tolist(), normal, strict=True):
            at_edge[tuple(pair)] = at_edge.get(tuple(pair), 0.0) + n
    found = np.zeros((len(faces), 7, 3))
    for k in range(3):
        found[:, k] = at_point[faces[:, k]]
        found[:, 3 + k] = [at_edge[tuple(p)] for p in np.sort(faces[:, [k, (k + 1) % 3]], axis=1).tolist()]
    found[:, 6] = normal
    return found
