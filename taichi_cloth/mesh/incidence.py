"""Which springs and triangles meet at a particle. NumPy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def incidence(corners: NDArray[np.int32], count: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """For each of `count` particles the rows of `corners`, (R, 2 or 3), that name it, in rising order.

    Those of particle i are `rows[first[i]:first[i + 1]]`; returns `first`, (count + 1,), and `rows`.
    """
    particles = corners.reshape(-1)
    order = np.argsort(particles, kind="stable")
    first = np.searchsorted(particles[order], np.arange(count + 1))
    return first.astype(np.int32), (order // corners.shape[1]).astype(np.int32)
