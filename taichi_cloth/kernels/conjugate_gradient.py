"""Conjugate gradients (Hestenes and Stiefel 1952) for (M + h²L)·δ = r, without forming the matrix.

L is the Laplacian of springs and bending links, weighted by their stiffness. A particle that is not free has residual
0. The search starts at δ = 0 with r in `residual` and ends when the residual is `TOLERANCE` of the first, or after
`MAX_PRODUCTS`; the next round takes up what is left. The mass matrix is the preconditioner. Spring forces are equal and
opposite, so the residuals of a free cloth always sum to 0, and the search conserves momentum wherever it stops.
"""

import taichi as ti

from .constraint_math import TINY
from .simd_sweep import PairForce
from .springs import accumulate_pair_forces
from .step_params import STIFFNESS_FACTOR
from .vec import dot, scale, select

TOLERANCE = 0.01  # a smaller one costs products and gains little, since the next round starts anew (docs/trials.md)
MAX_PRODUCTS = 304  # of the matrix and a direction
MIN_SQUARES = 1e-30  # [kg·m²] squared residual over mass below which products leave the range of float32
PARTIAL_SUMS = 256  # of a parallel inner product, always the same particles in each: equal bits every time


@ti.func
def init_particle(cloth: ti.template(), cg: ti.template(), i: int):
    cg.scaled[i] = scale(cg.residual[i], cloth.inverse_mass[i])
    cg.direction[i] = cg.scaled[i]
    cg.solution[i] = cg.residual[i] * 0.0


@ti.func
def init_product(cloth: ti.template(), cg: ti.template(), i: int):
    """Set the product to M·d; springs add their part."""
    cg.product[i] = scale(cg.direction[i], 1.0 / ti.max(cloth.inverse_mass[i], TINY))


@ti.func
def update_particle(cloth: ti.template(), cg: ti.template(), i: int, step: float):
    cg.solution[i] = cg.solution[i] + cg.direction[i] * step
    residual = cg.residual[i] - cg.product[i] * step
    cg.residual[i] = select(cloth.inverse_mass[i] > 0.0, residual, residual * 0.0)
    cg.scaled[i] = scale(cg.residual[i], cloth.inverse_mass[i])


@ti.func
def update_direction(cg: ti.template(), i: int, beta: float):
    cg.direction[i] = cg.scaled[i] + cg.direction[i] * beta


@ti.func
def stiffness_product(cloth: ti.template(), features: ti.template(), a, b, e, stiffness, params: ti.template(), h):
    """Return a spring's part of h²L·d."""
    gap = cloth.cg.direction[a] - cloth.cg.direction[b]
    if ti.static(features.bending and cloth.is_simd):
        stiffness += cloth.bending_links.stiffness[e]
    return scale(gap, stiffness * (params[STIFFNESS_FACTOR] * h * h))


STIFFNESS_PRODUCT = PairForce(stiffness_product, inputs=("cg.direction",), target="cg.product")


@ti.func
def add_stiffness_products(cloth: ti.template(), features: ti.template(), params: ti.template(), h: float):
    """Add h²L·d of springs and bending links to the product."""
    accumulate_pair_forces(cloth, cloth, features, STIFFNESS_PRODUCT, params, h)
    if ti.static(features.bending and not cloth.is_simd):
        accumulate_pair_forces(cloth, cloth.bending_links, features, STIFFNESS_PRODUCT, params, h)


# -- a serial search -------------------------------------------------------------------------------------------------


@ti.func
def inner_product(cloth: ti.template(), a: ti.template(), b: ti.template()):
    """Return a·b over the whole cloth."""
    total = dot(a[0], b[0])
    for i in range(1, cloth.packet_count[None]):
        total += dot(a[i], b[i])
    if ti.static(cloth.is_simd):
        return total.sum()
    else:
        return total


@ti.func
def cg_solve(cloth: ti.template(), cg: ti.template(), features: ti.template(), params: ti.template(), h: float):
    """Solve for δ in `solution` from r in `residual`."""
    for i in range(cloth.packet_count[None]):
        init_particle(cloth, cg, i)
    squares = inner_product(cloth, cg.residual, cg.scaled)
    goal = ti.max(squares * TOLERANCE**2, MIN_SQUARES)
    products = 0
    while squares > goal and products < MAX_PRODUCTS:
        products += 1
        for i in range(cloth.packet_count[None]):
            init_product(cloth, cg, i)
        add_stiffness_products(cloth, features, params, h)
        step = squares / inner_product(cloth, cg.direction, cg.product)
        for i in range(cloth.packet_count[None]):
            update_particle(cloth, cg, i, step)
        before = squares
        squares = inner_product(cloth, cg.residual, cg.scaled)
        for i in range(cloth.packet_count[None]):
            update_direction(cg, i, squares / before)


# -- a parallel search: `cg_init`, then `cg_iterate` until `squares` is down to `goal` -------------------------------


@ti.func
def parallel_inner_product(cloth: ti.template(), a: ti.template(), b: ti.template(), result: ti.template()):
    """Set `result` to a·b: sums of every 256th particle, then the sum of those."""
    for t in range(PARTIAL_SUMS):
        total = 0.0
        for n in range((cloth.packet_count[None] + PARTIAL_SUMS - 1 - t) // PARTIAL_SUMS):
            i = n * PARTIAL_SUMS + t
            total += dot(a[i], b[i])
        cloth.cg.partial[t] = total
    for _ in range(1):
        total = 0.0
        for t in range(PARTIAL_SUMS):
            total += cloth.cg.partial[t]
        result[None] = total


@ti.func
def cg_init(cloth: ti.template(), cg: ti.template()):
    for i in range(cloth.packet_count[None]):
        init_particle(cloth, cg, i)
    parallel_inner_product(cloth, cg.residual, cg.scaled, cg.squares)
    for _ in range(1):
        cg.goal[None] = ti.max(cg.squares[None] * TOLERANCE**2, MIN_SQUARES)


@ti.func
def cg_iterate(cloth: ti.template(), cg: ti.template(), features: ti.template(), params: ti.template(), h: float):
    """One product. Nothing changes once the goal is reached."""
    for i in range(cloth.packet_count[None]):
        init_product(cloth, cg, i)
    add_stiffness_products(cloth, features, params, h)
    parallel_inner_product(cloth, cg.direction, cg.product, cg.curvature)
    for i in range(cloth.packet_count[None]):
        if cg.squares[None] > cg.goal[None]:
            update_particle(cloth, cg, i, cg.squares[None] / cg.curvature[None])
    for _ in range(1):
        cg.previous_squares[None] = cg.squares[None]
    parallel_inner_product(cloth, cg.residual, cg.scaled, cg.squares)
    for i in range(cloth.packet_count[None]):
        if cg.squares[None] > cg.goal[None]:
            update_direction(cg, i, cg.squares[None] / cg.previous_squares[None])
