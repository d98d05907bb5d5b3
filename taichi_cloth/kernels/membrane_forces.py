"""The membrane of `geometry/membrane_model.py`: forces of its triangles, and their linearization. And the weave of
`geometry/weave_model.py`, which has another stress in the same triangles, and threads that bend.

Stresses and strains are in the order 11, 22, 12; of a strain the last is 2·E₁₂. Functions of plain values take one
triangle, or eight at once in the SIMD layout (`vec.py`).
"""

from operator import attrgetter
from typing import Any, NamedTuple

import taichi as ti

from ..geometry.weave_model import MIN_SINE, MIN_STRETCH
from ..scene.keys import MAX_POINTS
from .constraint_math import TINY, arcsine
from .simd_sweep import add_halo, load_halo
from .step_params import (
    BENDING_CURVES,
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
    CURVE_COLUMNS,
    DAMPING_TIME,
    SHEAR_CURVE,
    STIFFNESS_FACTOR,
    WARP_CURVE,
    WEFT_CURVE,
)
from .vec import abs_, dot, length, scale


@ti.func
def gradient(field: ti.template(), corners, b):
    """Return f₁ and f₂ of a triangle: the derivatives of a field of vectors along warp and weft. `b` is its B [1/m]."""
    p, q = field[corners[1]] - field[corners[0]], field[corners[2]] - field[corners[0]]
    return p * b[0] + q * b[2], p * b[1] + q * b[3]


@ti.func
def strain_of(f1, f2):
    """Return Green's strain."""
    return 0.5 * dot(f1, f1) - 0.5, 0.5 * dot(f2, f2) - 0.5, dot(f1, f2)


@ti.func
def strain_change(f1, f2, g1, g2):
    """Return how the strain changes if f₁ and f₂ change by g₁ and g₂, to first order."""
    return dot(f1, g1), dot(f2, g2), dot(f1, g2) + dot(f2, g1)


@ti.func
def share_of(features: ti.template(), params: ti.template(), strain):
    """Return the root of the share of its stiffness that a direction has at a strain: less in compression."""
    share = strain * 0.0 + 1.0
    if ti.static(features.soft_compression):
        share = ti.select(strain < 0.0, ti.sqrt(params[COMPRESSION]), 1.0)
    return share


@ti.func
def stress_of(features: ti.template(), params: ti.template(), share1, share2, e1, e2, e12):
    """Return the stress [N/m] of a strain. The shares are those of the present strain along both axes."""
    factor = params[STIFFNESS_FACTOR]
    c11, c22, c12 = params[C11] * factor, params[C22] * factor, params[C12] * factor
    c16, c26, c66 = params[C16] * factor, params[C26] * factor, params[C66] * factor
    s1, s2 = c11 * e1 + c12 * e2 + c16 * e12, c12 * e1 + c22 * e2 + c26 * e12
    s12 = c16 * e1 + c26 * e2 + c66 * e12
    if ti.static(features.soft_compression):  # along warp and weft, where c16 and c26 are 0
        s1 = share1 * (c11 * (share1 * e1) + c12 * (share2 * e2))
        s2 = share2 * (c12 * (share1 * e1) + c22 * (share2 * e2))
        s12 = c66 * e12
    return s1, s2, s12


@ti.func
def curve_at(params: ti.template(), first, count: ti.template(), x):
    """Return y of a curve at x; below 0 on its first slope.

    `first`: column of its first knot. `count`: of its pieces, or more.
    """
    y = x * params[first + MAX_POINTS]
    for k in ti.static(range(1, count)):
        y = y + ti.max(x - params[first + k], 0.0) * params[first + MAX_POINTS + k]
    return y


@ti.func
def slope_at(params: ti.template(), first, count: ti.template(), x):
    """Return the slope of a curve at x."""
    slope = x * 0.0 + params[first + MAX_POINTS]
    for k in ti.static(range(1, count)):
        slope = slope + ti.select(x < params[first + k], 0.0, params[first + MAX_POINTS + k])
    return slope


