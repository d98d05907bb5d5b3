"""Chains of springs solved exactly: each linearised where it is, and all its multipliers found at once.

For the springs j of one chain, with unit vectors n_j from particle j to j + 1, length errors C_j, K_j = k·h² and the
inverse masses w, the changes dλ_j of the multipliers fulfil (Macklin 2016, eq. 18, for a chain; times K_j)

    (1 + K_j·(w_j + w_j+1))·dλ_j − K_j·g_j·dλ_j−1 − K_j·g_j+1·dλ_j+1 = −K_j·C_j − λ_j,   g_j = w_j·n_j−1·n_j

which is tridiagonal: one way down the chain eliminates, one way up finds the changes (Thomas), and particle j moves by
w_j·(n_j−1·dλ_j−1 − n_j·dλ_j). Every pivot is at least 1; K = 0 is no spring, and no neighbour feels it.
"""

import taichi as ti
import taichi.math as tm

from ..mesh.chains import CHAINED, COUNT, FIRST, PARTICLE, STRIDE
from ..mesh.strips import ROW_KINDS
from .controls import DAMPING_TIME, STIFFNESS
from .maths import TINY
from .places import LANES, dot, from_next, from_previous, length, next_lane, times
from .springs import forget_multipliers
from .strips import row_kind


@ti.func
def eliminate(
    stages: ti.template(),
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
    error, damped = long - rest, stiffness
    if ti.static(stages.spring_damping):
        error += gamma * dot(n, gap - old_gap)
        damped *= 1.0 + gamma
    g = w_here * dot(n_before, n)
    share = 1.0 / (1.0 + damped * (w_both - g * g * share_before))
    change = (damped * g * change_before - stiffness * error - multiplier) * share
    return n, damped * share, g * share_before, change


@ti.func
def solve_chains(cloth: ti.template(), stages: ti.template(), controls: ti.template(), h: float):
    """Every row, then every column, then both diagonals, one chain after another."""
    if ti.static(cloth.in_lanes):
        solve_rows_of_strips(cloth, cloth.chains.crossed, stages, controls, h)
        for n in range(cloth.chains.direction_count[None]):
            direction = cloth.chains.directions[n]
            solve_strips(cloth, cloth.chains.links, stages, direction[0], True, direction[1], controls, h)
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
        cloth.x[b] = cloth.x[b] + (above - below) * cloth.inverse_mass[b]
        carried = chains.coupling[first + j] * found
        below = above
    top = chain[PARTICLE]
    cloth.x[top] = cloth.x[top] - below * cloth.inverse_mass[top]


# -- eight chains at once ------------------------------------------------------------------------------------------


@ti.func
def solve_strips(
    strips: ti.template(),
    links: ti.template(),
    stages: ti.template(),
    direction: int,
    slanted: ti.template(),
    along: int,
    controls: ti.template(),
    h: float,
):
    """The chains that go down the rows and `along` the columns: 0, 1 or −1 a row.

    `links` has a place for the spring of each slot, with a column more at both sides that holds what stands beyond
    the strip, and a row of zeros above and below.
    """
    rows, pitch = strips.rows[None], strips.pitch[None]
    wide = pitch + 2
    scale = controls[STIFFNESS] * h * h
    gamma = gamma_of(stages, controls, h)
    right_up = along < 0  # the right end of a spring is its upper one
    sign = -1.0 if right_up else 1.0  # n goes from left to right
    spare = ti.static(strips.x.shape[0] - 1)
    for y in range(rows - 1):
        at_left = (y + 1 if right_up else y) * pitch
        at_right = (y if right_up else y + 1) * pitch + ti.abs(along)
        e = (direction * rows + y) * pitch
        k = (direction * ROW_KINDS + row_kind(y, rows)) * pitch
        line = (y + 1) * wide + 1
        if ti.static(slanted):  # what the last springs of the row end at
            if along != 0:
                beyond = at_right + pitch - 1 - pitch
                strips.x[spare] = next_lane(strips.x[beyond])
                strips.inverse_mass[spare] = next_lane(strips.inverse_mass[beyond])
                if ti.static(stages.spring_damping):
                    strips.x_prev[spare] = next_lane(strips.x_prev[beyond])
        for i in range(pitch):
            q, before = line + i, line + i - wide - along
            over = i == pitch - 1 and along != 0
            a, b = at_left + i, spare if over else at_right + i
            w_a, w_b = strips.inverse_mass[a], strips.inverse_mass[b]
            gap = strips.x[b] - strips.x[a]
            old_gap = gap
            if ti.static(stages.spring_damping):
                old_gap = strips.x_prev[b] - strips.x_prev[a]
            n, share, coupling, change = eliminate(
                stages,
                gap,
                old_gap,
                w_b if right_up else w_a,
                w_a + w_b,
                strips.rest[e + i],
                strips.stiffness[k + i] * scale,
                strips.multiplier[e + i],
                gamma,
                links.normal[before],
                links.share[before],
                links.change[before],
            )
            links.normal[q] = n
            links.share[q] = share
            links.coupling[q] = coupling
            links.change[q] = change
        if ti.static(slanted):
            if along > 0:
                last = line + pitch - 1
                links.normal[line - 1] = from_previous(links.normal[last])
                links.share[line - 1] = from_previous(links.share[last])
                links.change[line - 1] = from_previous(links.change[last])
            elif along < 0:
                links.normal[line + pitch] = from_next(links.normal[line])
                links.share[line + pitch] = from_next(links.share[line])
                links.change[line + pitch] = from_next(links.change[line])
    # On the way up, `coupling` becomes what a spring adds to the change of the one above it, and `normal` n·dλ.
    into, out_of = ti.max(along, 0), wide - ti.max(-along, 0)  # where a particle's springs stand
    for r in range(rows):
        y = rows - 2 - r
        e = (direction * rows + y) * pitch
        line = (y + 1) * wide + 1
        if y >= 0:
            for i in range(pitch):
                q = line + i
                found = links.change[q] + links.coupling[q + wide + along]
                strips.multiplier[e + i] = strips.multiplier[e + i] + found
                links.normal[q] = times(links.normal[q], found)
                links.coupling[q] = links.coupling[q] * found
            if ti.static(slanted):
                if along != 0:
                    links.normal[line - 1] = from_previous(links.normal[line + pitch - 1])
                    links.coupling[line - 1] = from_previous(links.coupling[line + pitch - 1])
                    links.coupling[line + pitch] = from_next(links.coupling[line])
        for i in range(pitch):
            p, q = (y + 1) * pitch + i, line + i
            move = links.normal[q - into] - links.normal[q + out_of]
            strips.x[p] = strips.x[p] + times(move, strips.inverse_mass[p] * sign)


# Rows go through the same code: in strips of rows, with a row's particles one below the other.


@ti.func
def solve_rows_of_strips(
    cloth: ti.template(), crossed: ti.template(), stages: ti.template(), controls: ti.template(), h: float
):
    if cloth.chains.has_rows[None]:
        turn(cloth, cloth.x, crossed, crossed.x)
        if ti.static(stages.spring_damping):
            turn(cloth, cloth.x_prev, crossed, crossed.x_prev)
        solve_strips(crossed, crossed.links, stages, 0, False, 0, controls, h)
        turn_back(cloth, cloth.x, crossed, crossed.x)


@ti.func
def turn(cloth: ti.template(), places: ti.template(), crossed: ti.template(), turned: ti.template()):
    """Places, or numbers, of strips of columns into those of rows. Lanes without a row take the last."""
    pitch, across, last = cloth.pitch[None], crossed.pitch[None], cloth.rows[None] - 1
    for j in range(across):
        for i in range(pitch):
            for k in range(LANES):  # column k·pitch + i, rows lane·across + j
                slot = (k * pitch + i) * across + j
                for lane in ti.static(range(LANES)):
                    source = ti.min(lane * across + j, last) * pitch + i
                    if ti.static(places.m == 1):
                        turned[slot][lane] = places[source][k]
                    else:
                        for c in ti.static(range(3)):
                            turned[slot][c, lane] = places[source][c, k]


@ti.func
def turn_back(cloth: ti.template(), places: ti.template(), crossed: ti.template(), turned: ti.template()):
    """And places back again."""
    pitch, across = cloth.pitch[None], crossed.pitch[None]
    for y in range(cloth.rows[None]):
        lane, j = y // across, y % across
        for i in range(pitch):
            for k in range(LANES):
                slot = (k * pitch + i) * across + j
                for c in ti.static(range(3)):
                    places[y * pitch + i][c, k] = turned[slot][c, lane]


@ti.func
def begin_frame(cloth: ti.template()):
    """What of the strips of rows stays for a frame: which particles are free."""
    if ti.static(cloth.in_lanes):
        turn(cloth, cloth.inverse_mass, cloth.chains.crossed, cloth.chains.crossed.inverse_mass)


@ti.func
def forget_chains(cloth: ti.template()):
    """λ = 0, in the strips of rows too."""
    forget_multipliers(cloth)
    if ti.static(cloth.in_lanes):
        forget_multipliers(cloth.chains.crossed)
