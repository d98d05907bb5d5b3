"""The membrane of `geometry/membrane.py`: forces of triangles, their linearization, and constraints of XPBD.

Stresses and strains are in the order 11, 22, 12; of a strain the last is 2·E₁₂.
"""

from operator import attrgetter
from typing import Any, NamedTuple

import taichi as ti
import taichi.math as tm

from .constraint_math import TINY
from .integration import apply_correction
from .step_params import C11, C12, C22, C66, COMPRESSION, DAMPING_TIME, STIFFNESS_FACTOR


@ti.func
def gradient(field: ti.template(), corners, b):
    """Return f₁ and f₂ of a triangle: the derivatives of a field of vectors along warp and weft. `b` is its B [1/m]."""
    p, q = field[corners[1]] - field[corners[0]], field[corners[2]] - field[corners[0]]
    return p * b[0] + q * b[2], p * b[1] + q * b[3]


@ti.func
def strain_of(f1, f2):
    """Return Green's strain."""
    return tm.vec3(0.5 * (f1.dot(f1) - 1.0), 0.5 * (f2.dot(f2) - 1.0), f1.dot(f2))


@ti.func
def strain_change(f1, f2, g1, g2):
    """Return how the strain changes if f₁ and f₂ change by g₁ and g₂, to first order."""
    return tm.vec3(f1.dot(g1), f2.dot(g2), f1.dot(g2) + f2.dot(g1))


@ti.func
def shares_of(features: ti.template(), params: ti.template(), strain):
    """Return the root of the share of its stiffness that each direction has: less where it is compressed."""
    shares = tm.vec3(1.0)
    if ti.static(features.soft_compression):
        root = ti.sqrt(params[COMPRESSION])
        shares = tm.vec3(ti.select(strain[0] < 0.0, root, 1.0), ti.select(strain[1] < 0.0, root, 1.0), 1.0)
    return shares


@ti.func
def stress_of(params: ti.template(), shares, strain):
    """Return the stress [N/m]."""
    e = shares * strain
    along_warp, along_weft = params[C11] * e[0] + params[C12] * e[1], params[C12] * e[0] + params[C22] * e[1]
    return shares * tm.vec3(along_warp, along_weft, params[C66] * e[2]) * params[STIFFNESS_FACTOR]


@ti.func
def corner_pulls(stress, f1, f2, b, area):
    """Return the resistance of a triangle to the motion of its second and third corner [N], with the opposite sign of
    the force: the first corner has minus their sum."""
    p1, p2 = f1 * stress[0] + f2 * stress[2], f1 * stress[2] + f2 * stress[1]
    return (p1 * b[0] + p2 * b[1]) * area, (p1 * b[2] + p2 * b[3]) * area


@ti.func
def membrane_pulls(cloth: ti.template(), features: ti.template(), n, params: ti.template(), h):
    """Return `corner_pulls` of the elastic and the damping stress of triangle n."""
    corners, b = cloth.membrane.corners[n], cloth.membrane.inverse_shape[n]
    f1, f2 = gradient(cloth.x, corners, b)
    strain = strain_of(f1, f2)
    shares = shares_of(features, params, strain)
    if ti.static(features.spring_damping):
        g1, g2 = gradient(cloth.velocity, corners, b)
        strain += strain_change(f1, f2, g1, g2) * params[DAMPING_TIME]
    return corner_pulls(stress_of(params, shares, strain), f1, f2, b, -cloth.membrane.area[n])


@ti.func
def membrane_product(cloth: ti.template(), features: ti.template(), n, params: ti.template(), h):
    """Return the part of triangle n in h²K·d of its second and third corner, for conjugate gradients.

    Compression has no geometric stiffness here, which would be negative, so that the matrix is positive semidefinite.
    """
    corners, b = cloth.membrane.corners[n], cloth.membrane.inverse_shape[n]
    f1, f2 = gradient(cloth.x, corners, b)
    g1, g2 = gradient(cloth.cg.direction, corners, b)
    strain = strain_of(f1, f2)
    shares = shares_of(features, params, strain)
    change = stress_of(params, shares, strain_change(f1, f2, g1, g2))
    tension = tensile_part(stress_of(params, shares, strain))
    material_b, material_c = corner_pulls(change, f1, f2, b, cloth.membrane.area[n])
    geometric_b, geometric_c = corner_pulls(tension, g1, g2, b, cloth.membrane.area[n])
    return (material_b + geometric_b) * (h * h), (material_c + geometric_c) * (h * h)


@ti.func
def tensile_part(stress):
    """Return a stress without its negative principal stress."""
    mean, half = 0.5 * (stress[0] + stress[1]), 0.5 * (stress[0] - stress[1])
    radius = ti.sqrt(half * half + stress[2] * stress[2])
    largest, least = mean + radius, mean - radius
    part = stress
    if largest <= 0.0:
        part = tm.vec3(0.0)
    elif least < 0.0:
        share = largest / ti.max(2.0 * radius, TINY)
        part = share * tm.vec3(stress[0] - least, stress[1] - least, stress[2])
    return part


class TriangleForce(NamedTuple):
    """A quantity that a triangle adds to a sum at its second and third corner, and subtracts at its first."""

    force: Any
    """ti.func(cloth, features, n, params, h) that returns both."""
    target: str
    """Field of the sum."""


