"""Which colliders have appeared around particles. Each lets them out slowly: it is smaller by the depth of the deepest
one, and grows back.

To push all out at once would be to shoot them, and to hold them back one by one opens springs that snap back later.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..scene.model import Collider, Ground
from .bodies import Body, Floats, distance, leaps, pose, size_of

RATE = 0.2  # [m/s] of its growth
HELD = 0.05  # [m] below its margin: from where on one holds a particle
ASKED = -1.0


class Release:
    """Asked once after a cloth was put in its place or a collider has leapt or grown, and then until it holds nothing.

    `depth` [m], one a collider: how much smaller it is, or `ASKED` until it is known what it holds.
    """

    def __init__(self, count: int) -> None:
        self.depth = np.full(count, ASKED)

    def ask(self, row: int | slice = slice(None)) -> None:
        """A collider, or all, may hold something from now on."""
        self.depth[row] = ASKED

    def depths(
        self, colliders: Sequence[Collider | Ground], points: Callable[[], Floats], start: float, end: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """How much smaller each is at the start and at the end of a frame [m].

        `points` tells the places of the particles that can move [m], (N, 3); called where it matters only.
        """
        leapt = np.array([leaps(collider, start, end) for collider in colliders], bool)
        self.depth[leapt] = ASKED
        if self.depth.any():  # in nearly every frame nothing is held
            places = points()
            for row in map(int, np.flatnonzero(self.depth)):
                collider = colliders[row]
                body = Body(collider, *pose(collider, end if leapt[row] else start), size_of(collider))
                deepest = collider.margin - float(distance(body, places).min(initial=np.inf))
                asked = self.depth[row] == ASKED
                self.depth[row] = (deepest if deepest > HELD else 0.0) if asked else min(self.depth[row], deepest)
        before = np.maximum(self.depth, 0.0)
        self.depth = np.maximum(before - RATE * (end - start), 0.0)
        return before, self.depth
