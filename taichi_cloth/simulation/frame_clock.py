"""How many frames of 1/60 s are due at each refresh of a display."""

from __future__ import annotations

from ..scene.schema import FRAME_SECONDS

MAX_FRAMES = 4  # simulated for one displayed frame; on a slow machine or after a stall, further frames are dropped
INTERVAL_TOLERANCE = 0.1  # [frames] an interval between displayed frames this close to one frame counts as exactly one


class FrameClock:
    """Converts wall time to a number of frames to simulate, so that the cloth has the same speed on every display."""

    def __init__(self, now: float) -> None:
        """`now`: wall time [s]."""
        self._last = now
        self._pending = 0.0  # [frames]
        self.elapsed = 0.0
        """Time between the last two calls of `due` [s]."""

    def due(self, now: float, speed: float = 1.0) -> int:
        """Return the number of frames to simulate before the image displayed at `now` [s].

        `speed`: simulated time per wall time.
        """
        self.elapsed = now - self._last
        self._last = now
        passed = self.elapsed / FRAME_SECONDS
        # The interval of a 60 Hz display jitters around one frame: without snapping, 0 and 2 frames would alternate.
        self._pending += speed * (1.0 if abs(passed - 1) < INTERVAL_TOLERANCE else passed)
        frames = int(self._pending)
        self._pending -= frames
        return min(frames, MAX_FRAMES)
