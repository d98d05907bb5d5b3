"""Triangle and quad meshes of cloth from OBJ files, and the checks that they must pass. NumPy only.

Vertices keep their order: particle i is the i-th `v` of the file. So nothing is removed or merged, and anything that
cannot be cloth is an error that names its line.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..scene.presets import mesh_path
from .mesh_reader import Obj, ObjError, parse_obj
from .topology import adjacency

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FLAT = 1e-6  # smallest area of a triangle, relative to the square of its longest side
CACHE_SIZE = 8  # files in the cache


@dataclass(frozen=True, eq=False)
class ClothMesh:
    """A mesh of N vertices and F consistently oriented faces, centered on its bounding box."""

    vertices: Floats
    """Position of every vertex, in the unit of the file, (N, 3)."""
    faces: Ints
    """The vertices of every face, (F, 4); the last column is −1 for a triangle."""
    groups: dict[str, Ints]
    """Vertices of the faces under each name of a `g`, `o` or `usemtl` line."""
    uv: Floats | None
    """Texture coordinates `vt` of every vertex, (N, 2), the first in the file; None if any vertex has none."""

    @cached_property
    def is_quad(self) -> NDArray[np.bool_]:
        """Whether each face is a quad, (F,)."""
        return self.faces[:, 3] >= 0

    @cached_property
    def sides(self) -> tuple[Ints, Ints]:
        """The two ends of every directed side of every face, (S, 2), and the face of every side, (S,)."""
        return _sides(self.faces)

    @cached_property
    def edges(self) -> tuple[Ints, Ints]:
        """The undirected edges, lower vertex first, (E, 2), and the edge of every entry of `sides`, (S,)."""
        count = len(self.vertices)
        unique_keys, edge_of = np.unique(_keys(np.sort(self.sides[0], axis=1), count), return_inverse=True)
        return np.stack(np.divmod(unique_keys, count), axis=-1), edge_of

    @cached_property
    def graph_distance(self) -> tuple[Ints, int]:
        """Graph distance of every vertex from the first vertex of its connected component [edges], (N,).

        The second value is the number of connected components.
        """
        return _graph_distances(self.edges[0], len(self.vertices))

    @cached_property
    def triangles(self) -> NDArray[np.int32]:
        """The triangles, followed by two for each quad, (T, 3).

        Quads are cut like the cells of a grid, so that diagonals alternate: between vertices of even graph distance
        (`steps`).
        """
        quads = self.faces[self.is_quad]
        odd = self.graph_distance[0][quads[:, 0]] % 2 == 1
        quads = np.where(odd[:, None], np.roll(quads, -1, axis=1), quads)
        halves = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
        return np.concatenate([self.faces[~self.is_quad, :3], halves]).astype(np.int32)


def load_cloth_mesh(file: str, folder: str) -> ClothMesh:
    """Return a shipped mesh by name, or the mesh at a path relative to `folder`.

    Raises ObjError if the file cannot be used as cloth.
    """
    path = mesh_path(file, folder)
    try:
        status = path.stat()
    except (OSError, ValueError):  # `read_cloth` reports it
        return read_cloth(path)
    return _read_cached(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=CACHE_SIZE)
def _read_cached(path: Path, modified: int, size: int) -> ClothMesh:
    return read_cloth(path)


def read_cloth(path: Path) -> ClothMesh:
    """Return the cloth mesh of a file. Raises ObjError with the reason, its line, and how to correct it."""
    obj = parse_obj(path, texture=True)
    for k, face in enumerate(obj.faces):
        if len(face) > 4:
            reason = f"the face has {len(face)} corners, not 3 or 4: triangulate it when exporting"
            raise obj.error(k, reason)
    faces = np.array([(*face, -1)[:4] for face in obj.faces], np.int64)
    _check_points(obj, faces)
    _check_duplicates(obj, faces)
    _check_edges(obj, faces)
    _check_diagonals(obj, faces)
    _check_areas(obj, faces)
    low, high = obj.vertices.min(axis=0), obj.vertices.max(axis=0)
    return ClothMesh(obj.vertices - (low + high) / 2, faces, _groups(obj), _texture_coordinates(obj))


def _check_points(obj: Obj, faces: Ints) -> None:
    """Check that every vertex belongs to a face."""
    loose = np.ones(len(obj.vertices), bool)
    loose[faces[faces >= 0]] = False
    if loose.any():
        more = f", and {loose.sum() - 1} more" if loose.sum() > 1 else ""
        reason = f"vertex {loose.argmax() + 1} belongs to no face{more}: delete loose vertices"
        raise ObjError(obj.path, 0, reason)


def _check_duplicates(obj: Obj, faces: Ints) -> None:
    """Check that no two faces have the same vertices."""
    _, first, face_of = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_inverse=True)
    repeated = np.flatnonzero(first[face_of.reshape(-1)] != np.arange(len(faces)))
    if len(repeated):
        original = first[face_of.reshape(-1)[repeated[0]]]
        raise obj.error(
            int(repeated[0]), f"the face has the same vertices as that on line {obj.lines[original]}: delete one"
        )


def _check_edges(obj: Obj, faces: Ints) -> None:
    """Check that every edge belongs to one face, or to two that contain it in opposite directions.

    Messages count vertices from 1.
    """
    sides, owner = _sides(faces)
    count = len(obj.vertices)
    edges, edge_of, counts = np.unique(_keys(np.sort(sides, axis=1), count), return_inverse=True, return_counts=True)
    if counts.max() > 2:
        edge = int(counts.argmax())
        a, b = divmod(int(edges[edge]), count)
        lines = ", ".join(str(obj.lines[face]) for face in owner[edge_of == edge][:4])
        where = f"the edge from vertex {a + 1} to {b + 1} belongs to {counts[edge]} faces (lines {lines})"
        reason = f"{where}, not to one or two"
        raise ObjError(obj.path, 0, reason)
    _, first, side_of = np.unique(_keys(sides, count), return_index=True, return_inverse=True)
    repeated = np.flatnonzero(first[side_of] != np.arange(len(sides)))
    if len(repeated):
        side = int(repeated[0])
        a, b = sides[side] + 1
        line = obj.lines[owner[first[side_of[side]]]]
        reason = f"the face has the edge from vertex {a} to {b} in the same direction as the face on line {line}"
        raise obj.error(int(owner[side]), f"{reason}: make all normals point to the same side")


def _check_diagonals(obj: Obj, faces: Ints) -> None:
    """Check that no face has an edge along a diagonal of a quad, and that no two quads share a diagonal.

    A quad may be cut along either diagonal.
    """
    count = len(obj.vertices)
    quads = np.flatnonzero(faces[:, 3] >= 0)
    ends = np.concatenate([faces[quads][:, [0, 2]], faces[quads][:, [1, 3]]])
    diagonals = _keys(np.sort(ends, axis=1), count)
    edges = _keys(np.sort(_sides(faces)[0], axis=1), count)
    _, first, diagonal_of = np.unique(diagonals, return_index=True, return_inverse=True)
    conflicts = np.flatnonzero(np.isin(diagonals, edges) | (first[diagonal_of] != np.arange(len(diagonals))))
    if len(conflicts):
        a, b = ends[conflicts[0]] + 1
        reason = f"vertices {a} and {b} are opposite corners of the quad, and another face connects them"
        raise obj.error(int(np.tile(quads, 2)[conflicts[0]]), f"{reason}: triangulate the quad, or delete that face")


def _check_areas(obj: Obj, faces: Ints) -> None:
    """Check that no triangle, and no half of a quad along either diagonal, is degenerate or flipped."""
    quads = np.flatnonzero(faces[:, 3] >= 0)
    triangles = np.flatnonzero(faces[:, 3] < 0)
    quad_corners = faces[quads][:, [[0, 1, 2], [1, 2, 3], [2, 3, 0], [3, 0, 1]]].reshape(-1, 3)
    corners = obj.vertices[np.concatenate([faces[triangles, :3], quad_corners])]
    owner = np.concatenate([triangles, quads.repeat(4)])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    longest = ((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max(axis=1)
    degenerate = np.flatnonzero(np.linalg.norm(normals, axis=1) <= FLAT * longest)
    if len(degenerate):
        face = int(owner[degenerate[0]])
        points = ", ".join(str(p + 1) for p in faces[face] if p >= 0)
        raise obj.error(
            face, f"the face of vertices {points} has a corner of zero area: merge vertices that are too close"
        )
    quad_normals = normals[len(triangles) :].reshape(-1, 4, 3)
    reflex = np.flatnonzero(((quad_normals * quad_normals.sum(axis=1, keepdims=True)).sum(axis=2) <= 0).any(axis=1))
    if len(reflex):
        raise obj.error(int(quads[reflex[0]]), "the quad is not convex: cut it into triangles")


def _groups(obj: Obj) -> dict[str, Ints]:
    """Return the vertices of each name.

    A `g`, `o` or `usemtl` line applies to all faces up to the next line of its kind.
    """
    groups: dict[str, list[int]] = {}
    for kind in ("g", "o", "usemtl"):
        lines = [(first, names) for first, which, names in obj.marks if which == kind]
        ends = [first for first, _ in lines[1:]] + [len(obj.faces)]
        for (first, names), end in zip(lines, ends, strict=False):
            points = [point for face in obj.faces[first:end] for point in face]
            for name in names:
                groups.setdefault(name, []).extend(points)
    return {name: np.unique(np.array(points, np.int64)) for name, points in groups.items() if points}


def _texture_coordinates(obj: Obj) -> Floats | None:
    """Return the first texture coordinates of every vertex, (N, 2), or None if any vertex has none."""
    coordinates = np.full((len(obj.vertices), 2), np.nan)
    for face, indices in zip(reversed(obj.faces), reversed(obj.texture_faces), strict=True):
        if indices:
            coordinates[list(face)] = obj.texture[list(indices)]
    return None if np.isnan(coordinates).any() else coordinates


def _sides(faces: Ints) -> tuple[Ints, Ints]:
    """Return the ends of the directed sides of all faces, (S, 2), and the face of every side, (S,)."""
    is_quad = faces[:, 3] >= 0
    last = np.where(is_quad, faces[:, 3], faces[:, 2])
    ends = [(faces[:, 0], faces[:, 1]), (faces[:, 1], faces[:, 2]), (faces[:, 2], faces[:, 3]), (last, faces[:, 0])]
    sides = np.stack([np.stack(pair, axis=-1) for pair in ends], axis=1)
    exists = np.ones(sides.shape[:2], bool)
    exists[:, 2] = is_quad
    return sides[exists], np.nonzero(exists)[0]


def _keys(pairs: Ints, count: int) -> Ints:
    """Return one number for each pair of `count` vertices."""
    return pairs[:, 0] * count + pairs[:, 1]


def _graph_distances(edges: Ints, count: int) -> tuple[Ints, int]:
    """Return the graph distance of every vertex from the first of its component, (N,), and the number of components."""
    first, rows = adjacency(edges.astype(np.int32), count)
    neighbors = (edges[rows].sum(axis=1) - np.repeat(np.arange(count), np.diff(first))).tolist()
    starts, distances, components = first.tolist(), [-1] * count, 0
    for start in range(count):
        if distances[start] >= 0:
            continue
        components += 1
        distances[start] = 0
        queue = [start]
        for point in queue:  # grows during the loop (breadth-first search)
            for other in neighbors[starts[point] : starts[point + 1]]:
                if distances[other] < 0:
                    distances[other] = distances[point] + 1
                    queue.append(other)
    return np.array(distances), components
