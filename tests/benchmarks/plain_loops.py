"""The cloths of benchmarks/floor as plain loops in float64: the same equations, no shared code."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Spring = tuple[int, int, float, float]  # first particle, second particle, rest length [m], stiffness

FRAME = 1 / 60  # [s]
GRAVITY = 9.81  # [m/s²]
FABRIC = (2000.0, 1000.0, 20.0)  # [N/m] structural, shear and bend springs of `explicit.c`
DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))  # rows down, columns right, in sweep order


@dataclass
class Cloth:
    x: Array  # [m] (N, 3)
    inverse_mass: Array  # [1/kg] (N,)
    rows: int
    columns: int
    side: float  # [m] of a cell


def cloth(rows: int, columns: int, width: float, corner: tuple[float, float, float], down: Array) -> Cloth:
    side = width / (columns - 1)
    x = np.array(
        [np.array(corner) + side * (j * np.array([1, 0, 0]) + i * down) for i in range(rows) for j in range(columns)]
    )
    mass = np.zeros(rows * columns)
    for corners in triangles(rows, columns):
        mass[corners] += 0.2 * side**2 / 2 / 3
    return Cloth(x, 1 / mass, rows, columns, side)


def triangles(rows: int, columns: int) -> list[list[int]]:
    """Return two triangles per cell, with corners a b above c d, cut along alternating diagonals."""
    found = []
    for i in range(rows - 1):
        for j in range(columns - 1):
            a, b = i * columns + j, i * columns + j + 1
            c, d = a + columns, b + columns
            found += [[a, c, d], [a, d, b]] if (i + j) % 2 == 0 else [[a, c, b], [b, c, d]]
    return found


def springs_by_color(cloth: Cloth, stiffness: tuple[float, float, float]) -> list[Spring]:
    """Return springs by direction; in each, first those with even indices in their chain, then the odd ones."""
    order: list[Spring] = []
    for number, (down, right) in enumerate(DIRECTIONS):
        for odd in (0, 1):
            for i in range(cloth.rows - down):
                for j in range(max(0, -right), cloth.columns - max(0, right)):
                    index = i // down if down else j // right
                    if index % 2 == odd:
                        order.append(_spring(cloth, i, j, down, right, stiffness[number // 2]))
    return order


def springs_in_grid_order(cloth: Cloth, stiffness: tuple[float, float, float]) -> list[Spring]:
    """Return springs by particle, row by row, each with its springs to the right and down."""
    return [
        _spring(cloth, i, j, down, right, stiffness[number // 2])
        for i in range(cloth.rows)
        for j in range(cloth.columns)
        for number, (down, right) in enumerate(DIRECTIONS)
        if i + down < cloth.rows and 0 <= j + right < cloth.columns
    ]


def _spring(cloth: Cloth, i: int, j: int, down: int, right: int, stiffness: float) -> Spring:
    first = i * cloth.columns + j
    return first, first + down * cloth.columns + right, cloth.side * float(np.hypot(down, right)), stiffness


def relax_frames(
    rows: int,
    columns: int,
    substeps: int,
    iterations: int,
    frames: int,
    *,
    by_color: bool = True,
    wind: bool = True,
    ball: bool = True,
) -> Array:
    """Return positions of the curtain of `relax.c` (springs by color) and `frame.mjs` (grid order)."""
    c = cloth(rows, columns, 4.35, (-4.35 / 2, 3.975, 0), np.array([0, -1, 0]))
    c.inverse_mass[:columns] = 0
    order = (springs_by_color if by_color else springs_in_grid_order)(c, (1, 1, 0.05))
    x, before, w, h = c.x, c.x.copy(), c.inverse_mass, FRAME / substeps
    free = w > 0
    for substep in range(1, frames * substeps + 1):
        a = w[:, None] * (air_forces(c, (x - before) / h) if wind else 0) - [0, GRAVITY, 0]
        moved = (x - before) * np.exp(-1.5 * h)
        before = x.copy()
        x[free] += moved[free] + a[free] * h**2
        turns = 2 * np.pi * substep * h
        center = np.array([1.3 * np.sin(turns / 11), 1.3 + 0.2 * np.sin(turns / 7), 1.7 * np.cos(turns / 6)])
        for _ in range(iterations):
            for i, j, rest, stiffness in order:
                gap = x[j] - x[i]
                if w[i] + w[j] > 0:
                    part = stiffness * (1 - rest / np.linalg.norm(gap)) / (w[i] + w[j])
                    x[i] += gap * part * w[i]
                    x[j] -= gap * part * w[j]
            if ball:
                away = x - center
                distance = np.linalg.norm(away, axis=1)
                inside = free & (distance < 0.75)
                x[inside] = center + away[inside] * (0.75 / distance[inside, None])
    return x


def air_forces(c: Cloth, v: Array) -> Array:
    """Return the force [N] on each particle: drag and lift of ½·ρ·A·u² on two triangles per cell, C_D = C_L = 1."""
    force = np.zeros_like(c.x)
    for corners in triangles(c.rows, c.columns):
        p, q, r = c.x[corners]
        normal = np.cross(q - p, r - p) / 2
        area = np.linalg.norm(normal)
        air = np.array([0.4, 0, 0.9]) - v[corners].mean(axis=0)
        speed = np.linalg.norm(air)
        along, normal = air / speed, normal / area
        cos = normal @ along
        drag = cos * cos * along
        lift = cos * (normal - cos * along)
        force[corners] += 0.5 * 1.225 * area * speed**2 * (drag + lift) / 3
    return force


def along_edge(c: Cloth, i: int, j: int) -> bool:
    """Return whether a spring between two particles is on an edge of the sheet."""
    (row, column), (other_row, other_column) = divmod(i, c.columns), divmod(j, c.columns)
    return (row == other_row and row in (0, c.rows - 1)) or (column == other_column and column in (0, c.columns - 1))


def explicit_frames(rows: int, columns: int, substeps: int, frames: int) -> Array:
    """Return positions of the sheet of `explicit.c`: released horizontally, pinned at two corners."""
    c = cloth(rows, columns, 1.45, (-1.45 / 2, 1.0, 0), np.array([0, 0, 1]))
    c.inverse_mass[[0, columns - 1]] = 0
    springs = [(i, j, rest, k * (0.5 if along_edge(c, i, j) else 1.0)) for i, j, rest, k in springs_by_color(c, FABRIC)]
    x, v, w, h = c.x, np.zeros_like(c.x), c.inverse_mass, FRAME / substeps
    for substep in range(frames * substeps):
        force = np.zeros_like(x)
        for i, j, rest, k in springs:
            gap = x[j] - x[i]
            pull = k * (1 - rest / np.linalg.norm(gap)) * gap
            force[i] += pull
            force[j] -= pull
        a = force * w[:, None] - np.where(w[:, None] > 0, [0, GRAVITY, 0], 0)
        v[:] = v * np.exp(-1.0 * h) + (h if substep else h / 2) * a
        x += h * v
    return x
