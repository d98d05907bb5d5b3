"""Chains of springs solved exactly: each linearised where it is, and all its multipliers found at once.

For the springs j of one chain, with unit vectors n_j from particle j to j + 1, length errors C_j, K_j = k·h² and the
inverse masses w, the changes dλ_j of the multipliers fulfil (Macklin 2016, eq. 18, for a chain; times K_j)

    (1 + K_j·(w_j + w_j+1))·dλ_j − K_j·g_j·dλ_j−1 − K_j·g_j+1·dλ_j+1 = −K_j·C_j − λ_j,   g_j = w_j·n_j−1·n_j

which is tridiagonal: one way down the chain eliminates, one way up finds the changes (Thomas), and particle j moves by
w_j·(n_j−1·dλ_j−1 − n_j·dλ_j). Every pivot is at least 1; K = 0 is no spring, and no neighbour feels it.
"""

from math import prod
from typing import Any

import taichi as ti
import taichi.math as tm

from ..mesh.chains import (
    ALONG,
    CHAINED,
    COUNT,
    END,
    FIRST,
    KINDS,
    LINKS,
    MASSES,
    PARTICLE,
    PITCH,
    ROWS,
    SPRINGS,
    START,
    STRIDE,
)
from .controls import DAMPING_TIME, STIFFNESS
from .maths import TINY
from .places import COMPONENTS, LANES, dot, from_next, from_previous, length, next_lane, spread, times
from .springs import bearing, forget_multipliers
from .strips import row_kind
from .writing import shape_of


@ti.func
def eliminate(
    stages: ti.template(),
    controls: ti.template(),
    gap,
    old_gap,
    w_here,
    w_both,
    rest,
    stiffness,
    multiplier,
    gamma: float,
    n_before,
    share_before,
    change_before,
):
    """One spring on the way down: its n, share, coupling and change.

    `stiffness` is K and `w_here` that of the joint with the spring before. On the way up, what is found for this spring
    is change + coupling·found of the next; `share` is how strongly the next one's coupling acts. Dashpots: as in
    `maths.project_compliant`, with `old_gap` the gap a substep ago.
    """
    long = length(gap)
    n = times(gap, ti.select(stiffness > 0.0, 1.0, 0.0) / ti.max(long, TINY))
    error = long - rest
    bears = bearing(stages, controls, error - multiplier * w_both, stiffness)
    damped = bears
    if ti.static(stages.spring_damping):
        error += gamma * dot(n, gap - old_gap)
        damped *= 1.0 + gamma
    g = w_here * dot(n_before, n)
    share = 1.0 / (1.0 + damped * (w_both - g * g * share_before))
    change = (damped * g * change_before - bears * error - multiplier) * share
    return n, damped * share, g * share_before, change


@ti.func
def solve_chains(cloth: ti.template(), stages: ti.template(), controls: ti.template(), h: float):
    """Every row, then every column, then both diagonals, one chain after another. Velocities take it up at once."""
    if ti.static(cloth.in_lanes):
        solve_strips(cloth, cloth.chains, stages, controls, h)
    else:
        solve_list(cloth, cloth.chains, stages, controls, h)


@ti.func
def gamma_of(stages: ti.template(), controls: ti.template(), h: float):
    """Damping time over the substep; 0 without dashpots."""
    gamma = 0.0
    if ti.static(stages.spring_damping):
        gamma = controls[DAMPING_TIME] / h
    return gamma


# -- a chain after another -----------------------------------------------------------------------------------------


@ti.func
def solve_list(cloth: ti.template(), chains: ti.template(), stages: ti.template(), controls: ti.template(), h: float):
    """Chains of one direction share no particle: where threads run side by side, each takes one."""
    if ti.static(cloth.gathers):
        for d in ti.static(range(len(CHAINED))):
            for k in range(chains.first[d], chains.first[d + 1]):
                solve_chain(cloth, chains, stages, k, controls, h)
    else:
        for k in range(chains.first[ti.static(len(CHAINED))]):
            solve_chain(cloth, chains, stages, k, controls, h)


