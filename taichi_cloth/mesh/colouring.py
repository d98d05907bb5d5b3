"""Rows of particles in colours: rows of one colour share no particle, so that none waits for another. NumPy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def coloured(rows: NDArray[np.int32], count: int) -> NDArray[np.int64]:
    """Colour of each row, (R,), of `count` particles: row after row the lowest that none of its particles has yet."""
    taken = [0] * count  # colours at each particle, one bit each
    colours = np.zeros(len(rows), np.int64)
    for k, row in enumerate(rows.tolist()):
        mask = 0
        for particle in row:
            mask |= taken[particle]
        free = ~mask & (mask + 1)
        for particle in row:
            taken[particle] |= free
        colours[k] = free.bit_length() - 1
    return colours
