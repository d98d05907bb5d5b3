"""Cloth formulas on plain values: a particle, a spring, a triangle. They use no fields, so six numbers test each.

A vector is a vec3 or eight of them (`vec.py`); scalars such as masses and lengths are then rows of eight. There are no
branches, so that eight particles go through one formula.

Closest points of triangles and segments, as weights of their vertices (Ericson 2005, *Real-Time Collision
Detection*, sections 5.1.5 and 5.1.9).
"""

import taichi as ti
import taichi.math as tm

from .vec import abs_, broadcast, component, cross, dot, from_components, length, neg, scale, select

TINY = 1e-12  # avoids division by zero; far below any length, area, speed or inverse mass in a scene


@ti.func
def verlet_step(x, x_prev, velocity_factor: float, acceleration, h: float):
    """Damped Verlet step: x + (x − x_prev)·velocity_factor + a·h²."""
    return x + (x - x_prev) * velocity_factor + acceleration * (h * h)


@ti.func
def project_distance(gap, w, rest, stiffness):
    """Return the shift s that brings |gap| to `rest`: p moves by w_p·s and q by −w_q·s (Müller 2007, eq. 10–11).

    `gap` is q − p, and w is w_p + w_q. With equal masses and stiffness 1 each end takes half of the error; an end with
    w = 0 does not move.
    """
    norm = length(gap)
    return scale(gap, stiffness * (norm - rest) / (ti.max(norm, TINY) * ti.max(w, TINY)))


@ti.func
def project_distance_xpbd(gap, w, rest, k_h2, multiplier, damping_steps: float, growth):
    """Return the shift as in `project_distance`, and the change of λ, of a compliant spring with damping.

    This is Δλ of Macklin 2016, eq. 26 (without damping eq. 18), and the shift of eq. 17, times `k_h2` = k·h² [kg], the
    inverse of the paper's α̃, so that 0 is no spring. `damping_steps` is the paper's γ: the damping time of the spring
    over h. `growth` is how much longer the spring has become in this substep [m].
    """
    norm = length(gap)
    error = norm - rest + damping_steps * growth
    change = neg(k_h2 * error + multiplier) / (k_h2 * (1.0 + damping_steps) * w + 1.0)
    return scale(gap, neg(change) / ti.max(norm, TINY)), change


@ti.func
def hooke_force(gap, rest, stiffness):
    """Return the force [N] on p of a spring of `stiffness` [N/m] to q = p + gap, exactly 0 at rest."""
    norm = length(gap)
    return scale(gap, stiffness * (norm - rest) / ti.max(norm, TINY))


@ti.func
def damper_force(gap, rate, damping):
    """Return the force [N] on p of a damper of `damping` [N·s/m] to q, which moves at `rate` [m/s] relative to p."""
    return scale(gap, damping * dot(gap, rate) / ti.max(dot(gap, gap), TINY * TINY))


@ti.func
def triangle_area_normal(a, b, c):
    """Return the normal of a triangle times its area [m²]."""
    return 0.5 * cross(b - a, c - a)


@ti.func
def wind_force(area_normal, air, half_density: float, drag: float, lift: float):
    """Return the force [N] of air that flows past a triangle at relative velocity `air` [m/s].

    With θ between the air and the normal n (turned downstream), speed u and direction û:
        drag = ½ρ·A·u²·cosθ·C_D·cosθ·û               along the air: full face-on, none edge-on
        lift = ½ρ·A·u²·cosθ·C_L·(n − cosθ·û)         across the air
    With C_L = C_D this is a pressure on the sheet: ½ρ·A·u²·cosθ·C·n.
    """
    area, speed = length(area_normal), length(air)
    flow = dot(area_normal, air)  # A·u·cosθ [m³/s], negative where n points upstream: the signs cancel
    density = half_density / ti.max(area, TINY)
    along = density * (drag - lift) * flow * flow / ti.max(speed, TINY)
    return scale(air, along) + scale(area_normal, density * lift * flow * speed)


@ti.func
def parabolic_wave(turns):
    """Return a wave of period 1 and range −1…1 made of parabolas: smooth enough for a gust, without a libm call."""
    v = 2.0 * (turns - ti.floor(turns)) - 1.0
    return 4.0 * v * (1.0 - abs_(v))


@ti.func
def push_out_of_sphere(p, center, distance: float):
    """Return the shortest displacement that takes p to `distance` [m] from the center; zero outside.

    A tiny offset along y gives p at the very center a direction.
    """
    offset = p - center + broadcast(tm.vec3(0.0, TINY, 0.0), p)
    return scale(offset, ti.max(distance / length(offset) - 1.0, 0.0))