@ti.func
def solve_chain(
    cloth: ti.template(), chains: ti.template(), stages: ti.template(), k: int, controls: ti.template(), h: float
):
    scale = controls[STIFFNESS] * h * h
    gamma = gamma_of(stages, controls, h)
    chain = chains.table[k]
    stride, first = chain[STRIDE], chain[FIRST]
    n, share, change = tm.vec3(0.0), 0.0, 0.0
    for j in range(chain[COUNT]):
        a = chain[PARTICLE] + j * stride
        b = a + stride
        e = chains.springs[first + j]
        gap = cloth.x[b] - cloth.x[a]
        old_gap = gap
        if ti.static(stages.spring_damping):
            old_gap = cloth.x_prev[b] - cloth.x_prev[a]
        w_a = cloth.inverse_mass[a]
        n, share, coupling, change = eliminate(
            stages,
            controls,
            gap,
            old_gap,
            w_a,
            w_a + cloth.inverse_mass[b],
            cloth.rest[e],
            cloth.stiffness[e] * scale,
            cloth.multiplier[e],
            gamma,
            n,
            share,
            change,
        )
        chains.normal[first + j] = n
        chains.coupling[first + j] = coupling
        chains.change[first + j] = change
    carried = 0.0  # what the spring below adds to the change of this one
    below = tm.vec3(0.0)  # n·dλ of the spring below
    for r in range(chain[COUNT]):
        j = chain[COUNT] - 1 - r
        b = chain[PARTICLE] + (j + 1) * stride
        e = chains.springs[first + j]
        found = chains.change[first + j] + carried
        cloth.multiplier[e] = cloth.multiplier[e] + found
        above = chains.normal[first + j] * found
        move_along(cloth, b, above - below, h)
        carried = chains.coupling[first + j] * found
        below = above
    top = chain[PARTICLE]
    move_along(cloth, top, -below, h)


@ti.func
def move_along(cloth: ti.template(), i: int, pull, h: float):
    """Place and velocity together; `pull` [kg·m]."""
    move = pull * cloth.inverse_mass[i]
    cloth.x[i] = cloth.x[i] + move
    cloth.velocity[i] = cloth.velocity[i] + move * (1.0 / h)


# -- eight chains at once ------------------------------------------------------------------------------------------


@ti.func
def solve_strips(cloth: ti.template(), chains: ti.template(), stages: ti.template(), controls: ti.template(), h: float):
    """In strips of its own, where every chain goes from row to row: a cloth's rows are laid down its columns first."""
    for upright in range(2):
        layout = chains.layouts[upright]
        if layout[START] < layout[END]:
            lay(cloth, layout, upright, cloth.x, chains.x, 0)
            for slot in range(layout[ROWS] * layout[PITCH]):
                chains.moved[slot] = spread(tm.vec3(0.0), chains.moved[slot])
            if ti.static(stages.spring_damping):
                lay(cloth, layout, upright, cloth.x_prev, chains.x_prev, 0)
            for n in range(layout[START], layout[END]):
                solve_direction(chains, stages, layout, n, controls, h)
            lay_back(cloth, chains, layout, upright, h)


