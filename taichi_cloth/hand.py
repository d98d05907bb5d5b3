"""A hand that holds a patch of particles: where it goes in a frame, and how fast it was when it lets go.

A patch is led as two fingers lead what is between them: every particle of it goes the hand's way from where it was
taken, and has no mass meanwhile. So nothing moves when it is taken, the hand is where the cursor is to the last bit
with every method, and the pull comes in along the rim of the patch instead of at one point: 0.5 m out of a curtain of
96×96 particles, the longest spring is 27 % longer around 0.1 m and 50 % at one particle. (Weights that fall to zero
at the rim would need a spring on each particle, of another stiffness in every method; the cloth outside the
patch is that spring already, and falls off as it does.)
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from .scene.model import FRAME_SECONDS

THROW_FRAMES = 3  # what is thrown gets the hand's mean velocity over this many frames

Floats = NDArray[np.float64]


class Hand:
    """Holds `particles` and leads the first of them from `start` to `target` [m] within the next frame."""

    def __init__(
        self, particles: NDArray[np.int64], taken: Floats, start: Floats, target: Floats, path: Iterable[Floats] = ()
    ) -> None:
        """`taken`: where the particles were when they were taken [m], (M, 3); `path`: where the hand was at the end of
        its last frames; a new hand has only its start.
        """
        self.particles = particles
        self.taken = taken
        self.start = start
        self.target = target
        self.path = deque(path, maxlen=THROW_FRAMES + 1) or deque([start], maxlen=THROW_FRAMES + 1)

    def end_frame(self) -> None:
        """The frame is over: the hand is where it was to go."""
        self.start = self.target
        self.path.append(self.target)

    def velocity(self) -> Floats:
        """Mean velocity [m/s] over the last frames; zero before the first."""
        travel: Floats = self.path[-1] - self.path[0]
        return travel / (max(len(self.path) - 1, 1) * FRAME_SECONDS)


def patch(flat: Floats, free: NDArray[np.bool_], index: int, radius: float) -> NDArray[np.int64]:
    """A particle and, behind it, all that are `free` within `radius` [m] of it on the flat sheet, (N, 3).

    On the sheet and not in the air: a layer that lies behind is not taken along.
    """
    near = free & (np.linalg.norm(flat - flat[index], axis=1) <= radius)
    near[index] = False
    return np.concatenate([[index], np.flatnonzero(near)])