@ti.func
def push_out_of_box(p, center, half, margin: float):
    """Return the shortest displacement that takes p to `margin` [m] from a box with half sides `half`; zero outside.

    The margin rounds the edges.
    """
    offset = p - center
    side = ti.select(offset < 0.0, -1.0, 1.0)
    beyond = abs_(offset) - half  # distance past each pair of faces, negative between them
    outside = ti.max(beyond, 0.0)
    distance = length(outside)
    push = scale(side * outside, ti.max(margin / ti.max(distance, TINY) - 1.0, 0.0))
    # Inside or on a face: leave through the nearest face.
    x, y, z = component(beyond, 0), component(beyond, 1), component(beyond, 2)
    through_x = ti.select(x >= ti.max(y, z), ti.max(margin - x, 0.0), 0.0)
    through_y = ti.select((x < ti.max(y, z)) & (y >= z), ti.max(margin - y, 0.0), 0.0)
    through_z = ti.select((x < z) & (y < z), ti.max(margin - z, 0.0), 0.0)
    return select(distance > TINY, push, side * from_components(through_x, through_y, through_z, p))


@ti.func
def friction_correction(push, slide, friction: float):
    """Return the Coulomb correction against sliding (Macklin 2014, eq. 24).

    It takes back up to friction·|push| of the tangential part of `slide`, the motion relative to the surface in this
    substep [m].
    """
    depth = length(push)
    normal = scale(push, 1.0 / ti.max(depth, TINY))
    tangent = slide - scale(normal, dot(normal, slide))
    return scale(tangent, ti.max(-1.0, neg(friction * depth / ti.max(length(tangent), TINY))))


@ti.func
def arcsine(x):
    """Return arcsin(x) to float32, of x cut to −1…1. `ti.asin` does not compile for tensor fields.

    arcsin(x) = π/2 − 2·arcsin(√((1 − x)/2)) above ½; the polynomial below is that of Moshier's Cephes library (asinf).
    """
    size = ti.min(abs_(x), 1.0)
    y = ti.select(size > 0.5, ti.sqrt(0.5 - 0.5 * size), size)
    z = y * y
    series = (((4.2163199048e-2 * z + 2.4181311049e-2) * z + 4.5470025998e-2) * z + 7.4953002686e-2) * z
    angle = y + y * z * (series + 1.6666752422e-1)
    angle = ti.select(size > 0.5, 0.5 * tm.pi - 2.0 * angle, angle)
    return ti.select(x < 0.0, neg(angle), angle)


@ti.func
def fraction_on_segment(p: tm.vec3, a: tm.vec3, b: tm.vec3):
    """Return the fraction of a → b at which the segment is closest to p."""
    edge = b - a
    return tm.clamp((p - a).dot(edge) / ti.max(edge.dot(edge), TINY * TINY), 0.0, 1.0)


@ti.func
def closest_on_triangle(p: tm.vec3, a: tm.vec3, b: tm.vec3, c: tm.vec3):
    """Return the weights of a, b and c at the point of the triangle closest to p. The triangle may be degenerate."""
    ab, ac, ap = b - a, c - a, p - a
    d00, d01, d11 = ab.dot(ab), ab.dot(ac), ac.dot(ac)
    d20, d21 = ap.dot(ab), ap.dot(ac)
    area = d00 * d11 - d01 * d01
    v, w = d11 * d20 - d01 * d21, d00 * d21 - d01 * d20
    weights = tm.vec3(0.0)
    if area > 1e-6 * d00 * d11 and v >= 0.0 and w >= 0.0 and v + w <= area:
        weights = tm.vec3(area - v - w, v, w) / area
    else:  # on the boundary: the closest of three segments
        best = tm.inf
        for k in ti.static(range(3)):
            p0, p1 = ti.static(((a, b), (b, c), (c, a))[k])
            t = fraction_on_segment(p, p0, p1)
            offset = p0 + (p1 - p0) * t - p
            if offset.dot(offset) < best:
                best = offset.dot(offset)
                weights = tm.vec3(0.0)
                weights[k] = 1.0 - t
                weights[(k + 1) % 3] = t
    return weights


@ti.func
def closest_between_segments(a: tm.vec3, b: tm.vec3, c: tm.vec3, d: tm.vec3):
    """Return the fractions of a → b and c → d at which two segments are closest to each other."""
    u, v, r = b - a, d - c, a - c
    uu, vv, uv = ti.max(u.dot(u), TINY * TINY), ti.max(v.dot(v), TINY * TINY), u.dot(v)
    cross_squared = uu * vv - uv * uv  # |u×v|², 0 for parallel segments
    s = 0.5
    if cross_squared > 1e-9 * uu * vv:
        s = tm.clamp((uv * v.dot(r) - vv * u.dot(r)) / cross_squared, 0.0, 1.0)
    t = (uv * s + v.dot(r)) / vv
    if t < 0.0 or t > 1.0:
        t = tm.clamp(t, 0.0, 1.0)
        s = tm.clamp((uv * t - u.dot(r)) / uu, 0.0, 1.0)
    return s, t
