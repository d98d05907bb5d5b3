"""The static equilibrium of a hanging cloth in float64: a minimum of elastic and gravitational energy.

It is found by Newton's method with the regularization of an implicit time step: each iteration solves (M/h² + K)·u = F,
and h grows while the energy decreases. With a small h this is overdamped motion, which brings a sheet from any start
down to where it hangs. With a large h it is Newton's method, which then converges in few iterations (pseudo-transient
continuation: Kelley and Keyes 1998).

The linear systems are solved directly as block tridiagonal ones (block Cholesky, float64). Particles are sorted into
levels by breadth-first search from one side of the sheet, so that links join only particles of the same level or of
adjacent levels.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from ...geometry.cloth_builder import stiffness_map
from ...geometry.spring_model import Floats, Ints, SpringModel, spring_model
from ...scene.fabric_schema import Look
from ...scene.schema import Camera, Scene

# -- block tridiagonal solver ------------------------------------------------------------------------------------------


class BlockSystem:
    """Solver of (diagonal + stiffness)·u = right for the free particles of a model; pinned particles have u = 0."""

    def __init__(self, model: SpringModel) -> None:
        level = _levels(model)
        self._level_count = int(level.max(initial=-1)) + 1
        self._members = [np.flatnonzero(level == n) for n in range(self._level_count)]
        self._index = np.zeros(len(level), np.int64)  # index of a particle within its level
        for members in self._members:
            self._index[members] = np.arange(len(members))
        a, b = model.ends
        self._diagonal_links: list[list[tuple[Ints, Ints]]] = []  # per level: (links, particles) of its diagonal block
        self._inner_links: list[tuple[Ints, Ints, Ints]] = []  # per level: links within it, and their ends
        self._upper_links: list[tuple[Ints, Ints, Ints]] = []  # per level: links to the next, and their ends in both
        for n in range(self._level_count):
            self._diagonal_links.append([(link := np.flatnonzero(level[end] == n), end[link]) for end in (a, b)])
            link = np.flatnonzero((level[a] == n) & (level[b] == n))
            self._inner_links.append((link, a[link], b[link]))
            down, up = (np.flatnonzero((level[p] == n) & (level[q] == n + 1)) for p, q in ((a, b), (b, a)))
            link = np.concatenate([down, up])
            self._upper_links.append((link, np.concatenate([a[down], b[up]]), np.concatenate([b[down], a[up]])))

    def solve(self, diagonal: Floats, blocks: Floats, right: Floats) -> Floats:
        """Return u, (3, N), for `diagonal` (N,) times the identity and the 3×3 matrices `blocks` of all links.

        Raises LinAlgError if the matrix is not positive definite.
        """
        u = np.zeros_like(right)
        eliminated = []  # S⁻¹·U and S⁻¹·r of each level: the block Thomas algorithm
        previous: tuple[Floats, Floats, Floats] | None = None
        for n, members in enumerate(self._members):
            schur = self._diagonal_block(n, diagonal, blocks)
            rhs = right[:, members].T.reshape(-1)
            if previous is not None:
                upper, solved_upper, solved_rhs = previous
                schur -= upper.T @ solved_upper
                rhs = rhs - upper.T @ solved_rhs
            np.linalg.cholesky(schur)  # raises LinAlgError if it is not positive definite
            upper = self._upper_block(n, blocks)
            solved: Floats = np.linalg.solve(schur, np.column_stack([upper, rhs])).astype(np.float64, copy=False)
            previous = upper, solved[:, :-1], solved[:, -1]
            eliminated.append((solved[:, :-1], solved[:, -1]))
        next_u = np.zeros(0)
        for members, (solved_upper, solved_rhs) in zip(reversed(self._members), reversed(eliminated), strict=True):
            next_u = solved_rhs - solved_upper @ next_u if solved_upper.shape[1] else solved_rhs
            u[:, members] = next_u.reshape(-1, 3).T
        return u

    def _diagonal_block(self, n: int, diagonal: Floats, blocks: Floats) -> Floats:
        """Return the diagonal block of level n."""
        members = self._members[n]
        count = len(members)
        block = np.zeros((count, count, 3, 3))
        index = np.arange(count)
        block[index, index] = diagonal[members, None, None] * np.eye(3)
        for link, particle in self._diagonal_links[n]:
            np.add.at(block, (self._index[particle], self._index[particle]), blocks[link])
        link, a, b = self._inner_links[n]
        np.subtract.at(block, (self._index[a], self._index[b]), blocks[link])
        np.subtract.at(block, (self._index[b], self._index[a]), blocks[link])
        return block.transpose(0, 2, 1, 3).reshape(3 * count, 3 * count)

    def _upper_block(self, n: int, blocks: Floats) -> Floats:
        """Return the block that couples level n to level n + 1."""
        count, next_count = len(self._members[n]), 0 if n + 1 == self._level_count else len(self._members[n + 1])
        block = np.zeros((count, next_count, 3, 3))
        link, a, b = self._upper_links[n]
        np.subtract.at(block, (self._index[a], self._index[b]), blocks[link])
        return block.transpose(0, 2, 1, 3).reshape(3 * count, 3 * next_count)


def _levels(model: SpringModel) -> Ints:
    """Return the level of every particle, (N,), −1 for pinned particles."""
    a, b = model.ends
    free = model.free[a] & model.free[b]
    a, b = a[free], b[free]
    flat = model.topology.flat
    coordinate = flat[:, int(np.ptp(flat, axis=0).argmax())]
    level = np.where(model.free, -2, -1)
    while (level == -2).any():  # once for each connected component
        unvisited = level == -2
        first = coordinate[unvisited].min()
        front = unvisited & (coordinate <= first + 1e-6 * model.topology.longest_side)
        current = 0
        while front.any():
            level[front] = current
            current += 1
            reached = np.zeros(len(level), bool)
            reached[b[front[a]]] = True
            reached[a[front[b]]] = True
            front = reached & (level == -2)
    return level


# -- Newton's method ---------------------------------------------------------------------------------------------------

PERTURBATION = (
    1e-3  # perturbation of the start, as a share of a spring's length: exactly flat can be an unstable equilibrium
)
RESIDUAL = 0.02  # largest force left on a particle, as a share of its weight; strains are then accurate to about 2 %
FIRST_STEP, STEPS = 0.02, (1e-6, 1e6)  # [s] initial h, and its bounds
MAX_ITERATIONS = 1000
# [weights of the cloth per side] Largest stiffness that is solved. A stiffer spring has the tension that it has with
# this stiffness, so its strain is that tension over its own: to one part in a thousand if all springs are as stiff, to
# two hundredths beside soft ones. Solved directly, such cloth would take minutes to come down from a level start.
MAX_STIFFNESS = 5000.0


def rest_strain(scene: Scene) -> float:
    """Return the largest structural strain of a scene's cloth that hangs at rest from its pins under gravity.

    It depends on the constants of `[fabric]` alone, without colliders, wind, limits or tethers, whatever the solver. It
    is 0 for a cloth without pins, which has no such state. Raises ArithmeticError if no equilibrium is found.
    """
    return _rest_strain(replace(scene, title="", name="", camera=Camera(), look=Look()))


@lru_cache(maxsize=256)
def _rest_strain(scene: Scene) -> float:
    model = spring_model(scene)
    if model.free.all() or not model.free.any() or not model.gravity:
        return 0.0
    structural = model.topology.family("structural")
    max_stiffness = MAX_STIFFNESS * float(model.mass.sum()) * abs(model.gravity) / model.topology.longest_side
    excess = max(1.0, float(model.stiffness.max(initial=0.0)) / max_stiffness)
    factor = stiffness_map(scene)
    if factor is not None:  # only what is too stiff gets softer
        a, b = model.ends[:, : len(model.rest)]
        limited = np.minimum(factor, factor.max() / excess)
        excess = (factor[a] + factor[b]) / (limited[a] + limited[b])
    softer = replace(model, stiffness=model.stiffness / excess)
    return float((softer.strains(rest_positions(softer)) / excess)[structural].max(initial=0.0))


def rest_positions(model: SpringModel) -> Floats:
    """Return the positions of the particles at rest [m], (3, N). Raises ArithmeticError if no minimum is found."""
    system = BlockSystem(model)
    perturbation = (
        PERTURBATION * float(np.median(model.rest)) * np.random.default_rng(0).standard_normal(model.start.shape)
    )
    x = model.start + perturbation * model.free
    weight = float(model.mass.mean()) * abs(model.gravity)
    energy, h = model.energy(x), FIRST_STEP
    for _ in range(MAX_ITERATIONS):
        force = (model.elastic_force(x) + model.weight()) * model.free
        if float(np.sqrt((force**2).sum(axis=0)).max()) < RESIDUAL * weight:
            return x
        candidate = x + _step(model, system, x, force, h)
        new_energy = model.energy(candidate)
        if new_energy < energy:
            x, energy, h = candidate, new_energy, min(2 * h, STEPS[1])
        elif h > STEPS[0]:
            h /= 4
        else:
            break
    raise ArithmeticError("no static equilibrium of the cloth was found")


def _step(model: SpringModel, system: BlockSystem, x: Floats, force: Floats, h: float) -> Floats:
    """Return the displacement of one iteration [m], (3, N), with the exact stiffness if it is positive definite."""
    inertia = model.mass / h**2
    try:
        return system.solve(inertia, model.stiffness_blocks(x), force)
    except np.linalg.LinAlgError:
        return system.solve(inertia, model.stiffness_blocks(x, definite=True), force)