@ti.func
def solve_direction(chains: ti.template(), stages: ti.template(), layout, d: int, controls: ti.template(), h: float):
    """The chains that go down the rows and `along` the columns: 0, 1 or −1 a row.

    A link is a place for the spring of each slot, with a column more at both sides that holds what stands beyond
    the strip, and a row of zeros above and below.
    """
    rows, pitch = layout[ROWS], layout[PITCH]
    wide = pitch + 2
    scale = controls[STIFFNESS] * h * h
    gamma = gamma_of(stages, controls, h)
    spare = ti.static(chains.x.shape[0] - 1)
    spare_mass = ti.static(chains.inverse_mass.shape[0] - 1)
    for y in range(rows - 1):
        direction = chains.directions[d]
        along = direction[ALONG]
        right_up = along < 0  # the right end of a spring is its upper one
        at_left = (y + 1 if right_up else y) * pitch
        at_right = (y if right_up else y + 1) * pitch + ti.abs(along)
        e = direction[SPRINGS] + y * pitch
        k = direction[KINDS] + row_kind(y, rows) * pitch
        line = layout[LINKS] + (y + 1) * wide + 1
        if along != 0:  # what the last springs of the row end at
            beyond = at_right + pitch - 1 - pitch
            chains.x[spare] = next_lane(chains.x[beyond])
            chains.inverse_mass[spare_mass] = next_lane(chains.inverse_mass[layout[MASSES] + beyond])
            if ti.static(stages.spring_damping):
                chains.x_prev[spare] = next_lane(chains.x_prev[beyond])
        for i in range(pitch):
            q, before = line + i, line + i - wide - along
            over = i == pitch - 1 and along != 0
            a, b = at_left + i, spare if over else at_right + i
            w_a = chains.inverse_mass[layout[MASSES] + a]
            w_b = chains.inverse_mass[spare_mass if over else layout[MASSES] + b]
            gap = chains.x[b] - chains.x[a]
            old_gap = gap
            if ti.static(stages.spring_damping):
                old_gap = chains.x_prev[b] - chains.x_prev[a]
            n, share, coupling, change = eliminate(
                stages,
                controls,
                gap,
                old_gap,
                w_b if right_up else w_a,
                w_a + w_b,
                chains.rest[e + i],
                chains.stiffness[k + i] * scale,
                chains.multiplier[e + i],
                gamma,
                chains.normal[before],
                chains.share[before],
                chains.change[before],
            )
            chains.normal[q] = n
            chains.share[q] = share
            chains.coupling[q] = coupling
            chains.change[q] = change
        if along > 0:
            last = line + pitch - 1
            chains.normal[line - 1] = from_previous(chains.normal[last])
            chains.share[line - 1] = from_previous(chains.share[last])
            chains.change[line - 1] = from_previous(chains.change[last])
        elif along < 0:
            chains.normal[line + pitch] = from_next(chains.normal[line])
            chains.share[line + pitch] = from_next(chains.share[line])
            chains.change[line + pitch] = from_next(chains.change[line])
    # On the way up, `coupling` becomes what a spring adds to the change of the one above it, and `normal` n·dλ.
    for r in range(rows):
        direction = chains.directions[d]
        along = direction[ALONG]
        into, out_of = ti.max(along, 0), wide - ti.max(-along, 0)  # where a particle's springs stand
        sign = -1.0 if along < 0 else 1.0  # n goes from left to right
        y = rows - 2 - r
        e = direction[SPRINGS] + y * pitch
        line = layout[LINKS] + (y + 1) * wide + 1
        if y >= 0:
            for i in range(pitch):
                q = line + i
                found = chains.change[q] + chains.coupling[q + wide + along]
                chains.multiplier[e + i] = chains.multiplier[e + i] + found
                chains.normal[q] = times(chains.normal[q], found)
                chains.coupling[q] = chains.coupling[q] * found
            if along != 0:
                chains.normal[line - 1] = from_previous(chains.normal[line + pitch - 1])
                chains.coupling[line - 1] = from_previous(chains.coupling[line + pitch - 1])
                chains.coupling[line + pitch] = from_next(chains.coupling[line])
        for i in range(pitch):
            p, q = (y + 1) * pitch + i, line + i
            pull = chains.normal[q - into] - chains.normal[q + out_of]
            move = times(pull, chains.inverse_mass[layout[MASSES] + p] * sign)
            chains.x[p] = chains.x[p] + move
            chains.moved[p] = chains.moved[p] + move


