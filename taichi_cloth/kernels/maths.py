"""The maths of cloth on plain values: a particle, a spring, a triangle. No fields, so six numbers test it."""

import taichi as ti
import taichi.math as tm

TINY = 1e-12  # [m] keeps a division by a vanished length finite; far below any length in a scene


@ti.func
def verlet_step(x: tm.vec3, x_prev: tm.vec3, kept: float, acceleration: tm.vec3, h: float) -> tm.vec3:
    """Damped Verlet: x + (x − x_prev)·kept + a·h². `kept` is the share of velocity left after h."""
    return x + (x - x_prev) * kept + acceleration * (h * h)


@ti.func
def project_distance(p: tm.vec3, q: tm.vec3, w_p: float, w_q: float, rest: float, stiffness: float):
    """Corrections of p and q that bring |q − p| to `rest`, shared by inverse mass (Müller 2007, eq. 10–11).

    With equal masses and stiffness 1 each end takes half the error; an end with w = 0 does not move.
    """
    gap = q - p
    length = gap.norm()
    w = w_p + w_q
    share = tm.vec3(0.0)
    if w > 0.0:
        share = gap * (stiffness * (length - rest) / (tm.max(length, TINY) * w))
    return share * w_p, -share * w_q


@ti.func
def project_compliant(
    p: tm.vec3, q: tm.vec3, w_p: float, w_q: float, rest: float, compliance: float, multiplier: float
):
    """Corrections of p and q, and of the multiplier λ, for a spring of finite stiffness (Macklin 2016, eq. 17–18).

    `compliance` is 1/(k·h²) [1/kg]. With compliance 0 this is `project_distance` at stiffness 1.
    """
    gap = q - p
    length = gap.norm()
    w = w_p + w_q
    change = 0.0
    if w > 0.0:
        change = (rest - length - compliance * multiplier) / (w + compliance)
    push = gap * (change / tm.max(length, TINY))
    return -push * w_p, push * w_q, change


@ti.func
def triangle_area_normal(a: tm.vec3, b: tm.vec3, c: tm.vec3) -> tm.vec3:
    """Normal of a triangle, as long as its area [m²]."""
    return 0.5 * (b - a).cross(c - a)


@ti.func
def air_force(area_normal: tm.vec3, air: tm.vec3, half_density: float, drag: float, lift: float) -> tm.vec3:
    """Force [N] of air that passes a triangle at the relative velocity `air` [m/s].

    With θ between the air and the normal n (turned downstream), speed u and direction û:
        drag = ½ρ·A·u²·cosθ·C_D·cosθ·û               along the air, full face-on, none edge-on
        lift = ½ρ·A·u²·cosθ·C_L·(n − cosθ·û)         across the air
    With C_L = C_D that is a pressure on the sheet: ½ρ·A·u²·cosθ·C·n.
    """
    area = area_normal.norm()
    speed = air.norm()
    force = tm.vec3(0.0)
    if area > 0.0 and speed > 0.0:
        along = air / speed
        normal = area_normal / area
        cos = normal.dot(along)
        if cos < 0.0:
            normal, cos = -normal, -cos
        force = (half_density * area * speed * speed * cos) * (drag * cos * along + lift * (normal - cos * along))
    return force


@ti.func
def arc_wave(turns: float) -> float:
    """A sine drawn with parabolas: period 1, range −1…1. Smooth enough for a gust, and needs no libm call."""
    v = 2.0 * (turns - ti.floor(turns)) - 1.0
    return 4.0 * v * (1.0 - ti.abs(v))


@ti.func
def out_of_sphere(p: tm.vec3, center: tm.vec3, reach: float) -> tm.vec3:
    """Shortest push that takes p out of a sphere of radius `reach` [m]; zero where p is outside."""
    away = p - center
    distance = away.norm()
    push = tm.vec3(0.0)
    if distance < reach:
        if distance > TINY:
            push = away * (reach / distance - 1.0)
        else:
            push = tm.vec3(0.0, reach, 0.0)  # at the very centre every way out is as short: take up
    return push


@ti.func
def out_of_box(p: tm.vec3, center: tm.vec3, half: tm.vec3, margin: float) -> tm.vec3:
    """Shortest push that takes p `margin` [m] away from a box with half sides `half`; edges are rounded by it."""
    away = p - center
    beyond = ti.abs(away) - half  # distance past each pair of faces, negative between them
    side = tm.vec3(1.0)
    for k in ti.static(range(3)):
        if away[k] < 0.0:
            side[k] = -1.0
    outside = tm.max(beyond, 0.0)
    distance = outside.norm()
    push = tm.vec3(0.0)
    if distance > TINY:
        push = side * outside * tm.max(margin / distance - 1.0, 0.0)
    else:  # inside or on a face: leave through the nearest one
        axis = 2
        for k in ti.static((1, 0)):
            if beyond[k] >= beyond[axis]:
                axis = k
        push[axis] = side[axis] * (margin - beyond[axis])
    return push


@ti.func
def friction_slide(push: tm.vec3, move: tm.vec3, friction: float) -> tm.vec3:
    """Correction against sliding: takes back up to friction·|push| of the tangential part of `move` [m].

    `move` is the particle's motion in this substep relative to the surface (Macklin 2014, eq. 24).
    """
    depth = push.norm()
    back = tm.vec3(0.0)
    if depth > 0.0 and friction > 0.0:
        normal = push / depth
        tangent = move - normal * move.dot(normal)
        back = -tangent * tm.min(1.0, friction * depth / tm.max(tangent.norm(), TINY))
    return back
