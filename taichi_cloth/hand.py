"""The hand that holds a particle: where it goes in a frame, and how fast it was when it lets go."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from .scene.model import FRAME_SECONDS

THROW_FRAMES = 3  # a thrown particle gets the hand's mean velocity over this many frames

Floats = NDArray[np.float64]


class Hand:
    """Holds `particle` and leads it from `start` to `target` [m] within the next frame."""

    def __init__(self, particle: int, start: Floats, target: Floats, path: Iterable[Floats] = ()) -> None:
        """`path`: where the hand was at the end of its last frames; a new hand has only its start."""
        self.particle = particle
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
