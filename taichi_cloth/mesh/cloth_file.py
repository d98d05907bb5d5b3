"""An OBJ file that is to be cloth: triangles and quads, and what must be right about them. NumPy only.

Points keep their order: particle i is the i-th `v` of the file. So nothing is left out or joined, and what no cloth can
be made of is told with its line.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..scene.library import mesh_path
from .incidence import incidence
from .obj import Obj, ObjError, parse_obj

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

FLAT = 1e-6  # area that is none, in squares of a triangle's longest side
KEPT = 8  # files


@dataclass(frozen=True, eq=False)
class ClothFile:
    """N points around the middle of the box that holds them, and F faces whose normals look to one side."""

    points: Floats  # (N, 3) in the file's unit
    faces: Whole  # (F, 4) −1 in the last column: a triangle
    groups: dict[str, Whole]  # points of the faces of each `g`, `o` and `usemtl`
    spots: Floats | None  # (N, 2) `vt` of each point, the first one that it has; None where some have none

    @cached_property
    def is_quad(self) -> NDArray[np.bool_]:
        """(F,)"""
        return self.faces[:, 3] >= 0

    @cached_property
    def sides(self) -> tuple[Whole, Whole]:
        """The two ends of every side of every face, in its direction, (S, 2), and its face, (S,)."""
        return _sides(self.faces)

    @cached_property
    def edges(self) -> tuple[Whole, Whole]:
        """The sides, each once with its lower point first, (E, 2), and which of them each of `sides` is, (S,)."""
        count = len(self.points)
        keys, which = np.unique(_keys(np.sort(self.sides[0], axis=1), count), return_inverse=True)
        return np.stack(np.divmod(keys, count), axis=-1), which

    @cached_property
    def steps(self) -> tuple[Whole, int]:
        """How many edges each point is from the first one of its piece, (N,), and how many pieces there are."""
        return _steps(self.edges[0], len(self.points))

    @cached_property
    def triangles(self) -> NDArray[np.int32]:
        """(T, 3) the triangles, then two of each quad, cut as a grid's are: between points that are an even number of
        edges from the first one, so that diagonals alternate.
        """
        quads = self.faces[self.is_quad]
        turned = self.steps[0][quads[:, 0]] % 2 == 1
        quads = np.where(turned[:, None], np.roll(quads, -1, axis=1), quads)
        halves = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
        return np.concatenate([self.faces[~self.is_quad, :3], halves]).astype(np.int32)


def cloth_file(file: str, folder: str) -> ClothFile:
    """A shipped mesh by name, or a path as a scene in `folder` gives it. Raises ObjError as `read_cloth` does."""
    path = mesh_path(file, folder)
    try:
        about = path.stat()
    except (OSError, ValueError):  # told by the reader
        return read_cloth(path)
    return _kept(path, about.st_mtime_ns, about.st_size)


@lru_cache(maxsize=KEPT)
def _kept(path: Path, written: int, size: int) -> ClothFile:
    return read_cloth(path)


def read_cloth(path: Path) -> ClothFile:
    """The cloth of a file. Raises ObjError: what is wrong, on which line, and what to do."""
    obj = parse_obj(path, texture=True)
    for k, face in enumerate(obj.faces):
        if len(face) > 4:
            reason = (
                f"a face of {len(face)} corners: cloth is made of triangles and quads; triangulate it when exporting"
            )
            raise obj.error(k, reason)
    faces = np.array([(*face, -1)[:4] for face in obj.faces], np.int64)
    _check_points(obj, faces)
    _check_twins(obj, faces)
    _check_edges(obj, faces)
    _check_diagonals(obj, faces)
    _check_areas(obj, faces)
    low, high = obj.points.min(axis=0), obj.points.max(axis=0)
    return ClothFile(obj.points - (low + high) / 2, faces, _groups(obj), _spots(obj))


def _check_points(obj: Obj, faces: Whole) -> None:
    loose = np.ones(len(obj.points), bool)
    loose[faces[faces >= 0]] = False
    if loose.any():
        more = f", and {loose.sum() - 1} more" if loose.sum() > 1 else ""
        reason = f"point {loose.argmax() + 1} belongs to no face{more}: delete loose points"
        raise ObjError(obj.path, 0, reason)


def _check_twins(obj: Obj, faces: Whole) -> None:
    _, first, which = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_inverse=True)
    again = np.flatnonzero(first[which.reshape(-1)] != np.arange(len(faces)))
    if len(again):
        before = first[which.reshape(-1)[again[0]]]
        raise obj.error(int(again[0]), f"the face has the points of that on line {obj.lines[before]}: delete one")


def _check_edges(obj: Obj, faces: Whole) -> None:
    """An edge belongs to one face, or to two that pass it in opposite directions. Points are counted from 1."""
    sides, owner = _sides(faces)
    count = len(obj.points)
    once, which, times = np.unique(_keys(np.sort(sides, axis=1), count), return_inverse=True, return_counts=True)
    if times.max() > 2:
        edge = int(times.argmax())
        a, b = divmod(int(once[edge]), count)
        lines = ", ".join(str(obj.lines[face]) for face in owner[which == edge][:4])
        where = f"the edge from point {a + 1} to {b + 1} belongs to {times[edge]} faces (lines {lines})"
        reason = f"{where}: a cloth's to two at most"
        raise ObjError(obj.path, 0, reason)
    _, first, same = np.unique(_keys(sides, count), return_index=True, return_inverse=True)
    again = np.flatnonzero(first[same] != np.arange(len(sides)))
    if len(again):
        side = int(again[0])
        a, b = sides[side] + 1
        line = obj.lines[owner[first[same[side]]]]
        reason = f"the face passes the edge from point {a} to {b} in the same direction as that on line {line}"
        raise obj.error(int(owner[side]), f"{reason}: make all normals look to one side")


def _check_diagonals(obj: Obj, faces: Whole) -> None:
    """No face has an edge along a diagonal of a quad, and no two quads share a diagonal: either may be cut there."""
    count = len(obj.points)
    quads = np.flatnonzero(faces[:, 3] >= 0)
    ends = np.concatenate([faces[quads][:, [0, 2]], faces[quads][:, [1, 3]]])
    cuts = _keys(np.sort(ends, axis=1), count)
    edges = _keys(np.sort(_sides(faces)[0], axis=1), count)
    _, first, same = np.unique(cuts, return_index=True, return_inverse=True)
    taken = np.flatnonzero(np.isin(cuts, edges) | (first[same] != np.arange(len(cuts))))
    if len(taken):
        a, b = ends[taken[0]] + 1
        reason = f"points {a} and {b} are opposite corners of the quad, and another face joins them"
        raise obj.error(int(np.tile(quads, 2)[taken[0]]), f"{reason}: triangulate the quad, or delete that face")


def _check_areas(obj: Obj, faces: Whole) -> None:
    """No triangle, and no half of a quad whichever way it is cut, is without area or turned over."""
    quads = np.flatnonzero(faces[:, 3] >= 0)
    plain = np.flatnonzero(faces[:, 3] < 0)
    quarters = faces[quads][:, [[0, 1, 2], [1, 2, 3], [2, 3, 0], [3, 0, 1]]].reshape(-1, 3)
    corners = obj.points[np.concatenate([faces[plain, :3], quarters])]
    owner = np.concatenate([plain, quads.repeat(4)])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    longest = ((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max(axis=1)
    empty = np.flatnonzero(np.linalg.norm(normals, axis=1) <= FLAT * longest)
    if len(empty):
        face = int(owner[empty[0]])
        points = ", ".join(str(p + 1) for p in faces[face] if p >= 0)
        raise obj.error(face, f"the face of points {points} has a corner without area: merge points that are too near")
    bent = normals[len(plain) :].reshape(-1, 4, 3)
    turned = np.flatnonzero(((bent * bent.sum(axis=1, keepdims=True)).sum(axis=2) <= 0).any(axis=1))
    if len(turned):
        raise obj.error(int(quads[turned[0]]), "the quad has a corner that looks inwards: cut it into triangles")


def _groups(obj: Obj) -> dict[str, Whole]:
    """Points of each name; lines of a kind hold until the next of that kind."""
    found: dict[str, list[int]] = {}
    for kind in ("g", "o", "usemtl"):
        marks = [(first, names) for first, which, names in obj.marks if which == kind]
        ends = [first for first, _ in marks[1:]] + [len(obj.faces)]
        for (first, names), end in zip(marks, ends, strict=False):
            points = [point for face in obj.faces[first:end] for point in face]
            for name in names:
                found.setdefault(name, []).extend(points)
    return {name: np.unique(np.array(points, np.int64)) for name, points in found.items() if points}


def _spots(obj: Obj) -> Floats | None:
    spots = np.full((len(obj.points), 2), np.nan)
    for face, told in zip(reversed(obj.faces), reversed(obj.texture_faces), strict=True):
        if told:
            spots[list(face)] = obj.texture[list(told)]
    return None if np.isnan(spots).any() else spots


def _sides(faces: Whole) -> tuple[Whole, Whole]:
    is_quad = faces[:, 3] >= 0
    last = np.where(is_quad, faces[:, 3], faces[:, 2])
    ways = [(faces[:, 0], faces[:, 1]), (faces[:, 1], faces[:, 2]), (faces[:, 2], faces[:, 3]), (last, faces[:, 0])]
    sides = np.stack([np.stack(way, axis=-1) for way in ways], axis=1)
    kept = np.ones(sides.shape[:2], bool)
    kept[:, 2] = is_quad
    return sides[kept], np.nonzero(kept)[0]


def _keys(pairs: Whole, count: int) -> Whole:
    """One number for each pair of `count` points."""
    return pairs[:, 0] * count + pairs[:, 1]


def _steps(edges: Whole, count: int) -> tuple[Whole, int]:
    first, rows = incidence(edges.astype(np.int32), count)
    beside = (edges[rows].sum(axis=1) - np.repeat(np.arange(count), np.diff(first))).tolist()
    begin, steps, pieces = first.tolist(), [-1] * count, 0
    for start in range(count):
        if steps[start] >= 0:
            continue
        pieces += 1
        steps[start] = 0
        queue = [start]
        for point in queue:  # grows as neighbours are found
            for other in beside[begin[point] : begin[point + 1]]:
                if steps[other] < 0:
                    steps[other] = steps[point] + 1
                    queue.append(other)
    return np.array(steps), pieces
