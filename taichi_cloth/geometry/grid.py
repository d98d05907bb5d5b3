"""Rectangular sheets as arrays: positions of particles, triangles, and springs by direction. NumPy only."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ..scene.keys import CORNERS

NO_GRID = (0, 0)  # `Topology.shape` of a mesh file

# The six spring directions of a sheet: family, step down the rows, step along the columns.
DIRECTIONS = (
    ("structural", 0, 1),
    ("structural", 1, 0),
    ("shear", 1, 1),
    ("shear", 1, -1),
    ("bend", 0, 2),
    ("bend", 2, 0),
)
# Two colors per direction.
MAX_COLORS, MAX_BEND_COLORS = 2 * len(DIRECTIONS), 2 * sum(family == "bend" for family, _, _ in DIRECTIONS)


def particle_indices(rows: int, columns: int) -> NDArray[np.int32]:
    """Return the index of every particle, (rows, columns): row by row from the top left corner."""
    return np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)


def cell_aspect(rows: int, columns: int, width: float, height: float) -> float:
    """Return the height of a cell divided by its width."""
    return (height / (rows - 1)) / (width / (columns - 1))


def flat_positions(rows: int, columns: int, width: float, height: float) -> NDArray[np.float64]:
    """Return the positions in the flat sheet [m], (rows·columns, 3): in the plane z = 0, centered at the origin."""
    y, x = np.meshgrid(
        np.linspace(height / 2, -height / 2, rows), np.linspace(-width / 2, width / 2, columns), indexing="ij"
    )
    return np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)


def particle_uv(rows: int, columns: int) -> NDArray[np.float64]:
    """Return the texture coordinates of every particle, 0…1 from the left and from the bottom, (rows·columns, 2)."""
    v, u = np.meshgrid(np.linspace(1, 0, rows), np.linspace(0, 1, columns), indexing="ij")
    return np.stack([u, v], axis=-1).reshape(-1, 2)


def rotation_matrix(degrees: tuple[float, float, float]) -> NDArray[np.float64]:
    """Return the 3×3 matrix that rotates about x, then y, then z by these angles [degrees].

    Right angles are exact, so a level sheet is level to the last bit.
    """
    matrix = np.eye(3)
    for axis, angle in enumerate(degrees):
        if angle == 0:
            continue
        cos, sin = np.round((np.cos(np.radians(angle)), np.sin(np.radians(angle))), 15)
        rotation = np.eye(3)
        j, k = (axis + 1) % 3, (axis + 2) % 3
        rotation[[j, j, k, k], [j, k, j, k]] = cos, -sin, sin, cos
        matrix = rotation @ matrix
    return matrix


def triangles(rows: int, columns: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return two triangles per cell, (T, 3), and the row and column of each triangle's cell, (T, 2).

    Cells are cut along alternating diagonals, so the sheet has no preferred direction.
    """
    index = particle_indices(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]  # a b over c d
    cell = np.stack(np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij"), axis=-1)
    falling = (cell.sum(axis=-1) % 2 == 0)[..., None, None]
    cut = np.where(
        falling,
        np.stack([np.stack([a, c, d], -1), np.stack([a, d, b], -1)], axis=-2),
        np.stack([np.stack([a, c, b], -1), np.stack([b, c, d], -1)], axis=-2),
    )
    return cut.reshape(-1, 3).astype(np.int32), cell.repeat(2, axis=1).reshape(-1, 2).astype(np.int32)


def springs(
    rows: int, columns: int, down: int, along: int, *, alternate: bool = False
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return all springs of one direction as two batches of particle pairs, each (E, 2).

    No two springs of a batch share a particle: consecutive springs of a line alternate between the batches. With
    `alternate`, only the diagonals along which `triangles` cuts the cells are returned.
    """
    index = particle_indices(rows, columns)
    mirrored = along < 0
    if mirrored:  # rising diagonals are falling diagonals of the mirrored sheet
        index, along = index[:, ::-1], -along
    start = index[: rows - down, : columns - along]
    end = index[down:, along:]
    row, column = np.indices(start.shape)
    number = row // down if down else column // along  # number of the spring in its line
    pairs = np.stack([start, end], axis=-1)
    cell = columns - 2 - column if mirrored else column
    chosen = (row + cell) % 2 == mirrored if alternate else np.full(start.shape, True)
    return pairs[chosen & (number % 2 == 0)], pairs[chosen & (number % 2 == 1)]


def to_grid(
    shape: tuple[int, int], direction: NDArray[np.int64], ends: NDArray[np.int32], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Arrange values of particle pairs, (E,), by direction and position, (6, rows, columns).

    The position is the upper left corner of the box around both particles. Entries without a pair are zero.
    """
    rows, columns = np.unravel_index(ends, shape)
    result = np.zeros((len(DIRECTIONS), *shape))
    result[direction, rows.min(axis=1), columns.min(axis=1)] = values
    return result


def on_boundary(rows: int, columns: int, ends: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return which springs lie on an edge of the sheet, (E,)."""
    row, column = np.unravel_index(ends, (rows, columns))
    sides = [row == 0, row == rows - 1, column == 0, column == columns - 1]
    edge: NDArray[np.bool_] = np.any([side.all(axis=1) for side in sides], axis=0)
    return edge


def pinned_mask(rows: int, columns: int, pins: Iterable[str | int]) -> NDArray[np.bool_]:
    """Return which particles are pinned, (rows·columns,). `pins`: names of edges and corners, and particle indices.

    Raises ValueError for an unknown name and for an index outside the sheet.
    """
    pinned = np.zeros((rows, columns), dtype=bool)
    index_of = {"top": 0, "bottom": -1, "left": 0, "right": -1}
    for pin in pins:
        if isinstance(pin, int):
            if not 0 <= pin < rows * columns:
                raise ValueError(f"pin {pin} is not a particle: indices run from 0 to {rows * columns - 1}")
            pinned.flat[pin] = True
        elif pin in CORNERS:
            row, column = pin.split("-")
            pinned[index_of[row], index_of[column]] = True
        elif pin in ("top", "bottom"):
            pinned[index_of[pin], :] = True
        elif pin in ("left", "right"):
            pinned[:, index_of[pin]] = True
        else:
            raise ValueError(f"pin {pin!r} is not an edge, a corner or a particle index")
    return pinned.reshape(-1)
