"""The membrane in XPBD (Macklin 2016): the three strains of a triangle are constraints with the compliance C⁻¹ over its
area, which are solved together.

With the slopes s₁ and s₂ of a corner, by which f₁ and f₂ change with its position, the derivatives of the strains by it
are s₁·f₁, s₂·f₂ and s₁·f₂ + s₂·f₁. So ∇ε·M⁻¹·∇εᵀ follows from the products of f₁ and f₂ and from three sums over the
corners: of w·s₁², w·s₂² and w·s₁·s₂, where w is the inverse mass.
"""

import taichi as ti
import taichi.math as tm

from ..geometry.simd_layout import LANES
from .constraint_math import TINY
from .integration import apply_correction
from .membrane_forces import gradient, strain_change, strain_of
from .simd_sweep import moved_fields
from .step_params import (
    C11,
    C12,
    C16,
    C22,
    C26,
    C66,
    CELL_AREA,
    CELL_COLUMNS,
    CELL_ROWS,
    COMPRESSION,
    DAMPING_TIME,
    STIFFNESS_FACTOR,
)
from .vec import insert_shifted, neg, scale, shift_left_clamped

LEAST_COMPRESSION = 1e-9  # of `fabric.compression`, whose inverse is finite
LEAST_DETERMINANT = 1e-6  # over the product of the diagonal: less has no correct digit in float32
FLATTENED = 0.4  # length over that at rest from which Newton's step is at most 1
CELL_MULTIPLIERS = 12  # of a cell of a grid: three for each of its triangles


@ti.func
def sum_of_stiffnesses(params: ti.template()):
    """Return the trace of C [N/m], with which the equations of a triangle have no units."""
    return params[C11] + params[C22] + params[C66]


@ti.func
def relative_compliance(params: ti.template()):
    """Return C⁻¹ times the trace of C: 11, 22, 12, 16, 26, 66."""
    c11, c22, c12, c16, c26, c66 = params[C11], params[C22], params[C12], params[C16], params[C26], params[C66]
    k11, k12, k16 = c22 * c66 - c26 * c26, c16 * c26 - c12 * c66, c12 * c26 - c16 * c22
    k22, k26, k66 = c11 * c66 - c16 * c16, c12 * c16 - c11 * c26, c11 * c22 - c12 * c12
    share = sum_of_stiffnesses(params) / (c11 * k11 + c12 * k12 + c16 * k16)
    return k11 * share, k22 * share, k12 * share, k16 * share, k26 * share, k66 * share


@ti.func
def softness_of(features: ti.template(), params: ti.template(), strain):
    """Return the inverse of `share_of`. It is finite without stiffness in compression, too."""
    softness = strain * 0.0 + 1.0
    if ti.static(features.soft_compression):
        softness = ti.select(strain < 0.0, 1.0 / ti.sqrt(ti.max(params[COMPRESSION], LEAST_COMPRESSION)), 1.0)
    return softness


@ti.func
def multiplier_changes(
    features: ti.template(),
    params: ti.template(),
    strain: ti.template(),
    error: ti.template(),
    multiplier: ti.template(),
    weights: ti.template(),
    compliance: ti.template(),
    factor,
    damping_steps,
):
    """Return the changes Δλ of the three multipliers of a triangle (eq. 26).

    They solve (G·(1 + γ) + α̃)·Δλ = −error − α̃·λ, where G is ∇ε·M⁻¹·∇εᵀ, γ is `damping_steps`, and the error is the
    strain plus γ times its growth in this substep. All terms are multiplied by `factor`, which is h² times the area
    and the trace of C; α̃ is then the relative `compliance`. `weights` are the sums over the corners, of w·s₁², w·s₂²
    and w·s₁·s₂.

    If the triangle is pressed to less than `FLATTENED`, Δλ is scaled down by the square. Newton's step from a length f
    to 1 is (1/f − f)/2: it would throw a triangle that is pressed to almost nothing far away.
    """
    e1, e2, e12 = ti.static(strain)
    error1, error2, error12 = ti.static(error)
    lambda1, lambda2, lambda12 = ti.static(multiplier)
    c11, c22, c12, k16, k26, k66 = ti.static(compliance)
    soft1, soft2 = softness_of(features, params, e1), softness_of(features, params, e2)
    k11, k22, k12 = soft1 * soft1 * c11, soft2 * soft2 * c22, soft1 * soft2 * c12  # k16 and k26 are 0 if one is not 1
    r1 = neg(factor * error1 + k11 * lambda1 + k12 * lambda2 + k16 * lambda12)
    r2 = neg(factor * error2 + k12 * lambda1 + k22 * lambda2 + k26 * lambda12)
    r3 = neg(factor * error12 + k16 * lambda1 + k26 * lambda2 + k66 * lambda12)
    growth = factor * (1.0 + damping_steps)
    w11, w22, w12 = growth * weights[0], growth * weights[1], growth * weights[2]
    f11, f22 = 2.0 * e1 + 1.0, 2.0 * e2 + 1.0
    a11, a22, a12 = w11 * f11 + k11, w22 * f22 + k22, w12 * e12 + k12
    a13, a23 = w11 * e12 + w12 * f11 + k16, w12 * f22 + w22 * e12 + k26
    a33 = w11 * f22 + 2.0 * w12 * e12 + w22 * f11 + k66
    p11, p12, p13 = a22 * a33 - a23 * a23, a13 * a23 - a12 * a33, a12 * a23 - a13 * a22  # of the adjugate matrix
    p22, p23, p33 = a11 * a33 - a13 * a13, a12 * a13 - a11 * a23, a11 * a22 - a12 * a12
    determinant = ti.max(a11 * p11 + a12 * p12 + a13 * p13, LEAST_DETERMINANT * (a11 * a22) * a33)
    # The square of the shorter principal length is at least `area` over `trace`.
    area, trace = f11 * f22 - e12 * e12, FLATTENED * FLATTENED * (f11 + f22)
    inverse = ti.min(ti.max(area, 0.0), trace) / ti.max(trace * determinant, TINY)
    x1, x2, x3 = p11 * r1 + p12 * r2 + p13 * r3, p12 * r1 + p22 * r2 + p23 * r3, p13 * r1 + p23 * r2 + p33 * r3
    return inverse * x1, inverse * x2, inverse * x3