@ti.func
def weave_stress(features: ti.template(), params: ti.template(), e1, e2, e12, d1, d2, d12):
    """Return the stress of threads and their crossing at a strain that changes at the rate d [1/s], with damping [N/m].

    With stretches λ and sin φ = 2·E₁₂/(λ₁·λ₂), the energy per area is ∫T₁ dε₁ + ∫T₂ dε₂ + ∫M dφ. Its derivatives by f₁
    and f₂ are s₁·f₁ + s₁₂·f₂ and s₁₂·f₁ + s₂·f₂ (`geometry/weave_model.py`).
    """
    n = ti.static(features.weave)
    stretch1, stretch2 = ti.sqrt(ti.max(1.0 + 2.0 * e1, 0.0)), ti.sqrt(ti.max(1.0 + 2.0 * e2, 0.0))
    strain1, strain2 = 2.0 * e1 / (stretch1 + 1.0), 2.0 * e2 / (stretch2 + 1.0)  # λ − 1 would lose small strains
    over1, over2 = 1.0 / ti.max(stretch1, MIN_STRETCH), 1.0 / ti.max(stretch2, MIN_STRETCH)
    cosine = ti.max(ti.min(e12 * over1 * over2, 1.0), -1.0)
    over_sine = 1.0 / ti.sqrt(ti.max(1.0 - cosine * cosine, MIN_SINE * MIN_SINE))
    angle = arcsine(cosine)
    t1, t2 = curve_at(params, WARP_CURVE, n, strain1), curve_at(params, WEFT_CURVE, n, strain2)
    moment = curve_at(params, SHEAR_CURVE, n, abs_(angle)) * ti.select(cosine < 0.0, -1.0, 1.0)
    own1 = ti.select(stretch1 > MIN_STRETCH, over1 * over1, 0.0)  # a shorter thread acts as one of that length
    own2 = ti.select(stretch2 > MIN_STRETCH, over2 * over2, 0.0)
    if ti.static(features.spring_damping):
        time = params[DAMPING_TIME]
        turning = (d12 * over1 * over2 - cosine * (d1 * own1 + d2 * own2)) * over_sine
        t1 = t1 + slope_at(params, WARP_CURVE, n, strain1) * d1 * over1 * time
        t2 = t2 + slope_at(params, WEFT_CURVE, n, strain2) * d2 * over2 * time
        moment = moment + slope_at(params, SHEAR_CURVE, n, abs_(angle)) * turning * time
    if ti.static(features.soft_compression):
        t1 = t1 * ti.select(strain1 < 0.0, params[COMPRESSION], 1.0)
        t2 = t2 * ti.select(strain2 < 0.0, params[COMPRESSION], 1.0)
    factor = params[STIFFNESS_FACTOR]
    across = moment * over_sine * factor
    s1, s2 = t1 * over1 * factor - across * cosine * own1, t2 * over2 * factor - across * cosine * own2
    return s1, s2, across * over1 * over2


@ti.func
def elastic_stress(features: ti.template(), params: ti.template(), e1, e2, e12, d1, d2, d12):
    """Return the stress of a strain that changes at the rate d [1/s], with that of damping [N/m]; and zeros."""
    s1, s2, s12 = e1, e2, e12
    if ti.static(features.weave > 0):
        s1, s2, s12 = weave_stress(features, params, e1, e2, e12, d1, d2, d12)
    else:
        share1, share2 = share_of(features, params, e1), share_of(features, params, e2)
        if ti.static(features.spring_damping):
            time = params[DAMPING_TIME]
            s1, s2, s12 = e1 + d1 * time, e2 + d2 * time, e12 + d12 * time
        s1, s2, s12 = stress_of(features, params, share1, share2, s1, s2, s12)
    return s1, s2, s12, 0.0, 0.0, 0.0


@ti.func
def tensile_part(s1, s2, s12):
    """Return a stress without its negative principal stress."""
    mean, half = 0.5 * (s1 + s2), 0.5 * (s1 - s2)
    radius = ti.sqrt(half * half + s12 * s12)
    least = ti.min(mean - radius, 0.0)
    share = ti.max(mean + radius, 0.0) / ti.max(mean + radius - least, TINY)
    return share * (s1 - least), share * (s2 - least), share * s12


