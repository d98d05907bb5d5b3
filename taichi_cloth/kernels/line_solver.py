"""Direct solution of lines of springs: each line is linearized at its positions, and all its multipliers are found at
once.

For the springs j of a line, with unit vectors n_j from particle j to j + 1, errors C_j of length, K_j = k·h² (`k_h2` in
the code) and inverse masses w, the changes dλ_j of the multipliers satisfy (the equation of Macklin 2016 before its
Gauss-Seidel form, eq. 18, for the springs of a line; each row times K_j)

    (1 + K_j·(w_j + w_j+1))·dλ_j − K_j·g_j·dλ_j−1 − K_j·g_j+1·dλ_j+1 = −K_j·C_j − λ_j,   g_j = w_j·n_j−1·n_j

This is tridiagonal, solved by the Thomas algorithm: forward elimination down the line, back substitution up. Particle j
then moves by w_j·(n_j−1·dλ_j−1 − n_j·dλ_j). Every pivot is at least 1. A spring with K = 0 has n = 0: its
neighbors are solved as if the line ended there.
"""

from math import prod

import taichi as ti
import taichi.math as tm

from ..geometry.simd_layout import (
    CLASS_FIRST,
    COLUMN_STEP,
    COUNT,
    END,
    LINE_DIRECTIONS,
    LINE_FIRST,
    LINE_STRIDE,
    LINK_FIRST,
    MASS_FIRST,
    PARTICLE,
    ROW_STRIDE,
    ROWS,
    SPRING_FIRST,
    START,
)
from .constraint_math import TINY
from .simd_sweep import row_class
from .springs import clear_multipliers, effective_stiffness
from .step_params import DAMPING_TIME, STIFFNESS_FACTOR
from .tensor_fields import element_shape
from .vec import COMPONENTS, LANES, broadcast, dot, length, scale, shift_left, shift_left_clamped, shift_right


@ti.func
def thomas_forward(
    features: ti.template(),
    params: ti.template(),
    gap,
    old_gap,
    w_here,
    w_both,
    rest,
    k_h2,
    multiplier,
    damping_steps: float,
    n_before,
    k_over_pivot_before,
    change_before,
):
    """Eliminate one spring: return its n, K/pivot, coupling and change.

    `w_here` is the inverse mass of the particle between this spring and the one before. Back substitution gives
    dλ = change + coupling·dλ of the next spring. `old_gap` is the gap at the start of the substep, for the damping of
    Macklin 2016, eq. 26, as in `constraint_math.project_distance_xpbd`: one spring alone has the same change in both.
    """
    norm = length(gap)
    n = scale(gap, ti.select(k_h2 > 0.0, 1.0, 0.0) / ti.max(norm, TINY))
    error = norm - rest
    k = effective_stiffness(features, params, error - multiplier * w_both, k_h2)
    k_damped = k
    if ti.static(features.spring_damping):
        error += damping_steps * dot(n, gap - old_gap)
        k_damped *= 1.0 + damping_steps
    g = w_here * dot(n_before, n)
    inv_pivot = 1.0 / (1.0 + k_damped * (w_both - g * g * k_over_pivot_before))
    change = (k_damped * g * change_before - k * error - multiplier) * inv_pivot
    return n, k_damped * inv_pivot, g * k_over_pivot_before, change


@ti.func
def solve_lines(cloth: ti.template(), features: ti.template(), params: ti.template(), h: float):
    """Solve all rows, then all columns, then both diagonals, line by line. Velocities follow at once."""
    if ti.static(cloth.is_simd):
        solve_lines_simd(cloth, cloth.lines, features, params, h)
    else:
        solve_lines_serial(cloth, cloth.lines, features, params, h)


@ti.func
def damping_in_steps(features: ti.template(), params: ti.template(), h: float):
    """Return the damping time of springs in steps of h [s], 0 without damping."""
    damping_steps = 0.0
    if ti.static(features.spring_damping):
        damping_steps = params[DAMPING_TIME] / h
    return damping_steps


# -- one line at a time ----------------------------------------------------------------------------------------------


