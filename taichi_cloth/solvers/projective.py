"""`projective`: backward Euler as a minimisation, by rounds that all solve with one and the same matrix.

Liu, Bargteil, O'Brien and Kavan 2013, *Fast simulation of mass-spring systems*: with y = x + h·v + h²·a the place
without springs, the substep ends where ½(x − y)ᵀM(x − y) + h²·E(x) is least. Given the direction d_ij, as long as at
rest, that each spring would have (local step), that is linear: (M + h²L)·x = M·y + h²·J·d (eq. 14, global step).
Here the equation is solved for the way δ still to go. Its right side is then what is missing to equilibrium, with
the plain forces f of the springs and the ways that were gone, and loses nothing to float32:

    (M + h²L)·δ = h²·f(x) − M·Σδ,    x ← x + δ

The matrix is constant: path `list` factorises it once and then only substitutes, as the paper does. The others never
form it: they solve by conjugate gradients, with one sweep over the springs for every product. In strips that takes a
third of the time for 720 particles, and about the same for 4096: so it is what grids get.
Dashpots (`damping_time`) are left out: backward Euler damps by itself.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..contact.push_out import push_out
from ..contact.responses import add_repulsion
from ..contact.self_collision import keep_apart
from ..contact.sticking import forget_anchors
from ..contact.tangles import find_tangles
from ..kernels.conjugate import MOST_PRODUCTS, PARTIAL_SUMS, begin_search, find_way, search_on
from ..kernels.controls import KEPT, STIFFNESS, row, table
from ..kernels.forces import add_air, take_force
from ..kernels.grab import lead_held
from ..kernels.maths import TINY
from ..kernels.motion import displace, move_freely
from ..kernels.places import LANES, choose, times
from ..kernels.springs import add_spring_forces, limit_strain
from ..kernels.tethers import pull_tethers
from ..mesh.topology import Topology
from ..state import ClothState
from ..state.fields import like_places
from ..state.pool import attached
from ..state.search import search_of
from .base import FrameInput, Solver, Stages, run_serially

PRODUCTS_A_LOOK = 8  # of the matrix and a direction, between two looks at how far it is; divides MOST_PRODUCTS


# -- all paths -----------------------------------------------------------------------------------------------------


@ti.func
def before(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """Every particle to y, where it would be without springs, and what is held to the hand."""
    find_tangles(cloth, stages, now)
    forget_anchors(cloth, stages, now)
    add_air(cloth, stages, now, now.s)
    add_repulsion(cloth, stages, now, now.s)
    move_freely(cloth, stages, now.controls, now.h, now.controls[KEPT], now.h)
    lead_held(cloth, stages, now, now.s + 1.0)
    for i in range(cloth.slot_count[None]):
        cloth.gone[i] = cloth.x[i] * 0.0


@ti.func
def missing(cloth: ti.template(), i: int, h: float):
    """Right side of the equation [kg·m], and 0 for a particle that is not free. Takes the force."""
    mass = 1.0 / ti.max(cloth.inverse_mass[i], TINY)
    both = take_force(cloth, i) * (h * h) - times(cloth.gone[i], mass)
    return choose(cloth.inverse_mass[i] > 0.0, both, both * 0.0)


@ti.func
def go(cloth: ti.template(), stages: ti.template(), i: int, way, h: float):
    displace(cloth, stages, i, way, h)
    cloth.gone[i] = cloth.gone[i] + way


@ti.func
def after(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """Tethers, contact and the strain limit."""
    pull_tethers(cloth, stages, now)
    keep_apart(cloth, stages, now)
    push_out(cloth, stages, now)
    limit_strain(cloth, stages, now.controls, now.h)


# -- by conjugate gradients ----------------------------------------------------------------------------------------


@ti.func
def write_residual(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    add_spring_forces(cloth, stages, now.controls, now.h)
    for i in range(cloth.slot_count[None]):
        cloth.search.residual[i] = missing(cloth, i, now.h)


@ti.func
def go_the_way(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    for i in range(cloth.slot_count[None]):
        go(cloth, stages, i, cloth.search.way[i], now.h)


@ti.func
def sweep(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """One round without a matrix."""
    write_residual(cloth, stages, now)
    find_way(cloth, cloth.search, stages, now.controls, now.h)
    go_the_way(cloth, stages, now)


@ti.func
def begin_round(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    write_residual(cloth, stages, now)
    begin_search(cloth, cloth.search)


@ti.func
def go_on_searching(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    search_on(cloth, cloth.search, stages, now.controls, now.h)


# -- by a factor ---------------------------------------------------------------------------------------------------


@ti.func
def write_missing(cloth: ti.template(), stages: ti.template(), controls: ti.template(), h: float, right: ti.template()):
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
                go(cloth, stages, i, ti.math.vec3(both[0, i], both[1, i], both[2, i]), h)
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

    def __init__(
        self, topology: Topology, stiffness: NDArray[np.float64], scale: float, led: NDArray[np.bool_]
    ) -> None:
        """`stiffness` of every spring [N/m], `scale` h² [s²]. The row of one that is `led` has its mass only: it stays.

        A grab makes a new factor, as a pin does (24×24: 3 ms, 128×128: 0.15 s).
        """
        a, b = np.concatenate([topology.ends, topology.bonds.ends]).T
        stiffness = np.concatenate([stiffness, topology.bonds.constant]) * scale
        inside = ~led[a] & ~led[b]
        count = topology.particle_count
        beside = np.bincount(a, stiffness, count) + np.bincount(b, stiffness, count)
        diagonal = topology.mass + np.where(led, 0, beside)
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

    def solve(self, both: NDArray[np.float32]) -> None:
        """Replaces each of the three right sides, (3, N), by its solution."""
        for c in range(3):
            both[c] = self._solver.solve(both[c])


class Projective(Solver):
    """Advances a cloth by local and global steps."""

    name = "projective"
    springs = "fabric"
    before = staticmethod(before)
    sweep = staticmethod(sweep)
    after = staticmethod(after)
    coloured = False
    narrowest = LANES // 2  # by a factor a frame takes 15 ms of calls alone: 5×5 particles 16 ms, in strips 1.4 ms

    def __init__(
        self, cloth: ClothState, topology: Topology, stiffness: NDArray[np.float64], stages: Stages, path: str
    ) -> None:
        super().__init__(cloth, topology, stiffness, replace(stages, spring_damping=False), path)
        self._topology = topology
        self._stiffness = stiffness
        self._factor: Factor | None = None
        self._factor_of: tuple[float, bytes] = (0.0, b"")  # [s²] h² times the slider; who is led
        attached(self.work, "gone", lambda: like_places(self.work))  # [m] Σδ of a substep
        if path != "list":
            search_of(self.work, PARTIAL_SUMS)

    def advance_frame(self, frame: FrameInput) -> None:
        if self.path == "list":
            self._advance_by_factor(frame)
        elif self.path == "lanes":
            super().advance_frame(frame)
        else:
            self._advance_by_searching(frame)

    def _advance_by_factor(self, frame: FrameInput) -> None:
        factor = self._factorised(frame.h**2 * float(frame.controls[STIFFNESS]))
        both = np.zeros((3, self._topology.particle_count), np.float32)
        substeps, iterations, h, *steering = frame.arguments
        for s in range(frame.first, frame.last):
            here = (self.cloth, self.stages, s, substeps, h, *steering)
            run_serially(self.before, *here)
            both.fill(0.0)
            run_round(self.cloth, self.stages, True, h, frame.controls, both)
            for k in range(iterations):
                factor.solve(both)
                run_round(self.cloth, self.stages, k + 1 < iterations, h, frame.controls, both)
            run_serially(self.after, *here)

    def _advance_by_searching(self, frame: FrameInput) -> None:
        search = self.work.search

        for s in range(frame.first, frame.last):

            def run(*parts: Any, s: int = s) -> None:
                self.launches.run([(part, s) for part in parts], frame.steering)

            run(self.before)
            for _ in range(frame.iterations):
                run(begin_round)
                goal = search.goal[None]
                for _ in range(MOST_PRODUCTS // PRODUCTS_A_LOOK):
                    if search.squares[None] <= goal:
                        break
                    run(*[go_on_searching] * PRODUCTS_A_LOOK)
                run(go_the_way)
            run(self.after)

    def _factorised(self, scale: float) -> Factor:
        """The factor for springs of `scale` [s²] times their stiffness: the last one, as long as nothing changes."""
        led = self.cloth.taken(self.cloth.inverse_mass) == 0
        factor_of = scale, led.tobytes()
        if self._factor is None or factor_of != self._factor_of:
            self._factor, self._factor_of = Factor(self._topology, self._stiffness, scale, led), factor_of
        return self._factor

    def _frequency(self, topology: Topology, stiffness: NDArray[np.float64]) -> float:
        return 0.0  # springs and bonds are both in the matrix

    def weave(self, topology: Topology, stiffness: NDArray[np.float64]) -> None:
        super().weave(topology, stiffness)
        self._topology, self._stiffness, self._factor = topology, stiffness, None

    def close(self) -> None:
        super().close()
        self._factor = None