@ti.func
def linear_stress(features: ti.template(), params: ti.template(), e1, e2, e12, d1, d2, d12):
    """Return how the stress changes if the strain changes by d, to first order; and the stress itself [N/m].

    Without its compression, whose geometric stiffness is negative, so that the matrix is positive semidefinite.
    """
    share1, share2 = share_of(features, params, e1), share_of(features, params, e2)
    s1, s2, s12 = stress_of(features, params, share1, share2, d1, d2, d12)
    t1, t2, t12 = stress_of(features, params, share1, share2, e1, e2, e12)
    t1, t2, t12 = tensile_part(t1, t2, t12)
    return s1, s2, s12, t1, t2, t12


class MembraneSum(NamedTuple):
    """A quantity that every triangle adds to a sum at its corners: its force, or its part in h²K·d."""

    stress: Any
    """ti.func(features, params, strain, its change) that returns a stress on f₁ and f₂, and one on their changes."""
    change: str
    """Field whose gradient is the change of f₁ and f₂."""
    target: str
    """Field of the sum."""
    linear: bool
    """Whether it is h²K·d, which needs the changes and has the opposite sign of a force."""

    def needs_change(self, features: object) -> bool:
        """Return whether the stress depends on the change."""
        return self.linear or features.spring_damping

    def inputs(self, features: object) -> tuple[str, ...]:
        """Return the fields that it reads."""
        return ("x", self.change) if self.needs_change(features) else ("x",)


MEMBRANE_FORCE = MembraneSum(elastic_stress, change="velocity", target="force", linear=False)
MEMBRANE_PRODUCT = MembraneSum(linear_stress, change="cg.direction", target="cg.product", linear=True)


@ti.func
def accumulate_membrane(
    cloth: ti.template(), features: ti.template(), kind: ti.template(), params: ti.template(), h: float
):
    """Add a quantity of every triangle to the sums of its corners."""
    sums = ti.static(attrgetter(kind.target)(cloth))
    if ti.static(cloth.is_simd):
        accumulate_cells_simd(cloth, features, kind, params, h)
    elif ti.static(cloth.is_parallel):  # each particle gathers from its own triangles
        for i in range(cloth.packet_count[None]):
            total = sums[i]
            for k in range(cloth.membrane.triangle_first[i], cloth.membrane.triangle_first[i + 1]):
                n = cloth.membrane.triangle_rows[k]
                on_b, on_c = corner_sums(cloth, features, kind, n, params, h)
                corners = cloth.membrane.corners[n]
                if corners[1] == i:
                    total += on_b
                elif corners[2] == i:
                    total += on_c
                else:
                    total -= on_b + on_c
            sums[i] = total
    else:
        for n in range(cloth.membrane.count[None]):
            on_b, on_c = corner_sums(cloth, features, kind, n, params, h)
            a, b, c = cloth.membrane.corners[n]
            sums[a] = sums[a] - (on_b + on_c)  # `+=` on a field would be atomic
            sums[b] = sums[b] + on_b
            sums[c] = sums[c] + on_c


@ti.func
def corner_sums(cloth: ti.template(), features: ti.template(), kind: ti.template(), n, params: ti.template(), h):
    """Return what triangle n adds at its second and its third corner. At its first it subtracts both."""
    corners, b, area = cloth.membrane.corners[n], cloth.membrane.inverse_shape[n], cloth.membrane.area[n]
    f1, f2 = gradient(cloth.x, corners, b)
    g1, g2 = gradient(ti.static(attrgetter(kind.change)(cloth)), corners, b)
    e1, e2, e12 = strain_of(f1, f2)
    d1, d2, d12 = strain_change(f1, f2, g1, g2)
    s1, s2, s12, t1, t2, t12 = kind.stress(features, params, e1, e2, e12, d1, d2, d12)
    on_1, on_2 = f1 * s1 + f2 * s12, f1 * s12 + f2 * s2
    factor = -area
    if ti.static(kind.linear):
        on_1, on_2 = on_1 + (g1 * t1 + g2 * t12), on_2 + (g1 * t12 + g2 * t2)
        factor = area * h * h
    return (on_1 * b[0] + on_2 * b[1]) * factor, (on_1 * b[2] + on_2 * b[3]) * factor


