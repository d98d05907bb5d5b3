"""The membrane in XPBD (Macklin 2016): the three strains of a triangle are constraints with the compliance C⁻¹ over its
area, which are solved together.

With the slopes s₁ and s₂ of a corner, by which f₁ and f₂ change with its position, the derivatives of the strains by it
are s₁·f₁, s₂·f₂ and s₁·f₂ + s₂·f₁. So ∇ε·M⁻¹·∇εᵀ follows from the products of f₁ and f₂ and from three sums over the
corners: of w·s₁², w·s₂² and w·s₁·s₂, where w is the inverse mass.
"""

import taichi as ti
import taichi.math as tm

from ..geometry.simd_layout import LANES
from .integration import apply_correction
from .membrane_forces import gradient, share_of, strain_change, strain_of, stress_of
from .simd_sweep import moved_fields
from .step_params import CELL_AREA, CELL_COLUMNS, CELL_ROWS, DAMPING_TIME
from .vec import dot, insert_shifted, neg, scale, shift_left_clamped

CELL_MULTIPLIERS = 12  # of a cell of a grid: three for each of its triangles


@ti.func
def multiplier_changes(
    features: ti.template(),
    params: ti.template(),
    strain: ti.template(),
    error: ti.template(),
    multiplier: ti.template(),
    weights: ti.template(),
    factor,
    damping_steps,
):
    """Return the changes Δλ of the three multipliers of a triangle (eq. 26).

    They solve (k·G·(1 + γ) + 1)·Δλ = −k·error − λ, where k is `factor` times C, the inverse of the paper's α̃, G is
    ∇ε·M⁻¹·∇εᵀ, γ is `damping_steps`, and the error is the strain plus γ times its growth in this substep. `weights` are
    the sums over the corners, of w·s₁², w·s₂² and w·s₁·s₂.
    """
    e1, e2, e12 = ti.static(strain)
    error1, error2, error12 = ti.static(error)
    multiplier1, multiplier2, multiplier12 = ti.static(multiplier)
    w11, w22, w12 = ti.static(weights)
    share1, share2 = share_of(features, params, e1), share_of(features, params, e2)
    f11, f22 = 2.0 * e1 + 1.0, 2.0 * e2 + 1.0
    g13, g23 = w11 * e12 + w12 * f11, w12 * f22 + w22 * e12
    g33 = w11 * f22 + 2.0 * w12 * e12 + w22 * f11
    a1, a2, a3 = stress_of(features, params, share1, share2, w11 * f11, w12 * e12, g13)  # columns of the matrix
    b1, b2, b3 = stress_of(features, params, share1, share2, w12 * e12, w22 * f22, g23)
    c1, c2, c3 = stress_of(features, params, share1, share2, g13, g23, g33)
    scaled = factor * (1.0 + damping_steps)
    a1, a2, a3 = a1 * scaled + 1.0, a2 * scaled, a3 * scaled
    b1, b2, b3 = b1 * scaled, b2 * scaled + 1.0, b3 * scaled
    c1, c2, c3 = c1 * scaled, c2 * scaled, c3 * scaled + 1.0
    r1, r2, r3 = stress_of(features, params, share1, share2, error1, error2, error12)
    r1, r2, r3 = neg(r1 * factor + multiplier1), neg(r2 * factor + multiplier2), neg(r3 * factor + multiplier12)
    p1, p2, p3 = b2 * c3 - b3 * c2, b3 * c1 - b1 * c3, b1 * c2 - b2 * c1
    inverse = 1.0 / ti.max(a1 * p1 + a2 * p2 + a3 * p3, 1.0)  # smaller by rounding only
    x1 = (r1 * p1 + r2 * p2 + r3 * p3) * inverse
    x2 = (a1 * (r2 * c3 - r3 * c2) + a2 * (r3 * c1 - r1 * c3) + a3 * (r1 * c2 - r2 * c1)) * inverse
    x3 = (a1 * (b2 * r3 - b3 * r2) + a2 * (b3 * r1 - b1 * r3) + a3 * (b1 * r2 - b2 * r1)) * inverse
    return x1, x2, x3