MEMBRANE_FORCE = TriangleForce(membrane_pulls, target="force")
MEMBRANE_PRODUCT = TriangleForce(membrane_product, target="cg.product")


@ti.func
def accumulate_triangle_forces(
    cloth: ti.template(), features: ti.template(), triangle_force: ti.template(), params: ti.template(), h: float
):
    """Add the quantity of every triangle to the sums of its corners."""
    sums = ti.static(attrgetter(triangle_force.target)(cloth))
    if ti.static(cloth.is_parallel):  # each particle gathers from its own triangles
        for i in range(cloth.packet_count[None]):
            total = sums[i]
            for k in range(cloth.membrane.triangle_first[i], cloth.membrane.triangle_first[i + 1]):
                n = cloth.membrane.triangle_rows[k]
                on_b, on_c = triangle_force.force(cloth, features, n, params, h)
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
            on_b, on_c = triangle_force.force(cloth, features, n, params, h)
            a, b, c = cloth.membrane.corners[n]
            sums[a] = sums[a] - (on_b + on_c)  # `+=` on a field would be atomic
            sums[b] = sums[b] + on_b
            sums[c] = sums[c] + on_c


# -- constraints of XPBD -----------------------------------------------------------------------------------------------


@ti.func
def clear_membrane_multipliers(cloth: ti.template()):
    """Set λ = 0, once a substep."""
    for n in range(cloth.membrane.count[None]):
        cloth.membrane.multiplier[n] = tm.vec3(0.0)


@ti.func
def strain_slopes(f1, f2, s1, s2):
    """Return the derivatives of the strains by the position of a corner.

    f₁ changes by s₁ times the displacement of the corner, and f₂ by s₂ times.
    """
    return f1 * s1, f2 * s2, f2 * s1 + f1 * s2


@ti.func
def solve_membrane(cloth: ti.template(), features: ti.template(), params: ti.template(), h):
    """Project the strains of every triangle once: three coupled constraints with the compliance C⁻¹ over the area.

    With G = ∇ε·M⁻¹·∇εᵀ, Δλ of Macklin 2016, eq. 26, is that of (k·G·(1 + γ) + 1)·Δλ = −k·(ε + γ·growth) − λ, where
    k = h²·area·C is the inverse of the paper's α̃ and γ the damping time over h.
    """
    for n in range(cloth.membrane.count[None]):
        corners, b = cloth.membrane.corners[n], cloth.membrane.inverse_shape[n]
        f1, f2 = gradient(cloth.x, corners, b)
        strain = strain_of(f1, f2)
        shares = shares_of(features, params, strain)
        error, damping_steps = strain, 0.0
        if ti.static(features.spring_damping):
            damping_steps = params[DAMPING_TIME] / h
            e1, e2 = gradient(cloth.x_prev, corners, b)
            error += strain_change(f1, f2, f1 - e1, f2 - e2) * damping_steps
        w = tm.vec3([cloth.inverse_mass[corners[k]] for k in ti.static(range(3))])
        scale = h * h * cloth.membrane.area[n]
        a11, a22, a12 = strain_slopes(f1, f2, -(b[0] + b[2]), -(b[1] + b[3]))
        b11, b22, b12 = strain_slopes(f1, f2, b[0], b[1])
        c11, c22, c12 = strain_slopes(f1, f2, b[2], b[3])
        g11 = w[0] * a11.dot(a11) + w[1] * b11.dot(b11) + w[2] * c11.dot(c11)
        g22 = w[0] * a22.dot(a22) + w[1] * b22.dot(b22) + w[2] * c22.dot(c22)
        g33 = w[0] * a12.dot(a12) + w[1] * b12.dot(b12) + w[2] * c12.dot(c12)
        g12 = w[0] * a11.dot(a22) + w[1] * b11.dot(b22) + w[2] * c11.dot(c22)
        g13 = w[0] * a11.dot(a12) + w[1] * b11.dot(b12) + w[2] * c11.dot(c12)
        g23 = w[0] * a22.dot(a12) + w[1] * b22.dot(b12) + w[2] * c22.dot(c12)
        damped = scale * (1.0 + damping_steps)
        m1 = stress_of(params, shares, tm.vec3(g11, g12, g13)) * damped + tm.vec3(1.0, 0.0, 0.0)  # columns
        m2 = stress_of(params, shares, tm.vec3(g12, g22, g23)) * damped + tm.vec3(0.0, 1.0, 0.0)
        m3 = stress_of(params, shares, tm.vec3(g13, g23, g33)) * damped + tm.vec3(0.0, 0.0, 1.0)
        right = -stress_of(params, shares, error) * scale - cloth.membrane.multiplier[n]
        across = m2.cross(m3)
        change = tm.vec3(right.dot(across), m1.dot(right.cross(m3)), m1.dot(m2.cross(right))) / m1.dot(across)
        cloth.membrane.multiplier[n] += change
        apply_correction(cloth, features, corners[0], (a11 * change[0] + a22 * change[1] + a12 * change[2]) * w[0], h)
        apply_correction(cloth, features, corners[1], (b11 * change[0] + b22 * change[1] + b12 * change[2]) * w[1], h)
        apply_correction(cloth, features, corners[2], (c11 * change[0] + c22 * change[1] + c12 * change[2]) * w[2], h)
