"""Maps and meshes that the hard cases read, written into a folder that is gone when the program ends.

A scene takes numbers for every particle, and cloth that is no sheet, from files alone.
"""

from __future__ import annotations

import atexit
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@cache
def folder() -> Path:
    kept = TemporaryDirectory(prefix="taichi_cloth_stress_")
    atexit.register(kept.cleanup)
    return Path(kept.name)


def half_map(cells: int) -> str:
    """Numbers for every particle of a square sheet: 1 in its left half and on the line between, 0 in its right."""
    column = np.tile(np.arange(cells + 1), cells + 1)
    numbers = np.where(column <= cells // 2, 1, 0)
    name = f"half_{cells}.csv"
    path = folder() / name
    if not path.exists():
        path.write_text("\n".join(map(str, numbers)) + "\n", encoding="utf-8")
    return name


def obj_file(name: str, points: Floats, faces: list[tuple[int, ...]]) -> Path:
    """An OBJ file of these points (N, 3) [m] and faces, whose corners count from 0."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
    lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in faces]
    path = folder() / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _triangles(cells: int, index: NDArray[np.int64]) -> list[tuple[int, ...]]:
    """Two triangles a cell of a sheet whose points have these numbers, (cells + 1, cells + 1)."""
    found: list[tuple[int, ...]] = []
    for row in range(cells):
        for column in range(cells):
            a, b = int(index[row, column]), int(index[row, column + 1])
            c, d = int(index[row + 1, column]), int(index[row + 1, column + 1])
            found += [(a, c, d), (a, d, b)]
    return found


def _sheet(cells: int) -> tuple[Floats, NDArray[np.int64]]:
    """Points of a sheet of 1 m (N, 3), and their numbers (cells + 1, cells + 1)."""
    across = np.linspace(-0.5, 0.5, cells + 1)
    y, x = np.meshgrid(-across, across, indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    return points, np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)


def plain(cells: int) -> Path:
    """Without a fault."""
    points, index = _sheet(cells)
    return obj_file("plain.obj", points, _triangles(cells, index))


def doubled_points(cells: int) -> Path:
    """A slit of half the sheet's height down the middle: two points at every place of it, on either side one."""
    points, index = _sheet(cells)
    left, middle = index.copy(), cells // 2
    slit = index[cells // 4 : 3 * cells // 4, middle]
    left[cells // 4 : 3 * cells // 4, middle] = len(points) + np.arange(len(slit))
    points = np.concatenate([points, points[slit]])
    faces: list[tuple[int, ...]] = []
    for k, face in enumerate(_triangles(cells, index)):
        column = k // 2 % cells
        faces.append(_triangles(cells, left)[k] if column < middle else face)
    return obj_file("doubled_points.obj", points, faces)


def zero_length(cells: int) -> Path:
    """A triangle's edge whose two ends are one place."""
    points, index = _sheet(cells)
    middle = cells // 2
    points[index[middle, middle + 1]] = points[index[middle, middle]]
    return obj_file("zero_length.obj", points, _triangles(cells, index))


def zero_area(cells: int) -> Path:
    """A triangle whose three corners are on one line, none at the place of another."""
    points, index = _sheet(cells)
    middle = cells // 2
    a, d = points[index[middle, middle]], points[index[middle + 1, middle + 1]]
    points[index[middle, middle + 1]] = (a + d) / 2
    return obj_file("zero_area.obj", points, _triangles(cells, index))


def slivers(cells: int) -> Path:
    """A row of triangles ten thousand times as long as they are high, in the middle of the sheet."""
    points, index = _sheet(cells)
    rows = points.reshape(cells + 1, cells + 1, 3)
    middle = cells // 2
    rows[middle + 1, :, 1] = rows[middle, :, 1] - 1 / cells / 1e4
    return obj_file("slivers.obj", points, _triangles(cells, index))


SLIVERS = "1:1e4 triangles"
MESHES: dict[str, Callable[[int], Path]] = {
    "doubled points": doubled_points,
    "zero-length springs": zero_length,
    "zero-area triangles": zero_area,
    SLIVERS: slivers,
}