@ti.func
def limited(f1, f2, x1, x2, x12, weights: ti.template()):
    """Return changes Δλ, and on_1 and on_2, their sums along f₁ and f₂, by which corners move.

    They are scaled so that f₁ and f₂ change by no more than the longer of both, or 1, their length at rest. Newton's
    step from a length f to 1 is (1/f − f)/2: it would throw a triangle that is pressed to almost nothing far away.
    """
    w11, w22, w12 = ti.static(weights)
    on_1, on_2 = scale(f1, x1) + scale(f2, x12), scale(f1, x12) + scale(f2, x2)
    change1, change2 = scale(on_1, w11) + scale(on_2, w12), scale(on_1, w12) + scale(on_2, w22)
    size = ti.max(ti.max(dot(f1, f1), dot(f2, f2)), 1.0)
    share = ti.sqrt(size / ti.max(ti.max(dot(change1, change1), dot(change2, change2)), size))
    return x1 * share, x2 * share, x12 * share, scale(on_1, share), scale(on_2, share)


@ti.func
def clear_membrane_multipliers(cloth: ti.template()):
    """Set λ = 0, once a substep. 0 times λ would keep a NaN."""
    for n in range(cloth.membrane.count[None]):
        cloth.membrane.multiplier[n] = ti.Vector.zero(ti.f32, LANES if ti.static(cloth.is_simd) else 3)


@ti.func
def solve_membrane(cloth: ti.template(), features: ti.template(), params: ti.template(), h):
    """Project every triangle once, one after another."""
    if ti.static(cloth.is_simd):
        solve_cells_simd(cloth, features, params, h)
    else:
        for n in range(cloth.membrane.count[None]):
            solve_triangle(cloth, features, n, params, h)


@ti.func
def solve_triangle(cloth: ti.template(), features: ti.template(), n: int, params: ti.template(), h):
    """Project triangle n."""
    corners, b, multiplier = cloth.membrane.corners[n], cloth.membrane.inverse_shape[n], cloth.membrane.multiplier[n]
    f1, f2 = gradient(cloth.x, corners, b)
    e1, e2, e12 = strain_of(f1, f2)
    damping_steps, d1, d2, d12 = 0.0, 0.0, 0.0, 0.0
    if ti.static(features.spring_damping):
        damping_steps = params[DAMPING_TIME] / h
        start1, start2 = gradient(cloth.x_prev, corners, b)
        d1, d2, d12 = strain_change(f1, f2, f1 - start1, f2 - start2)
    slopes1, slopes2 = tm.vec3(-b[0] - b[2], b[0], b[2]), tm.vec3(-b[1] - b[3], b[1], b[3])
    w = tm.vec3([cloth.inverse_mass[corners[k]] for k in ti.static(range(3))])
    w11, w22, w12 = (w * slopes1).dot(slopes1), (w * slopes2).dot(slopes2), (w * slopes1).dot(slopes2)
    x1, x2, x12 = multiplier_changes(
        features,
        params,
        (e1, e2, e12),
        (e1 + damping_steps * d1, e2 + damping_steps * d2, e12 + damping_steps * d12),
        (multiplier[0], multiplier[1], multiplier[2]),
        (w11, w22, w12),
        h * h * cloth.membrane.area[n],
        damping_steps,
    )
    x1, x2, x12, on_1, on_2 = limited(f1, f2, x1, x2, x12, (w11, w22, w12))
    cloth.membrane.multiplier[n] = multiplier + tm.vec3(x1, x2, x12)
    for k in ti.static(range(3)):
        apply_correction(cloth, features, corners[k], (on_1 * slopes1[k] + on_2 * slopes2[k]) * w[k], h)


# -- grids in the SIMD layout ------------------------------------------------------------------------------------------


def read_fields(features: object) -> tuple[str, ...]:
    """Return the fields that the constraints read."""
    return (*moved_fields(features), "inverse_mass", *(("x_prev",) if features.spring_damping else ()))


@ti.func
def solve_cells_simd(cloth: ti.template(), features: ti.template(), params: ti.template(), h):
    """Project the four triangles of eight cells at once: first those in even columns of a strip, then in odd ones.

    The last cells of a strip end at the first column of the next lane. They come last: that column is loaded into the
    halo, changed there, and stored. One loop for all, because each copy of the body takes seconds to compile.
    """
    rows, row_stride, halo = cloth.rows[None], cloth.row_stride[None], cloth.packet_count[None]
    for s in range(3):
        first, cells, last = s, row_stride // 2 - s, s == 2  # a strip has an even number of columns
        if last:
            first, cells = row_stride - 1, 1
            for y in range(rows):
                for name in ti.static(read_fields(features)):
                    field = ti.static(getattr(cloth, name))
                    field[halo + y] = shift_left_clamped(field[y * row_stride])
        for y in range(rows - 1):
            for n in range(cells):
                i = first + 2 * n
                a = y * row_stride + i  # corners of the cell: a b over c d
                b, c, d = a + 1, a + row_stride, a + row_stride + 1
                if last:
                    b, d = halo + y, halo + y + 1
                solve_cell(cloth, features, params, h, i, a, b, c, d)
    for y in range(rows):
        for name in ti.static(moved_fields(features)):
            field = ti.static(getattr(cloth, name))
            field[y * row_stride] = insert_shifted(field[y * row_stride], field[halo + y])


