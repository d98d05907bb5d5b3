"""Tearing of cloth: which springs tear, and the cloth without them. NumPy only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .topology import ColorBatch, Topology, adjacency

Mask = NDArray[np.bool_]
TEAR_SPACING = 2  # [springs] distance within which only one spring tears at a time
NOTHING = np.zeros((0, 2), np.int32)


class TearState:
    """The torn springs of a cloth, referred to by their index in the untorn cloth, which has E springs.

    Structural and shear springs tear. A triangle is removed with the first of its sides that tears. A bend spring,
    which connects particles two structural springs apart, is removed when every path of two such springs is torn.
    """

    def __init__(self, whole: Topology, torn: NDArray[np.int32] = NOTHING) -> None:
        """`torn`: ends of springs that are torn already, (K, 2); springs that `whole` does not have are ignored."""
        self.untorn = whole
        self.torn: Mask = np.zeros(whole.spring_count, bool)
        bend_springs = whole.family("bend")
        self._tearable: Mask = np.ones(whole.spring_count, bool)
        self._tearable[bend_springs] = False
        lookup = _SpringLookup(whole, np.flatnonzero(self._tearable))
        self._sides = lookup.find(whole.triangles, whole.triangles[:, [1, 2, 0]])
        known = lookup.find(*torn.T)
        self.torn[known[known >= 0]] = True
        self._bend_of, self._paths = _bend_paths(whole, bend_springs, whole.family("structural"))

    @property
    def ends(self) -> NDArray[np.int32]:
        """Ends of the torn springs, (K, 2)."""
        return self.untorn.ends[self.torn]

    def tear_overstretched(self, strains: NDArray[np.float64], limit: float) -> bool:
        """Tear the springs whose strain exceeds `limit`. Return whether any tore.

        `strains` of every spring of the untorn cloth, (E,); those of torn springs are ignored. Of springs near each
        other, only the one with the largest strain tears at a time. Its load then moves to the end of the tear, so the
        tear grows from there and stays a line. If all tore at once, shreds would remain.
        """
        strains = np.where(self._tearable & ~self.torn, strains, -np.inf)
        ends, worst = self.untorn.ends, strains
        for _ in range(TEAR_SPACING):
            at = np.full(self.untorn.particle_count, -np.inf)
            np.maximum.at(at, ends[:, 0], worst)
            np.maximum.at(at, ends[:, 1], worst)
            worst = at[ends].max(axis=1)
        torn = (strains > limit) & (strains >= worst)
        self.torn |= torn
        return bool(torn.any())

    def remaining(self) -> Topology:
        """Return the cloth without the torn springs and triangles. It has all particles."""
        whole, remaining = self.untorn, ~self.torn
        if remaining.all():
            return whole
        bend_intact = np.zeros(whole.spring_count, bool)
        bend_intact[self._bend_of[remaining[self._paths].all(axis=1)]] = True
        remaining[self._bend_of] = bend_intact[self._bend_of]
        intact = (remaining[self._sides] | (self._sides < 0)).all(axis=1)
        return replace(
            whole,
            ends=whole.ends[remaining],
            rest=whole.rest[remaining],
            stiffness_factors=whole.stiffness_factors[:, remaining],
            batches=_remaining_batches(whole, remaining),
            triangles=whole.triangles[intact],
            cells=whole.cells[intact],
        )


class _SpringLookup:
    """Index of springs by their ends."""

    def __init__(self, cloth: Topology, springs: NDArray[np.int64]) -> None:
        self._count = cloth.particle_count
        keys = self._key(*cloth.ends[springs].T)
        order = np.argsort(keys)
        self._keys, self._springs = keys[order], springs[order]

    def find(self, a: NDArray[np.generic], b: NDArray[np.generic]) -> NDArray[np.int64]:
        """Return the spring between each a and b, arrays of any shape; −1 if there is none."""
        if not len(self._keys):
            return np.full(np.shape(a), -1)
        keys = self._key(a, b)
        position = np.searchsorted(self._keys, keys).clip(max=len(self._keys) - 1)
        return np.where(self._keys[position] == keys, self._springs[position], -1)

    def _key(self, a: NDArray[np.generic], b: NDArray[np.generic]) -> NDArray[np.int64]:
        keys: NDArray[np.int64] = np.minimum(a, b).astype(np.int64) * self._count + np.maximum(a, b)
        return keys


def _bend_paths(
    cloth: Topology, bends: NDArray[np.int64], structural: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the paths over two structural springs that connect the ends of bend springs.

    The result is the bend spring of every path, (W,), and its two structural springs, (W, 2).
    """
    a, b = cloth.ends[bends].T
    first, rows = adjacency(cloth.ends[structural], cloth.particle_count)
    degree = np.diff(first)[a]
    path = np.repeat(np.arange(len(bends)), degree)  # one for each spring at a; below, those that end at b are chosen
    offset = np.arange(len(path)) - np.repeat(np.cumsum(degree) - degree, degree)
    first_spring = structural[rows[first[a][path] + offset]] if len(path) else np.zeros(0, np.int64)
    between = cloth.ends[first_spring].sum(axis=1) - a[path]
    second = _SpringLookup(cloth, structural).find(between, b[path])
    exists = second >= 0
    return bends[path[exists]], np.stack([first_spring, second], axis=1)[exists]


def _remaining_batches(cloth: Topology, remaining: Mask) -> tuple[ColorBatch, ...]:
    """Return the color batches of the remaining springs."""
    counts = [int(remaining[batch.first : batch.first + batch.count].sum()) for batch in cloth.batches]
    firsts = np.cumsum([0, *counts])
    return tuple(
        replace(batch, first=int(first), count=count)
        for batch, first, count in zip(cloth.batches, firsts, counts, strict=False)
        if count
    )
