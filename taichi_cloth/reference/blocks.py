"""Linear systems of a cloth's stiffness, solved directly as block tridiagonal ones (block Cholesky, float64).

Particles are put in levels by breadth-first search from one side of the sheet, so that links join only particles of
the same level or of neighboring ones.
"""

from __future__ import annotations

import numpy as np

from .springs import Floats, Ints, SpringModel


class BlockSystem:
    """Solves (diagonal + stiffness)·u = right for the free particles of a model; pinned particles have u = 0."""

    def __init__(self, model: SpringModel) -> None:
        level = _levels(model)
        self._levels = int(level.max(initial=-1)) + 1
        self._members = [np.flatnonzero(level == n) for n in range(self._levels)]
        self._row = np.zeros(len(level), np.int64)  # number of a particle within its level
        for members in self._members:
            self._row[members] = np.arange(len(members))
        a, b = model.ends
        self._own: list[list[tuple[Ints, Ints]]] = []  # for each level: (links, particles) of its diagonal block
        self._inner: list[tuple[Ints, Ints, Ints]] = []  # links within it, and their ends
        self._outer: list[tuple[Ints, Ints, Ints]] = []  # links to the next level, from this one to that one
        for n in range(self._levels):
            self._own.append([(link := np.flatnonzero(level[end] == n), end[link]) for end in (a, b)])
            link = np.flatnonzero((level[a] == n) & (level[b] == n))
            self._inner.append((link, a[link], b[link]))
            down, up = (np.flatnonzero((level[p] == n) & (level[q] == n + 1)) for p, q in ((a, b), (b, a)))
            link = np.concatenate([down, up])
            self._outer.append((link, np.concatenate([a[down], b[up]]), np.concatenate([b[down], a[up]])))

    def solve(self, diagonal: Floats, blocks: Floats, right: Floats) -> Floats:
        """u (3, N), for `diagonal` (N,) times the identity and the 3×3 matrices `blocks` of all links.

        Raises LinAlgError where the matrix is not positive definite.
        """
        found = np.zeros_like(right)
        kept = []  # of each level S⁻¹·U and S⁻¹·r: the block elimination of Thomas
        before: tuple[Floats, Floats, Floats] | None = None
        for n, members in enumerate(self._members):
            schur = self._diagonal_block(n, diagonal, blocks)
            rest = right[:, members].T.reshape(-1)
            if before is not None:
                upper, solved_upper, solved_rest = before
                schur -= upper.T @ solved_upper
                rest = rest - upper.T @ solved_rest
            np.linalg.cholesky(schur)  # raises where it is not definite
            upper = self._upper_block(n, blocks)
            solved: Floats = np.linalg.solve(schur, np.column_stack([upper, rest])).astype(np.float64, copy=False)
            before = upper, solved[:, :-1], solved[:, -1]
            kept.append((solved[:, :-1], solved[:, -1]))
        later = np.zeros(0)
        for members, (solved_upper, solved_rest) in zip(reversed(self._members), reversed(kept), strict=True):
            later = solved_rest - solved_upper @ later if solved_upper.shape[1] else solved_rest
            found[:, members] = later.reshape(-1, 3).T
        return found

    def _diagonal_block(self, n: int, diagonal: Floats, blocks: Floats) -> Floats:
        members = self._members[n]
        count = len(members)
        block = np.zeros((count, count, 3, 3))
        each = np.arange(count)
        block[each, each] = diagonal[members, None, None] * np.eye(3)
        for link, particle in self._own[n]:
            np.add.at(block, (self._row[particle], self._row[particle]), blocks[link])
        link, a, b = self._inner[n]
        np.subtract.at(block, (self._row[a], self._row[b]), blocks[link])
        np.subtract.at(block, (self._row[b], self._row[a]), blocks[link])
        return block.transpose(0, 2, 1, 3).reshape(3 * count, 3 * count)

    def _upper_block(self, n: int, blocks: Floats) -> Floats:
        count, after = len(self._members[n]), 0 if n + 1 == self._levels else len(self._members[n + 1])
        block = np.zeros((count, after, 3, 3))
        link, a, b = self._outer[n]
        np.subtract.at(block, (self._row[a], self._row[b]), blocks[link])
        return block.transpose(0, 2, 1, 3).reshape(3 * count, 3 * after)


def _levels(model: SpringModel) -> Ints:
    """Level of every particle, (N,), −1 for pinned ones."""
    a, b = model.ends
    both = model.free[a] & model.free[b]
    a, b = a[both], b[both]
    flat = model.topology.flat
    along = flat[:, int(np.ptp(flat, axis=0).argmax())]
    level = np.where(model.free, -2, -1)
    while (level == -2).any():  # once for each piece that nothing joins
        unseen = level == -2
        first = along[unseen].min()
        here = unseen & (along <= first + 1e-6 * model.topology.side)
        number = 0
        while here.any():
            level[here] = number
            number += 1
            reached = np.zeros(len(level), bool)
            reached[b[here[a]]] = True
            reached[a[here[b]]] = True
            here = reached & (level == -2)
    return level
