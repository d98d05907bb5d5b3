"""Cloth that tears: which springs give way, and what is left of a sheet without them. NumPy only."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .incidence import incidence
from .topology import Batch, Topology

Mask = NDArray[np.bool_]
AROUND = 2  # threads: how near to each other no two give way at once
NOTHING = np.zeros((0, 2), np.int32)


class Tear:
    """What of a cloth is torn so far. Springs are told by their numbers in the whole cloth; E of them.

    Threads, which are structural and shear springs, give way. A triangle goes with the first of its sides that does,
    and a bend spring, which joins what lies two apart, with the threads between.
    """

    def __init__(self, whole: Topology, torn: NDArray[np.int32] = NOTHING) -> None:
        """`torn`: the ends of threads that gave way before, (K, 2); those that `whole` does not have are left out."""
        self.whole = whole
        self.torn: Mask = np.zeros(whole.spring_count, bool)
        bends = whole.family("bend")
        self._threads: Mask = np.ones(whole.spring_count, bool)
        self._threads[bends] = False
        threads = _Pairs(whole, np.flatnonzero(self._threads))
        self._sides = threads.number(whole.triangles, whole.triangles[:, [1, 2, 0]])
        known = threads.number(*torn.T)
        self.torn[known[known >= 0]] = True
        self._bend_of, self._paths = _paths(whole, bends, whole.family("structural"))

    @property
    def ends(self) -> NDArray[np.int32]:
        """The ends of the threads that gave way, (K, 2)."""
        return self.whole.ends[self.torn]

    def give_way(self, strains: NDArray[np.float64], most: float) -> bool:
        """Tears threads that are longer than `most` strain allows; says whether there were any.

        `strains`: of every spring of the whole cloth, (E,); those of torn ones say nothing. Of threads near each other
        only the one that is stretched most gives way at a time: what it carried goes round the end of the tear, which
        runs on from there and stays a line. All at once would leave shreds.
        """
        strains = np.where(self._threads & ~self.torn, strains, -np.inf)
        ends, worst = self.whole.ends, strains
        for _ in range(AROUND):
            at = np.full(self.whole.particle_count, -np.inf)
            np.maximum.at(at, ends[:, 0], worst)
            np.maximum.at(at, ends[:, 1], worst)
            worst = at[ends].max(axis=1)
        torn = (strains > most) & (strains >= worst)
        self.torn |= torn
        return bool(torn.any())

    def left(self) -> Topology:
        """The cloth without what is torn: all its particles, fewer springs and triangles."""
        whole, kept = self.whole, ~self.torn
        if kept.all():
            return whole
        joined = np.zeros(whole.spring_count, bool)
        joined[self._bend_of[kept[self._paths].all(axis=1)]] = True
        kept[self._bend_of] = joined[self._bend_of]
        whole_triangles = (kept[self._sides] | (self._sides < 0)).all(axis=1)
        return replace(
            whole,
            ends=whole.ends[kept],
            rest=whole.rest[kept],
            shares=whole.shares[:, kept],
            batches=_batches(whole, kept),
            triangles=whole.triangles[whole_triangles],
            cells=whole.cells[whole_triangles],
        )


class _Pairs:
    """Finds springs by their ends."""

    def __init__(self, cloth: Topology, springs: NDArray[np.int64]) -> None:
        self._count = cloth.particle_count
        keys = self._key(*cloth.ends[springs].T)
        order = np.argsort(keys)
        self._keys, self._springs = keys[order], springs[order]

    def number(self, a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.int64]:
        """Number of the spring between each a and b, in any shape; −1 where there is none."""
        if not len(self._keys):
            return np.full(np.shape(a), -1)
        keys = self._key(a, b)
        at = np.searchsorted(self._keys, keys).clip(max=len(self._keys) - 1)
        return np.where(self._keys[at] == keys, self._springs[at], -1)

    def _key(self, a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.int64]:
        keys: NDArray[np.int64] = np.minimum(a, b).astype(np.int64) * self._count + np.maximum(a, b)
        return keys


def _paths(
    cloth: Topology, bends: NDArray[np.int64], structural: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The ways from end to end of each bend spring over two structural ones: its number, (W,), and theirs, (W, 2)."""
    a, b = cloth.ends[bends].T
    first, rows = incidence(cloth.ends[structural], cloth.particle_count)
    degree = np.diff(first)[a]
    way = np.repeat(np.arange(len(bends)), degree)  # each thread at a, and whether one goes on to b
    nth = np.arange(len(way)) - np.repeat(np.cumsum(degree) - degree, degree)
    thread = structural[rows[first[a][way] + nth]] if len(way) else np.zeros(0, np.int64)
    between = cloth.ends[thread].sum(axis=1) - a[way]
    onward = _Pairs(cloth, structural).number(between, b[way])
    there = onward >= 0
    return bends[way[there]], np.stack([thread, onward], axis=1)[there]


def _batches(cloth: Topology, kept: Mask) -> tuple[Batch, ...]:
    """The runs of springs of one colour among those that are kept."""
    counts = [int(kept[batch.first : batch.first + batch.count].sum()) for batch in cloth.batches]
    firsts = np.cumsum([0, *counts])
    return tuple(
        replace(batch, first=int(first), count=count)
        for batch, first, count in zip(cloth.batches, firsts, counts, strict=False)
        if count
    )