def components(field: Any) -> int:
    """How many rows of eight of a slot say something: three of a place, one of a number."""
    return min(prod(shape_of(field)[:-1]), 3)


@ti.func
def tile_for(field: ti.template()):
    """Room for eight slots of a field."""
    return ti.Matrix.zero(ti.f32, LANES, ti.static(components(field) * LANES))


@ti.func
def turn(field: ti.template(), first: int, stride: int, last: int, tile: ti.template()):
    """Eight slots, `stride` apart and none behind `last`, turned: row k of the tile holds lane k of all."""
    for n in range(LANES):
        slot = field[ti.min(first + n * stride, last)]
        for k in ti.static(range(LANES)):
            if ti.static(components(field) == 1):
                tile[k, n] = slot[k]
            else:
                for c in ti.static(range(components(field))):
                    tile[k, c * LANES + n] = slot[c, k]


@ti.func
def row_of_tile(tile: ti.template(), k: int, field: ti.template()):
    """Row k as a slot of the field."""
    if ti.static(components(field) == 1):
        return ti.Vector([tile[k, n] for n in ti.static(range(LANES))])
    else:
        return ti.Matrix(
            [
                [tile[k, c * LANES + n] if ti.static(c < 3) else 0.0 for n in ti.static(range(LANES))]
                for c in ti.static(range(COMPONENTS))
            ]
        )


@ti.func
def lay(cloth: ti.template(), layout, upright: int, places: ti.template(), laid: ti.template(), first: int):
    """Places, or numbers, of the cloth into the strips of a layout, from slot `first` on.

    Strips of rows hold a row's particles one below the other; lanes without a row take the last.
    """
    pitch, across, last = cloth.pitch[None], layout[PITCH], cloth.rows[None] - 1
    if upright:
        for slot in range(cloth.slot_count[None]):
            laid[first + slot] = places[slot]
    else:
        for j in range(across):
            for i in range(pitch):
                turned = tile_for(places)
                turn(places, j * pitch + i, across * pitch, last * pitch + i, turned)
                for k in range(LANES):  # column k·pitch + i
                    laid[first + (k * pitch + i) * across + j] = row_of_tile(turned, k, places)


@ti.func
def lay_back(cloth: ti.template(), chains: ti.template(), layout, upright: int, h: float):
    """The places back into the cloth, and what moved them into its velocities."""
    pitch, across = cloth.pitch[None], layout[PITCH]
    if upright:
        for slot in range(cloth.slot_count[None]):
            cloth.x[slot] = chains.x[slot]
            cloth.velocity[slot] = cloth.velocity[slot] + chains.moved[slot] * (1.0 / h)
    else:
        for j in range(across):
            for i in range(pitch):
                x, moved = tile_for(chains.x), tile_for(chains.moved)
                start, step = i * across + j, pitch * across
                turn(chains.x, start, step, start + LANES * step, x)
                turn(chains.moved, start, step, start + LANES * step, moved)
                for lane in range(LANES):
                    y = lane * across + j
                    if y < cloth.rows[None]:
                        slot = y * pitch + i
                        cloth.x[slot] = row_of_tile(x, lane, chains.x)
                        cloth.velocity[slot] = cloth.velocity[slot] + row_of_tile(moved, lane, chains.moved) * (1.0 / h)


@ti.func
def begin_frame(cloth: ti.template()):
    """What of the strips stays for a frame: which particles are free."""
    if ti.static(cloth.in_lanes):
        for upright in range(2):
            layout = cloth.chains.layouts[upright]
            lay(cloth, layout, upright, cloth.inverse_mass, cloth.chains.inverse_mass, layout[MASSES])


@ti.func
def forget_chains(cloth: ti.template()):
    """λ = 0, in the strips too."""
    forget_multipliers(cloth)
    if ti.static(cloth.in_lanes):
        forget_multipliers(cloth.chains)
