"""Conjugate gradients (Hestenes and Stiefel 1952) for (M + h²L)·δ = right side, without ever forming the matrix.

L is the Laplacian of springs and bonds, weighted by their constants. A particle that is not free takes no part: its
residual is 0. The search begins at δ = 0 with the right side in `residual`, and ends when the residual is `TOLERANCE`
of the first, or after `MOST_PRODUCTS`: the next round sees what is left. The mass matrix is the preconditioner. Spring
forces are equal and opposite, so the residuals of a cloth that nothing holds always sum to 0, and the search conserves
its momentum wherever it stops.
"""

import taichi as ti

from .controls import STIFFNESS
from .maths import TINY
from .places import choose, dot, times
from .springs import sum_links
from .strips import Share

TOLERANCE = 0.01  # a smaller one costs products and gains little, since the next round starts anew: docs/trials.md
MOST_PRODUCTS = 304  # of the matrix and a direction
LEAST_SQUARES = 1e-30  # [kg·m²] squared residuals over mass, below which products would leave float32
PARTIAL_SUMS = 256  # of a sum over all particles by many threads, always the same ones: equal bits every time


# -- one particle's part -------------------------------------------------------------------------------------------


@ti.func
def set_out(cloth: ti.template(), search: ti.template(), i: int):
    search.scaled[i] = times(search.residual[i], cloth.inverse_mass[i])
    search.direction[i] = search.scaled[i]
    search.way[i] = search.residual[i] * 0.0


@ti.func
def begin_product(cloth: ti.template(), search: ti.template(), i: int):
    """M·d. The springs add their part."""
    search.product[i] = times(search.direction[i], 1.0 / ti.max(cloth.inverse_mass[i], TINY))


@ti.func
def go_on(cloth: ti.template(), search: ti.template(), i: int, ahead: float):
    search.way[i] = search.way[i] + search.direction[i] * ahead
    left = search.residual[i] - search.product[i] * ahead
    search.residual[i] = choose(cloth.inverse_mass[i] > 0.0, left, left * 0.0)
    search.scaled[i] = times(search.residual[i], cloth.inverse_mass[i])


@ti.func
def turn(search: ti.template(), i: int, share: float):
    search.direction[i] = search.scaled[i] + search.direction[i] * share


# -- all in one serial search --------------------------------------------------------------------------------------


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
def resist(cloth: ti.template(), stages: ti.template(), a, b, e, stiffness, controls: ti.template(), h):
    """A spring's share of h²L times the direction."""
    gap = cloth.search.direction[a] - cloth.search.direction[b]
    if ti.static(stages.bending and cloth.in_lanes):
        stiffness += cloth.bonds.stiffness[e]
    return times(gap, stiffness * (controls[STIFFNESS] * h * h))


RESIST = Share(resist, reads=("search.direction",), into="search.product")


@ti.func
def add_products(cloth: ti.template(), stages: ti.template(), controls: ti.template(), h: float):
    """h²L times the direction, of springs and of bonds."""
    sum_links(cloth, cloth, stages, RESIST, controls, h)
    if ti.static(stages.bending and not cloth.in_lanes):
        sum_links(cloth, cloth.bonds, stages, RESIST, controls, h)


@ti.func
def find_way(cloth: ti.template(), search: ti.template(), stages: ti.template(), controls: ti.template(), h: float):
    """From the right side in `residual` to δ in `way`."""
    for i in range(cloth.slot_count[None]):
        set_out(cloth, search, i)
    squares = inner(cloth, search.residual, search.scaled)
    goal = ti.max(squares * TOLERANCE**2, LEAST_SQUARES)
    products = 0
    while squares > goal and products < MOST_PRODUCTS:
        products += 1
        for i in range(cloth.slot_count[None]):
            begin_product(cloth, search, i)
        add_products(cloth, stages, controls, h)
        ahead = squares / inner(cloth, search.direction, search.product)
        for i in range(cloth.slot_count[None]):
            go_on(cloth, search, i, ahead)
        before = squares
        squares = inner(cloth, search.residual, search.scaled)
        for i in range(cloth.slot_count[None]):
            turn(search, i, squares / before)


# -- a thread for each particle: `begin_search`, then `search_on` until `squares` is down to `goal` ------------------


@ti.func
def inner_of_many(cloth: ti.template(), a: ti.template(), b: ti.template(), result: ti.template()):
    """The same by many threads: sums of every 256th particle, and then of those."""
    for t in range(PARTIAL_SUMS):
        total = 0.0
        for n in range((cloth.slot_count[None] + PARTIAL_SUMS - 1 - t) // PARTIAL_SUMS):
            i = n * PARTIAL_SUMS + t
            total += dot(a[i], b[i])
        cloth.search.partial[t] = total
    for _ in range(1):
        total = 0.0
        for t in range(PARTIAL_SUMS):
            total += cloth.search.partial[t]
        result[None] = total


@ti.func
def begin_search(cloth: ti.template(), search: ti.template()):
    for i in range(cloth.slot_count[None]):
        set_out(cloth, search, i)
    inner_of_many(cloth, search.residual, search.scaled, search.squares)
    for _ in range(1):
        search.goal[None] = ti.max(search.squares[None] * TOLERANCE**2, LEAST_SQUARES)


@ti.func
def search_on(cloth: ti.template(), search: ti.template(), stages: ti.template(), controls: ti.template(), h: float):
    """One product; nothing moves any more once the goal is reached."""
    for i in range(cloth.slot_count[None]):
        begin_product(cloth, search, i)
    add_products(cloth, stages, controls, h)
    inner_of_many(cloth, search.direction, search.product, search.slope)
    for i in range(cloth.slot_count[None]):
        if search.squares[None] > search.goal[None]:
            go_on(cloth, search, i, search.squares[None] / search.slope[None])
    for _ in range(1):
        search.before[None] = search.squares[None]
    inner_of_many(cloth, search.residual, search.scaled, search.squares)
    for i in range(cloth.slot_count[None]):
        if search.squares[None] > search.goal[None]:
            turn(search, i, search.squares[None] / search.before[None])