@ti.func
def solve_lines_serial(
    cloth: ti.template(), lines: ti.template(), features: ti.template(), params: ti.template(), h: float
):
    """In the parallel layout each thread takes a line: lines of one direction share no particle."""
    if ti.static(cloth.is_parallel):
        for d in ti.static(range(len(LINE_DIRECTIONS))):
            for k in range(lines.first[d], lines.first[d + 1]):
                solve_line(cloth, lines, features, k, params, h)
    else:
        for k in range(lines.first[ti.static(len(LINE_DIRECTIONS))]):
            solve_line(cloth, lines, features, k, params, h)


@ti.func
def solve_line(
    cloth: ti.template(), lines: ti.template(), features: ti.template(), k: int, params: ti.template(), h: float
):
    factor_h2 = params[STIFFNESS_FACTOR] * h * h
    damping_steps = damping_in_steps(features, params, h)
    line = lines.table[k]
    stride, first = line[LINE_STRIDE], line[LINE_FIRST]
    n, k_over_pivot, change = tm.vec3(0.0), 0.0, 0.0
    for j in range(line[COUNT]):
        a = line[PARTICLE] + j * stride
        b = a + stride
        e = lines.springs[first + j]
        gap = cloth.x[b] - cloth.x[a]
        old_gap = gap
        if ti.static(features.spring_damping):
            old_gap = cloth.x_prev[b] - cloth.x_prev[a]
        w_a = cloth.inverse_mass[a]
        n, k_over_pivot, coupling, change = thomas_forward(
            features,
            params,
            gap,
            old_gap,
            w_a,
            w_a + cloth.inverse_mass[b],
            cloth.rest[e],
            cloth.stiffness[e] * factor_h2,
            cloth.multiplier[e],
            damping_steps,
            n,
            k_over_pivot,
            change,
        )
        lines.normal[first + j] = n
        lines.coupling[first + j] = coupling
        lines.change[first + j] = change
    carried = 0.0  # coupling·dλ of the spring below
    below = tm.vec3(0.0)  # n·dλ of the spring below
    for r in range(line[COUNT]):
        j = line[COUNT] - 1 - r
        b = line[PARTICLE] + (j + 1) * stride
        e = lines.springs[first + j]
        multiplier_change = lines.change[first + j] + carried
        cloth.multiplier[e] = cloth.multiplier[e] + multiplier_change
        above = lines.normal[first + j] * multiplier_change
        move_with_velocity(cloth, b, above - below, h)
        carried = lines.coupling[first + j] * multiplier_change
        below = above
    top = line[PARTICLE]
    move_with_velocity(cloth, top, -below, h)


@ti.func
def move_with_velocity(cloth: ti.template(), i: int, pull, h: float):
    """Move a particle and change its velocity; `pull` [kg·m]."""
    move = pull * cloth.inverse_mass[i]
    cloth.x[i] = cloth.x[i] + move
    cloth.velocity[i] = cloth.velocity[i] + move * (1.0 / h)


# -- eight lines at a time -------------------------------------------------------------------------------------------


@ti.func
def solve_lines_simd(
    cloth: ti.template(), lines: ti.template(), features: ti.template(), params: ti.template(), h: float
):
    """Solve in layouts where every line goes from row to row: the cloth's own, and a transposed one for its rows.

    `untransposed` is 1 for the cloth's own layout, and 0 for the transposed one.
    """
    for untransposed in range(2):
        layout = lines.layouts[untransposed]
        if layout[START] < layout[END]:
            to_line_layout(cloth, layout, untransposed, cloth.x, lines.x, 0)
            for packet in range(ti.static(lines.moved.shape[0])):  # of lanes without a particle too, which are read
                lines.moved[packet] = broadcast(tm.vec3(0.0), lines.moved[packet])
            if ti.static(features.spring_damping):
                to_line_layout(cloth, layout, untransposed, cloth.x_prev, lines.x_prev, 0)
            for n in range(layout[START], layout[END]):
                solve_direction(lines, features, layout, n, params, h)
            from_line_layout(cloth, lines, layout, untransposed, h)


