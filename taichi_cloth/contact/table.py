"""The table of colliders in kernels: its rows, and which bodies stand in which.

First come those that push out, kind by kind, then those that reflect, then those that repel.
"""

from typing import Any

from ..scene.model import COLLIDERS


def rows_of(stages: Any, response: int, k: int) -> tuple[int, int]:
    """Where the bodies of kind k and of one response begin in the table, and where they end (asked while compiling)."""
    projecting = tuple(getattr(stages, kind) for kind in COLLIDERS)
    counts = projecting, stages.reflecting, stages.repelling
    first = sum(map(sum, counts[:response])) + sum(counts[response][:k])
    return first, first + counts[response][k]