@ti.func
def add_thread_bending(cloth: ti.template(), features: ti.template(), params: ti.template()):
    """Add the force [N] of bending of every thread of a weave, in the serial and the parallel layout."""
    if ti.static(cloth.is_parallel):  # each particle gathers from its own bends
        for i in range(cloth.packet_count[None]):
            total = cloth.force[i]
            for k in range(cloth.thread_bends.bend_first[i], cloth.thread_bends.bend_first[i + 1]):
                n = cloth.thread_bends.bend_rows[k]
                on_a, on_c = bending_of_thread(cloth, features, params, n)
                if cloth.thread_bends.corners[n][0] == i:
                    total += on_a
                elif cloth.thread_bends.corners[n][2] == i:
                    total += on_c
                else:
                    total -= on_a + on_c
            cloth.force[i] = total
    else:
        for n in range(cloth.thread_bends.count[None]):
            on_a, on_c = bending_of_thread(cloth, features, params, n)
            a, b, c = cloth.thread_bends.corners[n]
            cloth.force[a] = cloth.force[a] + on_a  # `+=` on a field would be atomic
            cloth.force[b] = cloth.force[b] - (on_a + on_c)
            cloth.force[c] = cloth.force[c] + on_c


@ti.func
def bending_of_thread(cloth: ti.template(), features: ti.template(), params: ti.template(), n):
    """Return the forces [N] of bend n on its first and its last particle. The middle one gets the opposite of both."""
    corners, axis = cloth.thread_bends.corners[n], cloth.thread_bends.axis[n]
    cells = params[CELL_ROWS + axis]  # 1/ℓ [1/m]
    before, after = cloth.x[corners[1]] - cloth.x[corners[0]], cloth.x[corners[2]] - cloth.x[corners[1]]
    length1, length2 = length(before), length(after)
    over1, over2 = 1.0 / ti.max(length1, MIN_STRETCH / cells), 1.0 / ti.max(length2, MIN_STRETCH / cells)
    t1, t2 = before * over1, after * over2
    turn = t2 - t1
    size = length(turn)
    moment = curve_at(params, BENDING_CURVES + CURVE_COLUMNS * axis, ti.static(features.weave), size * cells)
    pull = turn * (moment * cloth.thread_bends.width[n] * params[STIFFNESS_FACTOR] / ti.max(size, TINY))
    along1 = ti.select(length1 * cells > MIN_STRETCH, dot(t1, pull), 0.0)  # as `own1` in `weave_stress`
    along2 = ti.select(length2 * cells > MIN_STRETCH, dot(t2, pull), 0.0)
    return (t1 * along1 - pull) * over1, (t2 * along2 - pull) * over2


