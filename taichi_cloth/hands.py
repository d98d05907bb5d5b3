"""All hands that hold the cloth, by number: what kernels and saves are told of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .hand import Floats, Hand
from .kernels.controls import MOST_HANDS
from .scene.errors import shown

Hands = dict[int, Hand]
Ids = NDArray[np.int64]


def all_held(hands: Mapping[int, Hand]) -> tuple[Ids, Floats, Ids]:
    """Particles that are held, (M,), where they were taken [m], (M, 3), and the number of the hand of each, (M,)."""
    particles = [hand.particles for hand in hands.values()]
    taken = [hand.taken for hand in hands.values()]
    numbers = np.repeat(np.array(list(hands), np.int64), [len(of_one) for of_one in particles])
    return np.concatenate([np.zeros(0, np.int64), *particles]), np.concatenate([np.zeros((0, 3)), *taken]), numbers


def saved_hands(hands: Mapping[int, Hand]) -> dict[str, NDArray[Any]]:
    """What a save tells of hands.

    Of each its number, how many particles it holds and how many rows of places it has: its start, target and path.
    """
    rows = [np.array([hand.start, hand.target, *hand.path]) for hand in hands.values()]
    told = [(number, len(hand.particles), 2 + len(hand.path)) for number, hand in hands.items()]
    particles, taken, _ = all_held(hands)
    return {
        "held": particles,
        "taken": taken,
        "hands": np.array(told, np.int64).reshape(-1, 3),
        "ways": np.concatenate([np.zeros((0, 3)), *rows]),
    }


def hands_of(saved: Mapping[str, NDArray[Any]], particles: int) -> Hands:
    """The hands that a save of a cloth of so many particles tells of. Raises ValueError for what cannot be."""
    held, taken, told, ways = (saved[name] for name in ("held", "taken", "hands", "ways"))
    numbers, counts, rows = told.T
    inside = np.unique(held[(held >= 0) & (held < particles)])
    if not len(held) == len(inside) == len(taken) == counts.sum() or (counts < 1).any():
        raise ValueError(f"no hands hold particles {shown(held.tolist())} with {len(taken)} places")
    if len(np.unique(numbers)) != len(numbers) or not ((numbers >= 0) & (numbers < MOST_HANDS)).all():
        raise ValueError(f"hands have numbers from 0 to {MOST_HANDS - 1}, each its own, not {shown(numbers.tolist())}")
    if (rows < 3).any() or rows.sum() != len(ways):
        raise ValueError(f"the hands have no way: {len(ways)} places for {shown(rows.tolist())}")
    cuts = np.cumsum(counts)[:-1], np.cumsum(rows)[:-1]
    parts = zip(np.split(held, cuts[0]), np.split(taken, cuts[0]), np.split(ways, cuts[1]), strict=True)
    each = [Hand(of_one, since, way[0], way[1], way[2:]) for of_one, since, way in parts if len(way)]
    return dict(zip(numbers.tolist(), each, strict=True))
