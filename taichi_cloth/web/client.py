"""One page that is connected: what waits to be sent to it, and how much it may say."""

from __future__ import annotations

import asyncio

ORDER = ("scene", "panel", "told", "figures", "moment")  # a scene comes before what is said of it
IN_FLIGHT = 4  # moments that are sent and not shown yet; more would only be late
RATE, BURST = 150.0, 300.0  # messages a second that are allowed for long, and at once: a mouse tells 60 moves


class Client:
    """Only the newest of each kind waits: a slow page misses moments, and nothing is queued for it."""

    def __init__(self, number: int, now: float) -> None:
        """`now`: the wall time [s]."""
        self.number = number
        self.something = asyncio.Event()
        self._waiting: dict[str, bytes] = {}
        self._sent = self._seen = 0  # moments
        self._allowance, self._heard_at = BURST, now

    def put(self, kind: str, data: bytes) -> None:
        """The newest of its kind."""
        if kind == "scene":
            self._waiting.clear()  # they are of another one
        self._waiting[kind] = data
        self.something.set()

    def next(self) -> bytes | None:
        """What is to be sent now."""
        for kind in ORDER:
            if kind in self._waiting and (kind != "moment" or self._sent - self._seen < IN_FLIGHT):
                self._sent += kind == "moment"
                return self._waiting.pop(kind)
        return None

    def shown(self, moments: int) -> None:
        """The page has shown the last of so many moments that it was sent."""
        self._seen = min(moments, self._sent)
        self.something.set()

    def may_say(self, now: float, cost: int = 1) -> bool:
        """Whether it may say something more at `now` [s]; each time it does costs it as much as so many messages."""
        self._allowance = min(self._allowance + RATE * (now - self._heard_at), BURST) - cost
        self._heard_at = now
        return self._allowance >= 0