@ti.func
def accumulate_cells_simd(
    cloth: ti.template(), features: ti.template(), kind: ti.template(), params: ti.template(), h: float
):
    """Add a quantity of the four triangles of eight cells at once.

    Each pair of a vertical and a horizontal side of a cell is a triangle, with f₁ along the vertical one. All cells
    have the same shape. The last cells of a strip end at the first column of the next lane, which is loaded into the
    halo.
    """
    row_stride, halo = cloth.row_stride[None], cloth.packet_count[None]
    x, change = ti.static(cloth.x, attrgetter(kind.change)(cloth))
    sums = ti.static(attrgetter(kind.target)(cloth))
    load_halo(cloth, ti.static(kind.inputs(features)), kind.target, 1)
    factor = -params[CELL_AREA]
    down, along = -params[CELL_ROWS], params[CELL_COLUMNS]  # f₁ points up, the sides down
    if ti.static(kind.linear):
        factor = params[CELL_AREA] * h * h
    for y in range(cloth.rows[None] - 1):
        for i in range(row_stride):
            a = y * row_stride + i  # corners of the cell: a b over c d
            b, c, d = a + 1, a + row_stride, a + row_stride + 1
            if i == row_stride - 1:
                b, d = halo + y, halo + y + 1
            f_left, f_right = (x[c] - x[a]) * down, (x[d] - x[b]) * down
            f_top, f_bottom = (x[b] - x[a]) * along, (x[d] - x[c]) * along
            e_left, e_right = 0.5 * dot(f_left, f_left) - 0.5, 0.5 * dot(f_right, f_right) - 0.5
            e_top, e_bottom = 0.5 * dot(f_top, f_top) - 0.5, 0.5 * dot(f_bottom, f_bottom) - 0.5
            g_left, g_right, g_top, g_bottom = f_left, f_right, f_top, f_bottom
            if ti.static(kind.needs_change(features)):
                g_left, g_right = (change[c] - change[a]) * down, (change[d] - change[b]) * down
                g_top, g_bottom = (change[b] - change[a]) * along, (change[d] - change[c]) * along
            d_left, d_right = dot(f_left, g_left), dot(f_right, g_right)
            d_top, d_bottom = dot(f_top, g_top), dot(f_bottom, g_bottom)
            on_left, on_right, on_top, on_bottom = f_left * 0.0, f_left * 0.0, f_left * 0.0, f_left * 0.0
            s_left, s_right, s_top, s_bottom = e_left * 0.0, e_left * 0.0, e_left * 0.0, e_left * 0.0
            t_left, t_right, t_top, t_bottom = e_left * 0.0, e_left * 0.0, e_left * 0.0, e_left * 0.0
            for k in ti.static(range(4)):
                left, top = ti.static(k // 2 == 0, k % 2 == 0)
                f1, g1, e1, d1 = ti.static(
                    (f_left, g_left, e_left, d_left) if left else (f_right, g_right, e_right, d_right)
                )
                f2, g2, e2, d2 = ti.static(
                    (f_top, g_top, e_top, d_top) if top else (f_bottom, g_bottom, e_bottom, d_bottom)
                )
                d12 = dot(f1, g2) + dot(f2, g1)
                s1, s2, s12, t1, t2, t12 = kind.stress(features, params, e1, e2, dot(f1, f2), d1, d2, d12)
                across_1, across_2 = scale(f2, s12), scale(f1, s12)
                if ti.static(kind.linear):
                    across_1, across_2 = across_1 + scale(g2, t12), across_2 + scale(g1, t12)
                if ti.static(left):
                    on_left, s_left, t_left = on_left + across_1, s_left + s1, t_left + t1
                else:
                    on_right, s_right, t_right = on_right + across_1, s_right + s1, t_right + t1
                if ti.static(top):
                    on_top, s_top, t_top = on_top + across_2, s_top + s2, t_top + t2
                else:
                    on_bottom, s_bottom, t_bottom = on_bottom + across_2, s_bottom + s2, t_bottom + t2
            on_left, on_right = on_left + scale(f_left, s_left), on_right + scale(f_right, s_right)
            on_top, on_bottom = on_top + scale(f_top, s_top), on_bottom + scale(f_bottom, s_bottom)
            if ti.static(kind.linear):
                on_left, on_right = on_left + scale(g_left, t_left), on_right + scale(g_right, t_right)
                on_top, on_bottom = on_top + scale(g_top, t_top), on_bottom + scale(g_bottom, t_bottom)
            weight = cloth.has_cell[i] * factor
            on_left, on_right = scale(on_left, weight * down), scale(on_right, weight * down)
            on_top, on_bottom = scale(on_top, weight * along), scale(on_bottom, weight * along)
            sums[a] = sums[a] - (on_top + on_left)
            sums[b] = sums[b] + (on_top - on_right)
            sums[c] = sums[c] + (on_left - on_bottom)
            sums[d] = sums[d] + (on_bottom + on_right)
    add_halo(cloth, kind.target, 1)
