"""`projective`: backward Euler as a minimisation, by rounds that all solve with one and the same matrix.

Liu, Bargteil, O'Brien and Kavan 2013, *Fast simulation of mass-spring systems*: with y = x + h·v + h²·a the place
without springs, the substep ends where ½(x − y)ᵀM(x − y) + h²·E(x) is least. Given the direction d_ij, as long as at
rest, that each spring would have (local step), that is linear: (M + h²L)·x = M·y + h²·J·d (eq. 14, global step).
Here the equation is solved for the way δ still to go. Its right side is then what is missing to equilibrium, with
the plain forces f of the springs, and loses nothing to float32:

    (M + h²L)·δ = M·(y − x) + h²·f(x),    x ← x + δ

The matrix is constant: path `list` factorises it once and then only substitutes. Path `matrix-free` never forms it: it
solves by conjugate gradients, with one sweep over the springs for every product, in strips where the grid is wide
enough for them. It is as fast for one round of 720 particles, takes twice as long for ten, and 3.4 times for 4096.
Dashpots (`damping_time`) are left out: backward Euler damps by itself.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..contact.push_out import push_out
from ..kernels.controls import KEPT, STIFFNESS
from ..kernels.forces import add_air, forget_forces
from ..kernels.grab import lead_held
from ..kernels.maths import TINY
from ..kernels.motion import drift, kick, take_up_corrections
from ..kernels.places import LANES, choose, dot, times
from ..kernels.springs import add_spring_forces, add_to_both, far, for_springs, limit_strain
from ..kernels.tethers import pull_tethers
from ..mesh.topology import Topology
from ..state import ClothState, lanes
from ..state.fields import like_places
from ..state.pool import attached
from .base import FrameInput, Solver, Stages, row, run_part, table

TOLERANCE = 1e-4  # conjugate gradients end when the residual is this share of the first; the next round sees the rest
MOST_PRODUCTS = 300  # or after so many products


# -- both paths ----------------------------------------------------------------------------------------------------


@ti.func
def before(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """Every particle to y, where it would be without springs, and the held one to the hand."""
    forget_forces(cloth)
    add_air(cloth, stages, now, now.s)
    kick(cloth, now.controls, now.h, now.controls[KEPT])
    drift(cloth, now.h)
    lead_held(cloth, stages, now, now.s + 1.0)


@ti.func
def missing(cloth: ti.template(), i: int, h: float):
    """Right side of the equation [kg·m]: M·(y − x) + h²·f, and 0 for a particle that is not free."""
    mass = 1.0 / ti.max(cloth.inverse_mass[i], TINY)
    both = times(cloth.predicted[i] - cloth.x[i], mass) + cloth.force[i] * (h * h)
    return choose(cloth.inverse_mass[i] > 0.0, both, both * 0.0)


@ti.func
def after(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """Contact and the strain limit, and the velocity that goes with the new places."""
    pull_tethers(cloth, stages, now)
    push_out(cloth, stages, now)
    limit_strain(cloth, stages, now.controls, now.h)
    take_up_corrections(cloth, now.h)


# -- by conjugate gradients ----------------------------------------------------------------------------------------


@dataclass(eq=False)
class Search:
    """Fields of the conjugate gradients, in the layout that is worked on."""

    way: Any  # [m] δ
    residual: Any  # [kg·m]
    direction: Any
    product: Any  # of the matrix and the direction


def search_of(work: Any) -> Search:
    """The search of a state."""
    return attached(work, "search", lambda: Search(*(like_places(work) for _ in range(4))))


@ti.func
def inner(cloth: ti.template(), a: ti.template(), b: ti.template()):
    """a·b over the whole cloth."""
    total = dot(a[0], b[0])
    for i in range(1, cloth.slot_count[None]):
        total += dot(a[i], b[i])
    if ti.static(cloth.in_lanes):
        return total.sum()
    else:
        return total


@ti.func
def resist(
    cloth: ti.template(), stages: ti.template(), a, b, e, stiffness, over: ti.template(), controls: ti.template(), h
):
    """Adds a spring's share of h²L times the direction to the product."""
    gap = far(cloth.search.direction[b], over) - cloth.search.direction[a]
    share = times(gap, stiffness * (controls[STIFFNESS] * h * h))
    add_to_both(cloth.search.product, a, b, -share, share, over)


@ti.func
def go_the_way(cloth: ti.template(), search: ti.template(), stages: ti.template(), controls: ti.template(), h: float):
    """Solves for δ by conjugate gradients from 0 (Hestenes and Stiefel 1952), and goes there."""
    for i in range(cloth.slot_count[None]):
        search.residual[i] = missing(cloth, i, h)
        search.direction[i] = search.residual[i]
        search.way[i] = search.residual[i] * 0.0
    squares = inner(cloth, search.residual, search.residual)
    goal = ti.max(squares * TOLERANCE**2, 1e-36)  # of squares; below, they would leave float32
    products = 0
    while squares > goal and products < MOST_PRODUCTS:
        products += 1
        for i in range(cloth.slot_count[None]):
            search.product[i] = times(search.direction[i], 1.0 / ti.max(cloth.inverse_mass[i], TINY))
        for_springs(cloth, stages, resist, controls, h)
        far_enough = squares / inner(cloth, search.direction, search.product)
        for i in range(cloth.slot_count[None]):
            search.way[i] = search.way[i] + search.direction[i] * far_enough
            left = search.residual[i] - search.product[i] * far_enough
            search.residual[i] = choose(cloth.inverse_mass[i] > 0.0, left, left * 0.0)
        before = squares
        squares = inner(cloth, search.residual, search.residual)
        for i in range(cloth.slot_count[None]):
            search.direction[i] = search.residual[i] + search.direction[i] * (squares / before)
    for i in range(cloth.slot_count[None]):
        cloth.x[i] = cloth.x[i] + search.way[i]