@ti.func
def solve_cell(
    cloth: ti.template(), features: ti.template(), params: ti.template(), h, i: int, a: int, b: int, c: int, d: int
):
    """Project the triangles of a cell, one for each pair of a vertical and a horizontal side. f₁ is along the first."""
    down, along = -params[CELL_ROWS], params[CELL_COLUMNS]  # f₁ points up, the sides down
    x_a, x_b, x_c, x_d = cloth.x[a], cloth.x[b], cloth.x[c], cloth.x[d]
    w_a, w_b, w_c, w_d = cloth.inverse_mass[a], cloth.inverse_mass[b], cloth.inverse_mass[c], cloth.inverse_mass[d]
    move_a, move_b, move_c, move_d = x_a * 0.0, x_a * 0.0, x_a * 0.0, x_a * 0.0
    factor = cloth.has_cell[i] * (h * h * params[CELL_AREA])
    for k in ti.static(range(4)):
        left, top = ti.static(k // 2 == 0, k % 2 == 0)
        upper, lower = ti.static((a, c) if left else (b, d))
        first, last = ti.static((a, b) if top else (c, d))
        f1 = (x_c + move_c - x_a - move_a) * down
        if ti.static(not left):
            f1 = (x_d + move_d - x_b - move_b) * down
        f2 = (x_b + move_b - x_a - move_a) * along
        if ti.static(not top):
            f2 = (x_d + move_d - x_c - move_c) * along
        w_upper, w_lower = ti.static((w_a, w_c) if left else (w_b, w_d))
        w_first, w_last = ti.static((w_a, w_b) if top else (w_c, w_d))
        # The corner between both sides, and the sign of the product of its slopes.
        w_corner, sign = ti.static(
            ((w_a, 1.0) if top else (w_c, -1.0)) if left else ((w_b, -1.0) if top else (w_d, 1.0))
        )
        e1, e2, e12 = strain_of(f1, f2)
        damping_steps = 0.0
        error1, error2, error12 = e1, e2, e12
        if ti.static(features.spring_damping):
            damping_steps = params[DAMPING_TIME] / h
            g1 = f1 - (cloth.x_prev[lower] - cloth.x_prev[upper]) * down
            g2 = f2 - (cloth.x_prev[last] - cloth.x_prev[first]) * along
            d1, d2, d12 = strain_change(f1, f2, g1, g2)
            error1, error2, error12 = e1 + damping_steps * d1, e2 + damping_steps * d2, e12 + damping_steps * d12
        n = CELL_MULTIPLIERS * a + 3 * k
        multiplier = ti.static(cloth.membrane.multiplier)
        old1, old2, old12 = multiplier[n], multiplier[n + 1], multiplier[n + 2]
        w11, w22 = (w_upper + w_lower) * (down * down), (w_first + w_last) * (along * along)
        w12 = w_corner * (down * along * sign)
        x1, x2, x12 = multiplier_changes(
            features,
            params,
            (e1, e2, e12),
            (error1, error2, error12),
            (old1, old2, old12),
            (w11, w22, w12),
            factor,
            damping_steps,
        )
        x1, x2, x12, on_1, on_2 = limited(f1, f2, x1, x2, x12, (w11, w22, w12))
        multiplier[n], multiplier[n + 1], multiplier[n + 2] = old1 + x1, old2 + x2, old12 + x12
        on_1, on_2 = on_1 * down, on_2 * along
        if ti.static(left):
            move_a, move_c = move_a - scale(on_1, w_a), move_c + scale(on_1, w_c)
        else:
            move_b, move_d = move_b - scale(on_1, w_b), move_d + scale(on_1, w_d)
        if ti.static(top):
            move_a, move_b = move_a - scale(on_2, w_a), move_b + scale(on_2, w_b)
        else:
            move_c, move_d = move_c - scale(on_2, w_c), move_d + scale(on_2, w_d)
    apply_correction(cloth, features, a, move_a, h)
    apply_correction(cloth, features, b, move_b, h)
    apply_correction(cloth, features, c, move_c, h)
    apply_correction(cloth, features, d, move_d, h)
