"""A rectangular sheet as arrays: where its particles start, its triangles and its springs by family."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ..scene.model import CORNERS

# The six directions in which a sheet has springs: family, step down the rows, step along the columns.
DIRECTIONS = (
    ("structural", 0, 1),
    ("structural", 1, 0),
    ("shear", 1, 1),
    ("shear", 1, -1),
    ("bend", 0, 2),
    ("bend", 2, 0),
)
# Two colours in each direction.
MOST_BATCHES, MOST_BENDS = 2 * len(DIRECTIONS), 2 * sum(family == "bend" for family, _, _ in DIRECTIONS)


def particle_indices(rows: int, columns: int) -> NDArray[np.int32]:
    """Index of each particle, shape (rows, columns): row by row from the top-left corner."""
    return np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)


def flat_positions(rows: int, columns: int, width: float, height: float) -> NDArray[np.float64]:
    """The unturned sheet around the origin in the plane z = 0 [m], shape (rows·columns, 3)."""
    y, x = np.meshgrid(
        np.linspace(height / 2, -height / 2, rows), np.linspace(-width / 2, width / 2, columns), indexing="ij"
    )
    return np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)


def spots(rows: int, columns: int) -> NDArray[np.float64]:
    """Where on a picture each particle is: 0…1 from the left and from the bottom, (rows·columns, 2)."""
    v, u = np.meshgrid(np.linspace(1, 0, rows), np.linspace(0, 1, columns), indexing="ij")
    return np.stack([u, v], axis=-1).reshape(-1, 2)


def rotation_matrix(degrees: tuple[float, float, float]) -> NDArray[np.float64]:
    """3×3 matrix that turns about x, then y, then z by the given angles.

    Right angles come out exact, so that a level sheet is level to the last bit.
    """
    matrix = np.eye(3)
    for axis, angle in enumerate(degrees):
        if angle == 0:
            continue
        cos, sin = np.round((np.cos(np.radians(angle)), np.sin(np.radians(angle))), 15)
        turn = np.eye(3)
        j, k = (axis + 1) % 3, (axis + 2) % 3
        turn[[j, j, k, k], [j, k, j, k]] = cos, -sin, sin, cos
        matrix = turn @ matrix
    return matrix


def triangles(rows: int, columns: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Two triangles a cell, shape (T, 3), and the (row, column) of each one's cell, shape (T, 2).

    The cells are cut along alternating diagonals, so that the sheet has no favoured direction.
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
    """All springs of one direction as two batches of index pairs, each of shape (E, 2).

    No two springs of a batch share a particle: springs of one chain alternate between the batches.
    `alternate` leaves only the diagonals along which `triangles` cuts the cells.
    """
    index = particle_indices(rows, columns)
    mirrored = along < 0
    if mirrored:  # the other diagonal is this one on the mirrored sheet
        index, along = index[:, ::-1], -along
    start = index[: rows - down, : columns - along]
    end = index[down:, along:]
    row, column = np.indices(start.shape)
    place = row // down if down else column // along  # number of the spring within its chain
    pairs = np.stack([start, end], axis=-1)
    cell = columns - 2 - column if mirrored else column
    wanted = (row + cell) % 2 == mirrored if alternate else np.full(start.shape, True)
    return pairs[wanted & (place % 2 == 0)], pairs[wanted & (place % 2 == 1)]


def by_place(
    shape: tuple[int, int], direction: NDArray[np.int64], ends: NDArray[np.int32], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Numbers of pairs of particles as (6, rows, columns): by direction and the upper left of the pair's place.

    Zero where there is no pair.
    """
    rows, columns = np.unravel_index(ends, shape)
    grids = np.zeros((len(DIRECTIONS), *shape))
    grids[direction, rows.min(axis=1), columns.min(axis=1)] = values
    return grids


def along_edge(rows: int, columns: int, ends: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Which springs run along an edge of the sheet, shape (E,)."""
    row, column = np.unravel_index(ends, (rows, columns))
    on = [row == 0, row == rows - 1, column == 0, column == columns - 1]
    edge: NDArray[np.bool_] = np.any([side.all(axis=1) for side in on], axis=0)
    return edge


def pinned(rows: int, columns: int, pins: Iterable[str | int]) -> NDArray[np.bool_]:
    """Which particles are held: edges and corners by name, particles by index; shape (rows·columns,).

    Raises ValueError for a name that is neither and for an index beyond the sheet.
    """
    held = np.zeros((rows, columns), dtype=bool)
    at = {"top": 0, "bottom": -1, "left": 0, "right": -1}
    for pin in pins:
        if isinstance(pin, int):
            if not 0 <= pin < rows * columns:
                raise ValueError(f"pin {pin} is not a particle: indices run from 0 to {rows * columns - 1}")
            held.flat[pin] = True
        elif pin in CORNERS:
            row, column = pin.split("-")
            held[at[row], at[column]] = True
        elif pin in ("top", "bottom"):
            held[at[pin], :] = True
        elif pin in ("left", "right"):
            held[:, at[pin]] = True
        else:
            raise ValueError(f"pin {pin!r} is neither an edge, a corner nor an index")
    return held.reshape(-1)
