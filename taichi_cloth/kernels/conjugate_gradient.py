"""Conjugate gradients (Hestenes and Stiefel 1952) for (M + h²K)·δ = r, without forming the matrix.

K is the stiffness matrix of springs and bending links at the present positions. A particle that is not free has
residual 0. The search starts at δ = 0 with r in `residual` and ends when the residual is `tolerance` of the first, or
after `MAX_PRODUCTS`. The mass matrix is the preconditioner. Spring forces are equal and opposite, so the residuals of a
free cloth always sum to 0, and the search conserves momentum wherever it stops.
"""

import taichi as ti

from .constraint_math import TINY
from .membrane_forces import MEMBRANE_PRODUCT, accumulate_membrane
from .simd_sweep import PairForce
from .springs import accumulate_pair_forces, effective_stiffness
from .step_params import STIFFNESS_FACTOR
from .vec import dot, length, max_lane, scale, select

TOLERANCE = 0.01  # a larger one saves a few products, and cloth in contact comes to rest later (docs/trials.md)
FULL_STEP = 2.44e-4  # [s] length h of a step from which on this is the tolerance: a stage of 1/1200 s
MIN_TOLERANCE = 1e-5  # in float32
MAX_PRODUCTS = 304  # of the matrix and a direction
MIN_SQUARES = 1e-30  # [kg·m²] squared residual over mass below which products leave the range of float32
MAX_SQUARES = 1e20  # [kg·m²] above which they may leave it too: the equation is then solved for a share of r
PARTIAL_SUMS = 256  # of a parallel inner product, always the same particles in each: equal bits every time


@ti.func
def init_particle(cloth: ti.template(), cg: ti.template(), i: int):
    cg.scaled[i] = scale(cg.residual[i], cloth.inverse_mass[i])
    cg.direction[i] = cg.scaled[i]
    cg.solution[i] = cg.residual[i] * 0.0


@ti.func
def unit_of(squares: float) -> float:
    """Return the unit of r and δ in which the products of a search stay in the range of float32."""
    return ti.select(squares > MAX_SQUARES, ti.sqrt(squares), 1.0)


@ti.func
def tolerance(h: float) -> float:
    """Return the residual at the end of a search over that at its start.

    The force that is left is this share of that of the springs. In short steps it falls as h², like the error of the
    steps: with the same share in all of them, shorter steps would soon gain nothing.
    """
    return ti.max(TOLERANCE * ti.min(1.0, (h / FULL_STEP) ** 2), MIN_TOLERANCE)


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
    """Return a spring's part of h²K·d; in the SIMD layout also that of the bending link beside it.

    Along its direction n a spring has its stiffness k. Across it, a spring of length l has k·(1 − rest/l) if it is
    stretched, and nothing if it is shortened.
    """
    gap, difference = cloth.x[a] - cloth.x[b], cloth.cg.direction[a] - cloth.cg.direction[b]
    norm = length(gap)
    inverse = 1.0 / ti.max(norm, TINY)
    k = effective_stiffness(features, params, norm - cloth.rest[e], stiffness)
    across = k * ti.max(0.0, 1.0 - cloth.rest[e] * inverse)
    along = (k - across) * (dot(gap, difference) * inverse * inverse)
    if ti.static(features.bending and cloth.is_simd):
        across += cloth.bending_links.stiffness[e]
    factor = params[STIFFNESS_FACTOR] * h * h
    return scale(difference, across * factor) + scale(gap, along * factor)


@ti.func
def bending_product(cloth: ti.template(), features: ti.template(), a, b, e, stiffness, params: ti.template(), h):
    """Return a bending link's part of h²K·d."""
    if ti.static(cloth.is_simd):
        stiffness = cloth.bending_links.stiffness[e]
    return scale(cloth.cg.direction[a] - cloth.cg.direction[b], stiffness * (params[STIFFNESS_FACTOR] * h * h))


STIFFNESS_PRODUCT = PairForce(stiffness_product, inputs=("x", "cg.direction"), target="cg.product")
BENDING_PRODUCT = PairForce(bending_product, inputs=("cg.direction",), target="cg.product")


@ti.func
def add_stiffness_products(cloth: ti.template(), features: ti.template(), params: ti.template(), h: float):
    """Add h²K·d of springs, or of the triangles of a membrane, and of bending links to the product."""
    if ti.static(features.membrane):
        accumulate_membrane(cloth, features, MEMBRANE_PRODUCT, params, h)
    else:
        accumulate_pair_forces(cloth, cloth, features, STIFFNESS_PRODUCT, params, h)
    # In the SIMD layout bending links are beside springs, which a membrane does not have.
    if ti.static(features.bending and (features.membrane or not cloth.is_simd)):
        accumulate_pair_forces(cloth, cloth.bending_links, features, BENDING_PRODUCT, params, h)


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
    unit = unit_of(squares)
    if unit != 1.0:
        for i in range(cloth.packet_count[None]):
            cg.residual[i] = cg.residual[i] * (1.0 / unit)
            init_particle(cloth, cg, i)
        squares = inner_product(cloth, cg.residual, cg.scaled)
    goal = ti.max(squares * tolerance(h) ** 2, MIN_SQUARES)
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
    if unit != 1.0:
        for i in range(cloth.packet_count[None]):
            cg.solution[i] = cg.solution[i] * unit


@ti.func
def largest_square(cloth: ti.template(), a: ti.template()):
    """Return the largest squared length of the vectors of all particles."""
    largest = dot(a[0], a[0])
    for i in range(1, cloth.packet_count[None]):
        largest = ti.max(largest, dot(a[i], a[i]))
    if ti.static(cloth.is_simd):
        return max_lane(largest)
    else:
        return largest


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
def parallel_largest_square(cloth: ti.template(), a: ti.template(), result: ti.template()):
    """Set `result` to the largest squared length of the vectors of all particles."""
    for t in range(PARTIAL_SUMS):
        largest = 0.0
        for n in range((cloth.packet_count[None] + PARTIAL_SUMS - 1 - t) // PARTIAL_SUMS):
            i = n * PARTIAL_SUMS + t
            largest = ti.max(largest, dot(a[i], a[i]))
        cloth.cg.partial[t] = largest
    for _ in range(1):
        largest = 0.0
        for t in range(PARTIAL_SUMS):
            largest = ti.max(largest, cloth.cg.partial[t])
        result[None] = largest


@ti.func
def cg_init(cloth: ti.template(), cg: ti.template(), h: float):
    """Start the search. `largest_move` holds the unit of δ until `cg_finish`."""
    for i in range(cloth.packet_count[None]):
        init_particle(cloth, cg, i)
    parallel_inner_product(cloth, cg.residual, cg.scaled, cg.squares)
    for _ in range(1):
        cg.largest_move[None] = unit_of(cg.squares[None])
    for i in range(cloth.packet_count[None]):
        cg.residual[i] = cg.residual[i] * (1.0 / cg.largest_move[None])
        init_particle(cloth, cg, i)
    parallel_inner_product(cloth, cg.residual, cg.scaled, cg.squares)
    for _ in range(1):
        cg.goal[None] = ti.max(cg.squares[None] * tolerance(h) ** 2, MIN_SQUARES)


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


@ti.func
def cg_finish(cloth: ti.template(), cg: ti.template()):
    for i in range(cloth.packet_count[None]):
        cg.solution[i] = cg.solution[i] * cg.largest_move[None]
