"""A closed surface of triangles: what makes it one, its normals, and the nearest point of a triangle. NumPy only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .incidence import incidence

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]

FLAT = 1e-9  # volume that is none, in cubes of the surface's size
CREASE = float(np.cos(np.radians(50.0)))  # between the normals of faces that are drawn as one smooth surface


@dataclass(frozen=True, eq=False)
class Surface:
    """Around the middle of the box that holds it; faces run counter-clockwise seen from outside."""

    points: Floats  # [m] (N, 3)
    faces: Faces  # (T, 3)
    half: Floats  # [m] (3,) half sides of the box

    @property
    def corners(self) -> Floats:
        """Corners of every face [m], (T, 3, 3)."""
        return self.points[self.faces]

    def scaled(self, scale: float) -> Surface:
        """The same surface, `scale` times as large."""
        return Surface(self.points * scale, self.faces, self.half * scale)


def closed_surface(points: Floats, faces: Faces) -> Surface:
    """The surface of points (N, 3) and triangles (T, 3), moved to the origin.

    One whose faces all look inwards is turned inside out. Raises ValueError, one line, for one that is not closed.
    """
    _check_edges(faces)
    used = points[np.unique(faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    centered = points - (low + high) / 2
    a, b, c = (centered[faces[:, k]] for k in range(3))
    volume = float((a * np.cross(b, c)).sum()) / 6
    if not abs(volume) > FLAT * float((high - low).max()) ** 3:
        raise ValueError("it encloses no volume")
    outwards = faces if volume > 0 else np.ascontiguousarray(faces[:, ::-1])
    return Surface(centered, outwards, (high - low) / 2)


def _check_edges(faces: Faces) -> None:
    """Every edge belongs to two faces, which pass it in opposite directions. Points are counted from 1, as in files."""
    there, back = _edges(faces)
    known, times = np.unique(there, return_counts=True)
    twice = times[np.searchsorted(known, there)] > 1
    bad = twice | ~np.isin(back, known)
    if bad.any():
        k = int(bad.argmax())
        a, b = faces[k // 3, k % 3] + 1, faces[k // 3, (k + 1) % 3] + 1
        reason = "belongs to two faces that pass it in the same direction" if twice[k] else "belongs to one face only"
        raise ValueError(f"it is not closed: the edge from point {a} to {b} {reason}")


def _edges(faces: Faces) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """A number for each edge of each face in its direction, (3·T,), and that of the way back."""
    start, end = faces.astype(np.int64).ravel(), np.roll(faces, -1, axis=1).astype(np.int64).ravel()
    count = int(faces.max()) + 1
    return start * count + end, end * count + start


def face_normals(surface: Surface) -> Floats:
    """Unit normals, (T, 3); zero for a face without area."""
    corners = surface.corners
    return _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def feature_normals(surface: Surface) -> Floats:
    """Normals, not of length one, of every face, its edges and its points, (T, 8, 3).

    By which corners a point of the face is made of: the sum of 1, 2 and 4 for the first to the third. At an edge it is
    the sum of both faces', at a point that of all around it, each times its angle there. Whatever is nearest to
    a place, this tells on which side of it the place is (Bærentzen and Aanæs 2005, *Signed distance computation
    using the angle weighted pseudonormal*, theorem 1).
    """
    faces, corners, normals = surface.faces, surface.corners, face_normals(surface)
    onwards, backwards = _unit(np.roll(corners, -1, axis=1) - corners), _unit(np.roll(corners, 1, axis=1) - corners)
    angles = np.arccos(np.clip((onwards * backwards).sum(axis=2), -1, 1))
    around = np.zeros_like(surface.points)
    np.add.at(around, faces, angles[:, :, None] * normals[:, None])
    there, back = _edges(faces)
    order = np.argsort(there)
    beside = order[np.searchsorted(there[order], back)].reshape(-1, 3) // 3  # the face beyond each edge
    found = np.zeros((len(faces), 8, 3))
    found[:, 7] = normals
    for k in range(3):
        found[:, 1 << k] = around[faces[:, k]]
        found[:, 1 << k | 1 << (k + 1) % 3] = normals + normals[beside[:, k]]
    return found


def smooth_normals(surface: Surface) -> Floats:
    """A unit normal for each corner of each face, (T, 3, 3): of the faces around it that lie at less than a crease."""
    normals = face_normals(surface)
    first, rows = incidence(surface.faces, len(surface.points))
    begin, count = first[surface.faces], np.diff(first)[surface.faces]
    total = np.zeros_like(surface.corners)
    for k in range(int(count.max())):
        beside = normals[rows[np.minimum(begin + k, len(rows) - 1)]]
        joined = (k < count) & ((beside * normals[:, None]).sum(axis=2) > CREASE)
        total += joined[:, :, None] * beside
    return _unit(total)


def nearest(places: Floats, corners: Floats) -> Floats:
    """Where each triangle (M, 3, 3) is nearest to its place (M, 3): the shares of its corners, (M, 3), which are
    exactly 0 for a corner that has none.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    u, v, away = b - a, c - a, places - a
    uu, uv, vv, up, vp = (_dot(p, q) for p, q in ((u, u), (u, v), (v, v), (u, away), (v, away)))
    area = uu * vv - uv * uv  # squared, times four
    safe = np.where(area > 1e-12 * uu * vv, area, 1.0)  # one without area has edges only
    second, third = (vv * up - uv * vp) / safe, (uu * vp - uv * up) / safe
    found = np.stack([1 - second - third, second, third], axis=1)
    outside = (area <= 1e-12 * uu * vv) | (found.min(axis=1) <= 0)

    best = np.full(len(places), np.inf)
    best[~outside] = -1.0
    for k in range(3):
        start, way = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        share = np.clip(_dot(places - start, way) / np.maximum(_dot(way, way), 1e-300), 0, 1)
        off = _dot(places - start - share[:, None] * way, places - start - share[:, None] * way)
        nearer = off < best
        found[nearer, k], found[nearer, (k + 1) % 3], found[nearer, (k + 2) % 3] = 1 - share[nearer], share[nearer], 0
        best[nearer] = off[nearer]
    return found


def _dot(a: Floats, b: Floats) -> Floats:
    product: Floats = np.einsum("ij,ij->i", a, b)
    return product


def _unit(vectors: Floats) -> Floats:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    units: Floats = np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)
    return units