@ti.func
def sweep(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """One round without a matrix. A particle that is not free takes no part: its residual is 0."""
    forget_forces(cloth)
    add_spring_forces(cloth, stages, now.controls, now.h)
    go_the_way(cloth, cloth.search, stages, now.controls, now.h)


# -- by a factor ---------------------------------------------------------------------------------------------------


@ti.func
def write_missing(cloth: ti.template(), stages: ti.template(), controls: ti.template(), h: float, right: ti.template()):
    forget_forces(cloth)
    add_spring_forces(cloth, stages, controls, h)
    for i in range(cloth.slot_count[None]):
        value = missing(cloth, i, h)
        for c in ti.static(range(3)):
            right[c, i] = value[c]


@ti.kernel
def run_round(cloth: ti.template(), stages: ti.template(), more: int, h: float, controls: row, both: table):
    """Goes the way that stands in `both`, and leaves the next right side there if there are `more` rounds."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(cloth.slot_count[None]):
            if cloth.inverse_mass[i] > 0.0:
                cloth.x[i] = cloth.x[i] + ti.math.vec3(both[0, i], both[1, i], both[2, i])
        if more:
            write_missing(cloth, stages, controls, h, both)


@ti.kernel
def fill(
    matrix: ti.types.sparse_matrix_builder(),
    rows: ti.types.ndarray(dtype=ti.i32, ndim=1),
    columns: ti.types.ndarray(dtype=ti.i32, ndim=1),
    values: row,
):
    ti.loop_config(serialize=True)
    for k in range(values.shape[0]):
        matrix[rows[k], columns[k]] += values[k]


class Factor:
    """The matrix M + h²L of one cloth, factorised (Cholesky, in float32)."""

    def __init__(self, topology: Topology, stiffness: NDArray[np.float64]) -> None:
        """`stiffness`: h²k of every spring [kg]. The row of a pin has its mass and nothing else, so it stays."""
        a, b = topology.ends.T
        inside = ~topology.pinned[a] & ~topology.pinned[b]
        count = topology.particle_count
        beside = np.bincount(a, stiffness, count) + np.bincount(b, stiffness, count)
        diagonal = topology.mass + np.where(topology.pinned, 0, beside)
        each, a, b, between = np.arange(count), a[inside], b[inside], -stiffness[inside]
        values = np.concatenate([diagonal, between, between]).astype(np.float32)
        builder = ti.linalg.SparseMatrixBuilder(count, count, max_num_triplets=len(values))
        fill(
            builder,
            np.concatenate([each, a, b]).astype(np.int32),
            np.concatenate([each, b, a]).astype(np.int32),
            values,
        )
        self._solver = ti.linalg.SparseSolver(dtype=ti.f32, solver_type="LLT")
        self._solver.compute(builder.build())
        self._held: tuple[int, Any] = (-1, None)

    def solve(self, both: NDArray[np.float32], held: int) -> None:
        """Replaces each of the three right sides, (3, N), by its solution; `held` ≥ 0 stays where it is.

        A force on the held particle alone moves the cloth by multiples of z, the solution for one newton there: the
        multiple that undoes its way is the force of the hand. So a grab needs one more solution and no new factor.
        """
        for c in range(3):
            both[c] = self._solver.solve(both[c])
        if held >= 0:
            if self._held[0] != held:
                one = np.zeros(both.shape[1], np.float32)
                one[held] = 1
                self._held = held, self._solver.solve(one)
            z = self._held[1]
            both -= both[:, held : held + 1] * (z / z[held])


class Projective(Solver):
    """Advances a cloth by local and global steps."""

    name = "projective"
    springs = "fabric"
    before = staticmethod(before)
    sweep = staticmethod(sweep)
    after = staticmethod(after)
    paths = ("list", "matrix-free")
    coloured = False

    def __init__(
        self, cloth: ClothState, topology: Topology, stiffness: NDArray[np.float64], stages: Stages, path: str
    ) -> None:
        super().__init__(cloth, topology, stiffness, replace(stages, spring_damping=False), path)
        self._topology = topology
        self._stiffness = stiffness
        self._factor: Factor | None = None
        self._factor_of = 0.0  # [s²] h² times the slider
        if path == "matrix-free":
            if topology.shape[1] >= LANES:
                self._lanes = lanes.take(topology, stiffness, coloured=stages.strain_limit)
            search_of(self._lanes or cloth)

    def advance_frame(self, frame: FrameInput) -> None:
        if self.path != "list":
            super().advance_frame(frame)
            return
        factor = self._factorised(frame.h**2 * float(frame.controls[STIFFNESS]))
        both = np.zeros((3, self._topology.particle_count), np.float32)
        substeps, iterations, h, held, *steering = frame.arguments
        for s in range(substeps):
            here = (self.cloth, self.stages, s, substeps, h, held, *steering)
            run_part(self.before, *here)
            both.fill(0.0)
            run_round(self.cloth, self.stages, True, h, frame.controls, both)
            for k in range(iterations):
                factor.solve(both, held)
                run_round(self.cloth, self.stages, k + 1 < iterations, h, frame.controls, both)
            run_part(self.after, *here)

    def _factorised(self, scale: float) -> Factor:
        """The factor for springs of `scale` [s²] times their stiffness: the last one, as long as nothing changes."""
        if self._factor is None or scale != self._factor_of:
            self._factor, self._factor_of = Factor(self._topology, self._stiffness * scale), scale
        return self._factor

    def close(self) -> None:
        super().close()
        self._factor = None
