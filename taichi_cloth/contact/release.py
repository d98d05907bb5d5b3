"""Which colliders hold particles that they have appeared around. They let them out slowly."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..scene.model import Collider, Ground
from .bodies import Body, Floats, distance, leaps, pose, size_of

RATE = 0.05  # [m/s] springs that are opened meanwhile snap back forty times as fast
HELD, RELEASED = 0.05, 1e-3  # [m] below its margin: from where on one holds a particle, and until when


class Release:
    """Asked once after a cloth was put in its place or a collider has leapt or grown, and then until it holds nothing.

    `depth` [m], one a collider: below which depth it is asked for particles, infinite where nobody asks.
    """

    def __init__(self, count: int) -> None:
        self.depth = np.full(count, HELD)
        self._unbound = np.zeros(count, np.float32)

    def ask(self, row: int | slice = slice(None)) -> None:
        """A collider, or all, may hold something from now on."""
        self.depth[row] = HELD

    def rates(
        self, colliders: Sequence[Collider | Ground], points: Callable[[], Floats], start: float, end: float
    ) -> NDArray[np.float32]:
        """How fast each lets particles out in the frame from `start` to `end` [m/s]; 0 for no bound.

        `points` tells the places of the particles that can move [m], (N, 3); called where it matters only.
        """
        leapt = [leaps(collider, start, end) for collider in colliders]
        if not any(leapt) and np.isinf(self.depth).all():  # as in nearly every frame
            return self._unbound
        self.depth[np.array(leapt)] = HELD
        asked = np.isfinite(self.depth)
        places = points() if asked.any() else np.zeros((0, 3))
        for row, collider in enumerate(colliders):
            if not asked[row]:
                continue
            body = Body(collider, *pose(collider, end if leapt[row] else start), size_of(collider))
            holds = bool((distance(body, places) < collider.margin - self.depth[row]).any())
            self.depth[row] = RELEASED if holds else np.inf
        return np.where(np.isfinite(self.depth), RATE, 0.0).astype(np.float32)
