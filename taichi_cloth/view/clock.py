"""How many frames of simulated time are due when the next picture is made."""

from __future__ import annotations

from ..scene.model import FRAME_SECONDS

MOST_FRAMES = 4  # at once; what a slow machine or a stall is behind by beyond that is dropped, not caught up
SNAP = 0.1  # a picture this close to one frame after the last counts as one frame after it


class FrameClock:
    """Turns wall time into whole frames, so that the cloth moves alike on every display."""

    def __init__(self, now: float) -> None:
        """`now` is the wall time [s]."""
        self._last = now
        self._owed = 0.0  # [frames]
        self.elapsed = 0.0  # [s] from the picture before the last to the last

    def due(self, now: float) -> int:
        """Frames to simulate before the picture made at `now` [s]."""
        self.elapsed = now - self._last
        self._last = now
        passed = self.elapsed / FRAME_SECONDS
        # A 60 Hz display wobbles around one frame; without this it would show 0 and 2 frames by turns.
        self._owed += 1.0 if abs(passed - 1) < SNAP else passed
        frames = int(self._owed)
        self._owed -= frames
        return min(frames, MOST_FRAMES)