@ti.func
def clear_membrane_multipliers(cloth: ti.template()):
    """Set λ = 0, once a substep. 0 times λ would keep a NaN."""
    for n in range(cloth.membrane.count[None]):
        cloth.membrane.multiplier[n] = ti.Vector.zero(ti.f32, LANES if ti.static(cloth.is_simd) else 3)


@ti.func
def solve_membrane(cloth: ti.template(), features: ti.template(), params: ti.template(), h):
    """Project every triangle once, one after another."""
    compliance, factor = relative_compliance(params), h * h * params[STIFFNESS_FACTOR] * sum_of_stiffnesses(params)
    if ti.static(cloth.is_simd):
        solve_cells_simd(cloth, features, params, compliance, factor, h)
    else:
        for n in range(cloth.membrane.count[None]):
            solve_triangle(cloth, features, n, params, compliance, factor, h)


@ti.func
def solve_triangle(
    cloth: ti.template(), features: ti.template(), n: int, params: ti.template(), compliance: ti.template(), factor, h
):
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
        compliance,
        factor * cloth.membrane.area[n],
        damping_steps,
    )
    cloth.membrane.multiplier[n] = multiplier + tm.vec3(x1, x2, x12)
    on_1, on_2 = f1 * x1 + f2 * x12, f1 * x12 + f2 * x2
    for k in ti.static(range(3)):
        apply_correction(cloth, features, corners[k], (on_1 * slopes1[k] + on_2 * slopes2[k]) * w[k], h)


# -- grids in the SIMD layout ------------------------------------------------------------------------------------------


def read_fields(features: object) -> tuple[str, ...]:
    """Return the fields that the constraints read."""
    return (*moved_fields(features), "inverse_mass", *(("x_prev",) if features.spring_damping else ()))


@ti.func
def solve_cells_simd(
    cloth: ti.template(), features: ti.template(), params: ti.template(), compliance: ti.template(), factor, h
):
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
                solve_cell(cloth, features, params, compliance, factor * params[CELL_AREA], h, i, a, b, c, d)
    for y in range(rows):
        for name in ti.static(moved_fields(features)):
            field = ti.static(getattr(cloth, name))
            field[y * row_stride] = insert_shifted(field[y * row_stride], field[halo + y])


@ti.func
def solve_cell(
    cloth: ti.template(),
    features: ti.template(),
    params: ti.template(),
    compliance: ti.template(),
    factor,
    h,
    i: int,
    a: int,
    b: int,
    c: int,
    d: int,
):
    """Project the triangles of a cell, one for each pair of a vertical and a horizontal side. f₁ is along the first."""
    down, along = -params[CELL_ROWS], params[CELL_COLUMNS]  # f₁ points up, the sides down
    x_a, x_b, x_c, x_d = cloth.x[a], cloth.x[b], cloth.x[c], cloth.x[d]
    w_a, w_b, w_c, w_d = cloth.inverse_mass[a], cloth.inverse_mass[b], cloth.inverse_mass[c], cloth.inverse_mass[d]
    move_a, move_b, move_c, move_d = x_a * 0.0, x_a * 0.0, x_a * 0.0, x_a * 0.0
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
            compliance,
            cloth.has_cell[i] * factor,
            damping_steps,
        )
        multiplier[n], multiplier[n + 1], multiplier[n + 2] = old1 + x1, old2 + x2, old12 + x12
        on_1, on_2 = scale(f1, x1 * down) + scale(f2, x12 * down), scale(f1, x12 * along) + scale(f2, x2 * along)
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
