"""Energies of the form ½·c·|Σ k_i·x_i|² as bonds between particles. NumPy only.

Where the k_i of a stencil add up to 0, that is Σ over pairs of −½·c·k_i·k_j·|x_i − x_j|²: so every quadratic model of
bending is a sum of bonds without length (`bending.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from .bending import Bonds

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Stencils:
    """S sums over K particles each."""

    particles: Whole  # (S, K)
    factors: Floats  # (S, K) that add up to 0
    constant: Floats  # (S,)


def bonds_of(stencils: list[Stencils]) -> Bonds:
    """Each pair of particles once, with the sum of what joins it."""
    ends: list[Whole] = [np.zeros((0, 2), np.int64)]
    constants: list[Floats] = [np.zeros(0)]
    for one in stencils:
        for i, j in combinations(range(one.particles.shape[1]), 2):
            ends.append(np.sort(one.particles[:, [i, j]], axis=1))
            constants.append(-one.constant * one.factors[:, i] * one.factors[:, j])
    both = np.concatenate(ends)
    count = int(both.max(initial=0)) + 1
    keys, which = np.unique(both[:, 0] * count + both[:, 1], return_inverse=True)
    pairs = np.stack(np.divmod(keys, count), axis=-1)
    constant = np.bincount(which, np.concatenate(constants), len(pairs))
    used = constant != 0
    nowhere = np.full(used.sum(), -1, np.int64)  # no direction of a grid
    return Bonds(pairs[used].astype(np.int32), constant[used], nowhere)
