"""Meshes of a square sheet for tests, and OBJ files of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import Delaunay

from taichi_cloth.geometry import grid

Mesh = tuple[np.ndarray, np.ndarray]


def write_obj(path: Path, points: np.ndarray, faces: Iterable[Sequence[int]]) -> Path:
    lines = ["v " + " ".join(repr(float(c)) for c in point) for point in points]
    lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in faces]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def quads(rows: int, columns: int, width: float = 1.0, height: float = 1.0) -> Mesh:
    """Return the vertices of a grid in its order, (N, 3), and its cells as quads, (F, 4)."""
    index = grid.particle_indices(rows, columns)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    return grid.flat_positions(rows, columns, width, height), np.stack([a, b, c, d], axis=-1).reshape(-1, 4)


def irregular(columns: int, jitter: float, seed: int = 0) -> Mesh:
    """Return a square of nearly equilateral triangles, with interior vertices displaced by up to `jitter` edges."""
    random = np.random.default_rng(seed)
    edge = 1 / (columns - 1)
    rows = round(1 / (edge * np.sqrt(3) / 2))
    points = []
    for row in range(rows + 1):
        middle = (np.arange(columns - 1) + 0.5) * edge
        for x in np.linspace(0, 1, columns) if row % 2 == 0 else (0.0, *middle, 1.0):
            inner = 1e-9 < x < 1 - 1e-9 and 0 < row < rows
            points.append([x, row / rows] + inner * jitter * edge * random.uniform(-1, 1, 2))
    flat = np.array(points) - 0.5
    faces = Delaunay(flat).simplices
    u, v = flat[faces[:, 1]] - flat[faces[:, 0]], flat[faces[:, 2]] - flat[faces[:, 0]]
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    faces = np.where((area > 0)[:, None], faces, faces[:, ::-1])[np.abs(area) > 1e-6]
    return np.c_[flat, np.zeros(len(flat))], faces