@ti.func
def solve_direction(lines: ti.template(), features: ti.template(), layout, d: int, params: ti.template(), h: float):
    """Solve the lines that go down the rows and 0, 1 or −1 column along in each row.

    Scratch has an entry for the spring of each packet, with an extra column on both sides for the neighboring strips,
    and a row of zeros above and below.
    """
    rows, row_stride = layout[ROWS], layout[ROW_STRIDE]
    wide = row_stride + 2
    factor_h2 = params[STIFFNESS_FACTOR] * h * h
    damping_steps = damping_in_steps(features, params, h)
    halo = ti.static(lines.x.shape[0] - 1)
    halo_mass = ti.static(lines.inverse_mass.shape[0] - 1)
    for y in range(rows - 1):
        direction = lines.directions[d]
        along = direction[COLUMN_STEP]
        right_up = along < 0  # the right end of a spring is its upper one
        at_left = (y + 1 if right_up else y) * row_stride
        at_right = (y if right_up else y + 1) * row_stride + ti.abs(along)
        e = direction[SPRING_FIRST] + y * row_stride
        k = direction[CLASS_FIRST] + row_class(y, rows) * row_stride
        link = layout[LINK_FIRST] + (y + 1) * wide + 1
        if along != 0:  # the second ends of the last springs of the row
            source = at_right + row_stride - 1 - row_stride
            lines.x[halo] = shift_left_clamped(lines.x[source])
            lines.inverse_mass[halo_mass] = shift_left_clamped(lines.inverse_mass[layout[MASS_FIRST] + source])
            if ti.static(features.spring_damping):
                lines.x_prev[halo] = shift_left_clamped(lines.x_prev[source])
        for i in range(row_stride):
            q, before = link + i, link + i - wide - along
            over = i == row_stride - 1 and along != 0
            a, b = at_left + i, halo if over else at_right + i
            w_a = lines.inverse_mass[layout[MASS_FIRST] + a]
            w_b = lines.inverse_mass[halo_mass if over else layout[MASS_FIRST] + b]
            gap = lines.x[b] - lines.x[a]
            old_gap = gap
            if ti.static(features.spring_damping):
                old_gap = lines.x_prev[b] - lines.x_prev[a]
            n, k_over_pivot, coupling, change = thomas_forward(
                features,
                params,
                gap,
                old_gap,
                w_b if right_up else w_a,
                w_a + w_b,
                lines.rest[e + i],
                lines.stiffness[k + i] * factor_h2,
                lines.multiplier[e + i],
                damping_steps,
                lines.normal[before],
                lines.k_over_pivot[before],
                lines.change[before],
            )
            lines.normal[q] = n
            lines.k_over_pivot[q] = k_over_pivot
            lines.coupling[q] = coupling
            lines.change[q] = change
        if along > 0:
            last = link + row_stride - 1
            lines.normal[link - 1] = shift_right(lines.normal[last])
            lines.k_over_pivot[link - 1] = shift_right(lines.k_over_pivot[last])
            lines.change[link - 1] = shift_right(lines.change[last])
        elif along < 0:
            lines.normal[link + row_stride] = shift_left(lines.normal[link])
            lines.k_over_pivot[link + row_stride] = shift_left(lines.k_over_pivot[link])
            lines.change[link + row_stride] = shift_left(lines.change[link])
    # Back substitution: `coupling` becomes what a spring adds to the change of the one above it, and `normal` n·dλ.
    for r in range(rows):
        direction = lines.directions[d]
        along = direction[COLUMN_STEP]
        into, out_of = ti.max(along, 0), wide - ti.max(-along, 0)  # offsets of a particle's springs
        sign = -1.0 if along < 0 else 1.0  # n goes from left to right
        y = rows - 2 - r
        e = direction[SPRING_FIRST] + y * row_stride
        link = layout[LINK_FIRST] + (y + 1) * wide + 1
        if y >= 0:
            for i in range(row_stride):
                q = link + i
                multiplier_change = lines.change[q] + lines.coupling[q + wide + along]
                lines.multiplier[e + i] = lines.multiplier[e + i] + multiplier_change
                lines.normal[q] = scale(lines.normal[q], multiplier_change)
                lines.coupling[q] = lines.coupling[q] * multiplier_change
            if along != 0:
                lines.normal[link - 1] = shift_right(lines.normal[link + row_stride - 1])
                lines.coupling[link - 1] = shift_right(lines.coupling[link + row_stride - 1])
                lines.coupling[link + row_stride] = shift_left(lines.coupling[link])
        for i in range(row_stride):
            p, q = (y + 1) * row_stride + i, link + i
            pull = lines.normal[q - into] - lines.normal[q + out_of]
            move = scale(pull, lines.inverse_mass[layout[MASS_FIRST] + p] * sign)
            lines.x[p] = lines.x[p] + move
            lines.moved[p] = lines.moved[p] + move


