"""The cloth that all peers simulate, and the line of JSON that their scripts print.

The sheet has 1 m × 1 m and 0.2 kg/m². It is released at rest and level, and hangs by the two corners of its first row.
The stiffness is 2000 N per meter of width for peers with SI constants, and the default of other peers. Nothing
collides. A frame is 1/60 s; the setting of a peer defines its steps.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SIDE = 1.0  # [m]
AREA_DENSITY = 0.2  # [kg/m²]
STIFFNESS = 2000.0  # [N/m]
GRAVITY = 9.81  # [m/s²]
FRAME = 1 / 60  # [s]


@dataclass(frozen=True)
class Sheet:
    """The grid, row by row: rows run along +x, columns along −y, and z is up."""

    rows: int
    columns: int

    @property
    def points(self) -> Array:
        """Positions of the particles at the start [m], (rows·columns, 3)."""
        y, x = np.meshgrid(np.linspace(SIDE, 0, self.rows), np.linspace(0, SIDE, self.columns), indexing="ij")
        return np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)

    @property
    def triangles(self) -> NDArray[np.int32]:
        """Triangles, (T, 3): two per cell, with alternating diagonals, counter-clockwise seen from above."""
        index = np.arange(self.rows * self.columns, dtype=np.int32).reshape(self.rows, self.columns)
        a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]  # a b over c d
        falling = (np.indices(a.shape).sum(axis=0) % 2 == 0)[..., None, None]
        one = np.stack([np.stack([a, c, d], -1), np.stack([a, d, b], -1)], axis=-2)
        other = np.stack([np.stack([a, c, b], -1), np.stack([b, c, d], -1)], axis=-2)
        return np.where(falling, one, other).reshape(-1, 3).astype(np.int32)

    @property
    def masses(self) -> Array:
        """Masses [kg], (rows·columns,): each corner of a cell gets a quarter of its mass."""
        share = np.full((self.rows, self.columns), AREA_DENSITY * SIDE**2 / (self.rows - 1) / (self.columns - 1))
        share[[0, -1]] /= 2
        share[:, [0, -1]] /= 2
        return share.reshape(-1)

    @property
    def pins(self) -> tuple[int, int]:
        return 0, self.columns - 1

    def order_of(self, points: Array) -> NDArray[np.int64]:
        """Return the index of each particle of this sheet in a peer's list of the same points at the start."""
        order = np.full(self.rows * self.columns, -1)
        row = np.rint((SIDE - points[:, 1]) / SIDE * (self.rows - 1)).astype(int)
        column = np.rint(points[:, 0] / SIDE * (self.columns - 1)).astype(int)
        order[row * self.columns + column] = np.arange(len(points))
        if order.min() < 0:
            raise SystemExit("the peer does not have a particle at every point of the sheet")
        return order


def arguments(settings: list[str]) -> tuple[Sheet, int, str]:
    """Return sheet, frames and setting from the command line of a peer's script."""
    parser = argparse.ArgumentParser()
    parser.add_argument("rows", type=int)
    parser.add_argument("columns", type=int)
    parser.add_argument("frames", type=int)
    parser.add_argument("setting", choices=settings)
    args = parser.parse_args()
    return Sheet(args.rows, args.columns), args.frames, args.setting


def run(
    peer: str,
    version: str,
    setting: str,
    sheet: Sheet,
    frames: int,
    advance: Callable[[], object],
    positions: Callable[[], Array],
) -> None:
    """Run the frames and print the line. `positions` returns positions in the order and the axes of `sheet`.

    The first frame is not timed, because peers compile and allocate in it, nor is reading positions. Strain, lowest
    point [m] (the pins are at 0) and kinetic energy [J/kg] are those after the last frame.
    """
    milliseconds = []
    before = positions()
    now = before
    for _ in range(frames):
        before = now
        start = time.perf_counter()
        advance()
        milliseconds.append(1e3 * (time.perf_counter() - start))
        now = positions()
    timed = sorted(milliseconds[1:]) or milliseconds
    strain = largest_strain(sheet, now)
    speeds = (now - before) / FRAME  # [m/s] mean of the last frame, equal for all peers
    kinetic = 0.5 * float((sheet.masses * (speeds**2).sum(axis=1)).sum()) / (AREA_DENSITY * SIDE**2)
    line = {
        "peer": peer,
        "version": version,
        "rows": sheet.rows,
        "columns": sheet.columns,
        "setting": setting,
        "frames": frames,
        "median_ms": float(np.median(timed)),
        "p95_ms": timed[math.ceil(0.95 * len(timed)) - 1],
        "max_strain": strain,
        "lowest": float(now[:, 2].min()),
        "kinetic_per_kg": kinetic,
        "finite": bool(np.isfinite(now).all()),
    }
    print(json.dumps({key: None if value != value else value for key, value in line.items()}))


def largest_strain(sheet: Sheet, positions: Array) -> float:
    """Return the largest absolute strain between neighbors along rows and columns."""
    grid = positions.reshape(sheet.rows, sheet.columns, 3)
    down = np.linalg.norm(np.diff(grid, axis=0), axis=-1) * (sheet.rows - 1) / SIDE
    along = np.linalg.norm(np.diff(grid, axis=1), axis=-1) * (sheet.columns - 1) / SIDE
    return float(max(np.abs(down - 1).max(), np.abs(along - 1).max()))
