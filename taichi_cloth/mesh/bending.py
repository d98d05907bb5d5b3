"""Resistance to bending as linear bonds between particles. NumPy only.

A thin sheet that bends without stretching has the energy ½·B·∫(w_xx² + w_yy² + 2·w_xy²) over its area (an isotropic
plate; a woven one has no Poisson effect to speak of), with second derivatives of its places. On a grid they are
x_i−1 − 2·x_i + x_i+1 along both threads, and x_00 − x_01 − x_10 + x_11 over a cell. That is quadratic in the places
(Bergou et al. 2006, *A quadratic bending model for inextensible surfaces*), and a sum over pairs:

    |x_0 − 2·x_1 + x_2|²         = 2·|x_0 − x_1|² + 2·|x_1 − x_2|² − |x_0 − x_2|²
    |x_00 − x_01 − x_10 + x_11|² = |·|² of the four sides − |·|² of the two diagonals

So a sheet bends as if bonds of no length, of which some push, joined its particles: forces are linear, constant
matrices stay constant, and springs and bonds can be summed in one pass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import grid

RIGHT, DOWN, FALLING, RISING, TWO_RIGHT, TWO_DOWN = range(len(grid.DIRECTIONS))


@dataclass(frozen=True, eq=False)
class Bonds:
    """P pairs of particles that pull with `constant`·gap; a negative one pushes."""

    ends: NDArray[np.int32]  # (P, 2)
    constant: NDArray[np.float64]  # [N/m] (P,)
    direction: NDArray[np.int64]  # (P,) index in `grid.DIRECTIONS`


def bonds(rows: int, columns: int, width: float, height: float, bending: float, *, halved: bool) -> Bonds:
    """Those of a sheet of bending stiffness `bending` [N·m]; none for 0. `halved`: an edge stands for half a cell."""
    constants = plate(rows, columns, width, height, bending, halved=halved)
    direction, row, column = np.nonzero(constants)
    _, down, along = (np.array(step)[direction] for step in zip(*grid.DIRECTIONS, strict=True))
    index = grid.particle_indices(rows, columns)
    right = column + np.where(along < 0, -along, 0)  # the upper end of a rising one is its right one
    ends = np.stack([index[row, right], index[row + down, right + along]], axis=-1)
    return Bonds(ends.astype(np.int32), constants[direction, row, column], direction)


def plate(rows: int, columns: int, width: float, height: float, bending: float, *, halved: bool) -> NDArray[np.float64]:
    """Constants [N/m] by direction and the upper left of the bond's place, (6, rows, columns)."""
    a, b = width / (columns - 1), height / (rows - 1)  # [m] sides of a cell
    constants = np.zeros((len(grid.DIRECTIONS), rows, columns))
    across, down = np.ones((rows, 1)), np.ones((1, columns))  # share of a cell that a thread stands for
    if halved:
        across[[0, -1]], down[:, [0, -1]] = 0.5, 0.5
    if columns > 2:
        k = bending * b / a**3 * across
        constants[RIGHT, :, :-2] += 2 * k
        constants[RIGHT, :, 1:-1] += 2 * k
        constants[TWO_RIGHT, :, :-2] -= k
    if rows > 2:
        k = bending * a / b**3 * down
        constants[DOWN, :-2] += 2 * k
        constants[DOWN, 1:-1] += 2 * k
        constants[TWO_DOWN, :-2] -= k
    twist = 2 * bending / (a * b)
    constants[RIGHT, :-1, :-1] += twist
    constants[RIGHT, 1:, :-1] += twist
    constants[DOWN, :-1, :-1] += twist
    constants[DOWN, :-1, 1:] += twist
    constants[FALLING, :-1, :-1] -= twist
    constants[RISING, :-1, :-1] -= twist
    return constants
