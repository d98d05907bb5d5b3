"""The maths of cloth on plain values: a particle, a spring, a triangle. No fields, so six numbers test it.

A place is a vec3 or eight of them (`places.py`); masses, lengths and the like are then rows of eight.
No branches: eight particles go through one formula.
"""

import taichi as ti
import taichi.math as tm

from .places import choose, cross, dot, join, length, minus, part, size_of, spread, times

TINY = 1e-12  # keeps a division by nothing finite; far below any length, area, speed or inverse mass in a scene


@ti.func
def verlet_step(x, x_prev, kept: float, acceleration, h: float):
    """Damped Verlet: x + (x − x_prev)·kept + a·h². `kept` is the share of velocity left after h."""
    return x + (x - x_prev) * kept + acceleration * (h * h)


@ti.func
def project_distance(gap, w, rest, stiffness):
    """Shift s that brings |gap| to `rest` when p moves by w_p·s and q by −w_q·s (Müller 2007, eq. 10–11).

    `gap` is q − p, `w` is w_p + w_q. With equal masses and stiffness 1 each end takes half the error; an
    end with w = 0 does not move.
    """
    long = length(gap)
    return times(gap, stiffness * (long - rest) / (ti.max(long, TINY) * ti.max(w, TINY)))


@ti.func
def project_compliant(gap, w, rest, stiffness, multiplier, gamma: float, grown):
    """The shift as in `project_distance`, and the change of λ, for a spring that gives (Macklin 2016, eq. 26).

    `stiffness` is k·h² [kg]: the inverse of the paper's α̃, so that 0 is no spring at all. `gamma` is the
    damping time over h, and `grown` how much longer the spring became in this substep [m].
    """
    long = length(gap)
    error = long - rest + gamma * grown
    change = minus(stiffness * error + multiplier) / (stiffness * (1.0 + gamma) * w + 1.0)
    return times(gap, minus(change) / ti.max(long, TINY)), change


@ti.func
def spring_pull(gap, rest, stiffness):
    """Force [N] on p of a spring of `stiffness` [N/m] to q = p + gap; q feels the opposite. Exactly 0 at rest."""
    long = length(gap)
    return times(gap, stiffness * (long - rest) / ti.max(long, TINY))


@ti.func
def dashpot_pull(gap, rate, damping):
    """Force [N] on p of a dashpot of `damping` [N·s/m] to q, which moves at `rate` [m/s] relative to p."""
    return times(gap, damping * dot(gap, rate) / ti.max(dot(gap, gap), TINY * TINY))


@ti.func
def triangle_area_normal(a, b, c):
    """Normal of a triangle, as long as its area [m²]."""
    return 0.5 * cross(b - a, c - a)


@ti.func
def air_force(area_normal, air, half_density: float, drag: float, lift: float):
    """Force [N] of air that passes a triangle at the relative velocity `air` [m/s].

    With θ between the air and the normal n (turned downstream), speed u and direction û:
        drag = ½ρ·A·u²·cosθ·C_D·cosθ·û               along the air, full face-on, none edge-on
        lift = ½ρ·A·u²·cosθ·C_L·(n − cosθ·û)         across the air
    With C_L = C_D that is a pressure on the sheet: ½ρ·A·u²·cosθ·C·n.
    """
    area, speed = length(area_normal), length(air)
    through = dot(area_normal, air)  # A·u·cosθ [m³/s], negative where n points upstream: the signs cancel
    density = half_density / ti.max(area, TINY)
    along = density * (drag - lift) * through * through / ti.max(speed, TINY)
    return times(air, along) + times(area_normal, density * lift * through * speed)


@ti.func
def arc_wave(turns):
    """A sine drawn with parabolas: period 1, range −1…1. Smooth enough for a gust, and needs no libm call."""
    v = 2.0 * (turns - ti.floor(turns)) - 1.0
    return 4.0 * v * (1.0 - size_of(v))


@ti.func
def out_of_sphere(p, center, reach: float):
    """Shortest push that takes p out of a sphere of radius `reach` [m]; zero where p is outside.

    A hair's breadth is added upwards, so that the very centre has a way out too.
    """
    away = p - center + spread(tm.vec3(0.0, TINY, 0.0), p)
    return times(away, ti.max(reach / length(away) - 1.0, 0.0))


@ti.func
def out_of_box(p, center, half, margin: float):
    """Shortest push that takes p `margin` [m] away from a box with half sides `half`; edges are rounded by it."""
    away = p - center
    side = ti.select(away < 0.0, -1.0, 1.0)
    beyond = size_of(away) - half  # distance past each pair of faces, negative between them
    outside = ti.max(beyond, 0.0)
    distance = length(outside)
    push = times(side * outside, ti.max(margin / ti.max(distance, TINY) - 1.0, 0.0))
    # Inside or on a face: leave through the nearest one.
    x, y, z = part(beyond, 0), part(beyond, 1), part(beyond, 2)
    through_x = ti.select(x >= ti.max(y, z), ti.max(margin - x, 0.0), 0.0)
    through_y = ti.select((x < ti.max(y, z)) & (y >= z), ti.max(margin - y, 0.0), 0.0)
    through_z = ti.select((x < z) & (y < z), ti.max(margin - z, 0.0), 0.0)
    return choose(distance > TINY, push, side * join(through_x, through_y, through_z, p))


@ti.func
def friction_slide(push, move, friction: float):
    """Correction against sliding: takes back up to friction·|push| of the tangential part of `move` [m].

    `move` is the particle's motion in this substep relative to the surface (Macklin 2014, eq. 24).
    """
    depth = length(push)
    normal = times(push, 1.0 / ti.max(depth, TINY))
    tangent = move - times(normal, dot(normal, move))
    return times(tangent, ti.max(-1.0, minus(friction * depth / ti.max(length(tangent), TINY))))