def component_rows(field: object) -> int:
    """Return how many rows of eight of an element are used: three of a vector, one of a scalar."""
    return min(prod(element_shape(field)[:-1]), 3)


@ti.func
def empty_tile(field: ti.template()):
    """Return room for eight elements of a field."""
    return ti.Matrix.zero(ti.f32, LANES, ti.static(component_rows(field) * LANES))


@ti.func
def transpose_tile(field: ti.template(), first: int, stride: int, last: int, tile: ti.template()):
    """Transpose eight elements, `stride` apart and none after `last`: row k of the tile holds lane k of all."""
    for n in range(LANES):
        packet = field[ti.min(first + n * stride, last)]
        for k in ti.static(range(LANES)):
            if ti.static(component_rows(field) == 1):
                tile[k, n] = packet[k]
            else:
                for c in ti.static(range(component_rows(field))):
                    tile[k, c * LANES + n] = packet[c, k]


@ti.func
def tile_row(tile: ti.template(), k: int, field: ti.template()):
    """Return row k as an element of the field."""
    if ti.static(component_rows(field) == 1):
        return ti.Vector([tile[k, n] for n in ti.static(range(LANES))])
    else:
        return ti.Matrix(
            [
                [tile[k, c * LANES + n] if ti.static(c < 3) else 0.0 for n in ti.static(range(LANES))]
                for c in ti.static(range(COMPONENTS))
            ]
        )


@ti.func
def to_line_layout(
    cloth: ti.template(), layout, untransposed: int, source: ti.template(), target: ti.template(), first: int
):
    """Copy vectors, or scalars, of the cloth into a line layout, from packet `first` on.

    The transposed layout holds the particles of a row one below the other; lanes without a row repeat the last row.
    """
    row_stride, across, last = cloth.row_stride[None], layout[ROW_STRIDE], cloth.rows[None] - 1
    if untransposed:
        for packet in range(cloth.packet_count[None]):
            target[first + packet] = source[packet]
    else:
        for j in range(across):
            for i in range(row_stride):
                tile = empty_tile(source)
                transpose_tile(source, j * row_stride + i, across * row_stride, last * row_stride + i, tile)
                for k in range(LANES):  # column k·row_stride + i
                    target[first + (k * row_stride + i) * across + j] = tile_row(tile, k, source)


@ti.func
def from_line_layout(cloth: ti.template(), lines: ti.template(), layout, untransposed: int, h: float):
    """Copy positions back into the cloth, and add their displacement to the velocities."""
    row_stride, across = cloth.row_stride[None], layout[ROW_STRIDE]
    if untransposed:
        for packet in range(cloth.packet_count[None]):
            cloth.x[packet] = lines.x[packet]
            cloth.velocity[packet] = cloth.velocity[packet] + lines.moved[packet] * (1.0 / h)
    else:
        for j in range(across):
            for i in range(row_stride):
                x, moved = empty_tile(lines.x), empty_tile(lines.moved)
                start, step = i * across + j, row_stride * across
                transpose_tile(lines.x, start, step, start + LANES * step, x)
                transpose_tile(lines.moved, start, step, start + LANES * step, moved)
                for lane in range(LANES):
                    y = lane * across + j
                    if y < cloth.rows[None]:
                        packet = y * row_stride + i
                        cloth.x[packet] = tile_row(x, lane, lines.x)
                        cloth.velocity[packet] = cloth.velocity[packet] + tile_row(moved, lane, lines.moved) * (1.0 / h)


@ti.func
def prepare_frame(cloth: ti.template()):
    """Copy inverse masses, which are constant during a frame, into the line layouts."""
    if ti.static(cloth.is_simd):
        for untransposed in range(2):
            layout = cloth.lines.layouts[untransposed]
            to_line_layout(
                cloth, layout, untransposed, cloth.inverse_mass, cloth.lines.inverse_mass, layout[MASS_FIRST]
            )


@ti.func
def clear_line_multipliers(cloth: ti.template()):
    """Set λ = 0, in the line layouts too."""
    clear_multipliers(cloth)
    if ti.static(cloth.is_simd):
        clear_multipliers(cloth.lines)
