"""Bodies as triangle soups in NumPy: arrays of corners and normals, both (3·T, 3), outward sides counter-clockwise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Corners = NDArray[np.float64]


def _grid_corners(points: Corners) -> Corners:
    """Two triangles for every cell of a (rows, columns, 3) grid of points."""
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, :-1], points[1:, 1:]
    return np.stack([a, c, d, a, d, b], axis=2).reshape(-1, 3)


def unit_sphere(rings: int = 24) -> Corners:
    """A sphere of radius 1 around the origin; a corner is its own normal."""
    polar, around = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, 2 * rings + 1), indexing="ij"
    )
    return _grid_corners(
        np.stack([np.sin(polar) * np.sin(around), np.cos(polar), np.sin(polar) * np.cos(around)], axis=-1)
    )


def cylinder(start: Corners, end: Corners, radius: float, sides: int = 24) -> tuple[Corners, Corners]:
    """A round bar from `start` to `end` (each (3,) [m]) with flat ends."""
    axis = (end - start) / np.linalg.norm(end - start)
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    angle = np.linspace(0, 2 * np.pi, sides + 1)[:, None]
    spoke = np.cos(angle) * across + np.sin(angle) * np.cross(axis, across)
    side = _grid_corners(np.stack([end + radius * spoke, start + radius * spoke]))
    side_normal = _grid_corners(np.stack([spoke, spoke]))
    ends, end_normals = [], []
    for middle, rim, normal in ((start, spoke[::-1], -axis), (end, spoke, axis)):
        fan = np.stack(
            [np.broadcast_to(middle, (sides, 3)), middle + radius * rim[:-1], middle + radius * rim[1:]], axis=1
        )
        ends.append(fan.reshape(-1, 3))
        end_normals.append(np.broadcast_to(normal, (3 * sides, 3)))
    return np.concatenate([side, *ends]), np.concatenate([side_normal, *end_normals])


def capsule(half: float, radius: float) -> tuple[Corners, Corners]:
    """An upright bar with round ends; their middles are `half` [m] above and below the origin."""
    normals = unit_sphere()
    ends = np.array([0.0, half, 0.0]) * np.where(normals[:, 1:2] < -1e-9, -1.0, 1.0)
    return radius * normals + ends, normals


def box(center: Corners, size: Corners) -> tuple[Corners, Corners]:
    """A block around `center` with whole sides `size` (each (3,) [m])."""
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


def floor(middle: Corners, reach: float, cells: int = 80) -> Corners:
    """A level square around `middle` (3,) that ends `reach` [m] from it, finer where shadows fall."""
    u = np.linspace(-1, 1, cells + 1)
    line = reach * (0.25 * u + 0.75 * u**5)
    x, z = np.meshgrid(middle[0] + line, middle[2] + line)
    return _grid_corners(np.stack([x, np.full_like(x, middle[1]), z], axis=-1))


def floor_lines(middle: Corners, reach: float, spacing: float, width: float) -> Corners:
    """Lines along x and z at whole multiples of `spacing`, cut into pieces as long; lengths in m."""
    first, last = np.ceil((middle - reach) / spacing), np.floor((middle + reach) / spacing)
    x, z = (spacing * np.arange(first[k], last[k] + 1) for k in (0, 2))
    pieces = []
    for across, along, end in ((x, z, False), (z, x, True)):
        cuts = along
        a, b = np.meshgrid(across, cuts, indexing="ij")
        lines = np.stack([a[:, None] + np.array([[-width / 2], [width / 2]]), np.stack([b, b], axis=1)], axis=-1)
        points = np.insert(lines[..., ::-1] if end else lines, 1, middle[1], axis=-1)  # (lines, 2, cuts, 3)
        pieces += [_grid_corners(points[k]) for k in range(len(points))]
    return np.concatenate(pieces)
