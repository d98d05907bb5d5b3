"""Bending resistance as linear bending links between particles. NumPy only.

A thin sheet that bends without stretching has the energy ½·B·∫(w_xx² + w_yy² + 2·w_xy²) over its area, with second
derivatives of its positions. (This is an isotropic plate without a Poisson effect, which is negligible in woven cloth.)
If the stiffness B₁ along the columns is not B₂ along the rows, it is ½·∫(B₂·w_xx² + B₁·w_yy² + 2·√(B₁·B₂)·w_xy²), with
the twisting stiffness that Huber (1923) assumes for orthotropic plates. On a grid the derivatives are
x_i−1 − 2·x_i + x_i+1 along both yarn directions, and x_00 − x_01 − x_10 + x_11 over a cell. So the energy is quadratic
in the positions (Bergou et al. 2006, *A quadratic bending model for inextensible surfaces*), and a sum over pairs of
particles:

    |x_0 − 2·x_1 + x_2|²         = 2·|x_0 − x_1|² + 2·|x_1 − x_2|² − |x_0 − x_2|²
    |x_00 − x_01 − x_10 + x_11|² = |·|² of the four sides − |·|² of the two diagonals

In general, an energy ½·c·|Σ k_i·x_i|² whose factors k_i add up to 0 equals Σ over pairs of −½·c·k_i·k_j·|x_i − x_j|².
Every quadratic bending model is therefore a sum of bending links: springs of zero rest length, some of which push.
Their forces are linear, constant matrices stay constant, and springs and links are summed in one pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from . import grid

Bending = float | tuple[float, float]
"""Bending stiffness of a sheet [N·m]: along its columns and along its rows, or one number for both."""

RIGHT, DOWN, FALLING, RISING, TWO_RIGHT, TWO_DOWN = range(len(grid.DIRECTIONS))


@dataclass(frozen=True, eq=False)
class BendingLinks:
    """P bending links: pairs of particles that attract each other with the force `constant`·gap."""

    ends: NDArray[np.int32]
    """The two particles of every link, (P, 2)."""
    stiffness: NDArray[np.float64]
    """Stiffness of every link [N/m], (P,); links with a negative one push."""
    direction: NDArray[np.int64]
    """Index of every link's direction in `grid.DIRECTIONS`, (P,); −1 in a mesh that is not a grid."""


def grid_bending_links(
    rows: int, columns: int, width: float, height: float, bending: Bending, *, halved: bool
) -> BendingLinks:
    """Return the bending links of a rectangular sheet of size `width` × `height` [m]; none for zero stiffness.

    `bending`: bending stiffness [N·m]. `halved`: yarns along the edges of the sheet represent half a cell.
    """
    constants = plate_link_stiffness(rows, columns, width, height, bending, halved=halved)
    direction, row, column = np.nonzero(constants)
    _, down, along = (np.array(step)[direction] for step in zip(*grid.DIRECTIONS, strict=True))
    index = grid.particle_indices(rows, columns)
    right = column + np.where(along < 0, -along, 0)  # the upper end of a rising diagonal is its right end
    ends = np.stack([index[row, right], index[row + down, right + along]], axis=-1)
    return BendingLinks(ends.astype(np.int32), constants[direction, row, column], direction)


def plate_link_stiffness(
    rows: int, columns: int, width: float, height: float, bending: Bending, *, halved: bool
) -> NDArray[np.float64]:
    """Return the stiffness of all bending links [N/m], (6, rows, columns).

    The indices are the direction, and the row and column of the upper left corner of the box around both ends.
    Parameters as in `grid_bending_links`.
    """
    a, b = width / (columns - 1), height / (rows - 1)  # [m] width and height of a cell
    down, along = np.broadcast_to(bending, 2)
    constants = np.zeros((len(grid.DIRECTIONS), rows, columns))
    row_fraction, column_fraction = np.ones((rows, 1)), np.ones((1, columns))  # width of each yarn, in cells
    if halved:
        row_fraction[[0, -1]], column_fraction[:, [0, -1]] = 0.5, 0.5
    if columns > 2:
        k = along * b / a**3 * row_fraction
        constants[RIGHT, :, :-2] += 2 * k
        constants[RIGHT, :, 1:-1] += 2 * k
        constants[TWO_RIGHT, :, :-2] -= k
    if rows > 2:
        k = down * a / b**3 * column_fraction
        constants[DOWN, :-2] += 2 * k
        constants[DOWN, 1:-1] += 2 * k
        constants[TWO_DOWN, :-2] -= k
    bending = float(np.sqrt(down * along))  # in a twist
    twist = 2 * bending / (a * b)
    constants[RIGHT, :-1, :-1] += twist
    constants[RIGHT, 1:, :-1] += twist
    constants[DOWN, :-1, :-1] += twist
    constants[DOWN, :-1, 1:] += twist
    constants[FALLING, :-1, :-1] -= twist
    constants[RISING, :-1, :-1] -= twist
    return constants


Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class QuadraticForms:
    """S quadratic energies ½·c·|Σ k_i·x_i|² of K particles each."""

    particles: Ints
    """Particle indices, (S, K)."""
    factors: Floats
    """Factors k, (S, K); those of one energy add up to 0."""
    stiffness: Floats
    """Constants c, (S,)."""


def links_of_forms(forms: list[QuadraticForms]) -> BendingLinks:
    """Return the bending links of quadratic energies: one for each pair of particles, with the summed stiffness."""
    ends: list[Ints] = [np.zeros((0, 2), np.int64)]
    constants: list[Floats] = [np.zeros(0)]
    for form in forms:
        for i, j in combinations(range(form.particles.shape[1]), 2):
            ends.append(np.sort(form.particles[:, [i, j]], axis=1))
            constants.append(-form.stiffness * form.factors[:, i] * form.factors[:, j])
    all_ends = np.concatenate(ends)
    count = int(all_ends.max(initial=0)) + 1
    pair_keys, pair_of = np.unique(all_ends[:, 0] * count + all_ends[:, 1], return_inverse=True)
    pairs = np.stack(np.divmod(pair_keys, count), axis=-1)
    constant = np.bincount(pair_of, np.concatenate(constants), len(pairs))
    used = constant != 0
    no_direction = np.full(used.sum(), -1, np.int64)
    return BendingLinks(pairs[used].astype(np.int32), constant[used], no_direction)
