"""The light of every picture: one soft lamp with its shadow, sky and floor around, and a gleam.

It is worked out at the corners of the triangles, here and not by who draws them: the window's toolkit knows lamps only,
which light both sides of a cloth alike and throw no shadow.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.maths import TINY
from .shadow import TO_LAMP, lamp_share

BACKGROUND = (0.875, 0.885, 0.895)  # factors 0…1, as all colours here
LAMP = tm.vec3(0.60, 0.57, 0.51)
SKY, BOUNCE = tm.vec3(0.53, 0.545, 0.575), tm.vec3(0.36, 0.34, 0.33)  # from straight above, from the floor
RIM = tm.vec3(0.11, 0.13, 0.17)  # from the right, on what is turned away from the lamp; without a shadow
TO_RIM = tm.vec3(0.90226, 0.25063, -0.35088)
THROUGH = 0.42  # share of the lamp's light that a cloth lets through to its other side
GLEAM = 22.0  # exponent of Blinn (1977)


@ti.func
def light_at(p: tm.vec3, normal: tm.vec3, through: float, shadow: ti.template(), frame: tm.vec4) -> tm.vec3:
    """Light on a white surface at p with that normal, for each colour."""
    lit = lamp_share(shadow, frame, p, normal)
    cosine = normal.dot(TO_LAMP)
    lamp = tm.max(cosine, 0.0) + through * tm.max(-cosine, 0.0)
    around = tm.mix(BOUNCE, SKY, 0.5 + 0.5 * normal[1])
    return around + lit * lamp * LAMP + tm.max(normal.dot(TO_RIM), 0.0) * RIM


@ti.func
def gleam_at(p: tm.vec3, normal: tm.vec3, eye: tm.vec3) -> float:
    """The lamp's reflection at p towards the eye, 1 where it is brightest."""
    half = ((eye - p).normalized(TINY) + TO_LAMP).normalized(TINY)
    return tm.max(normal.dot(half), 0.0) ** GLEAM


@ti.kernel
def light_floor(mesh: ti.template(), end: int, shadow: ti.template(), frame: tm.vec4, middle: tm.vec3, reach: float):
    """The floor, corners 0 … end; it fades into the background with the distance from its `middle` [m]."""
    for k in range(end):
        p = mesh.position[k]
        away = (p - middle).norm() / reach
        lit = mesh.albedo[k] * light_at(p, mesh.normal[k], 0.0, shadow, frame)
        mesh.colour[k] = tm.mix(tm.min(lit, 1.0), tm.vec3(BACKGROUND), tm.smoothstep(0.2, 0.8, away))


@ti.kernel
def light_solids(
    mesh: ti.template(), first: int, end: int, gloss: float, eye: tm.vec3, shadow: ti.template(), frame: tm.vec4
):
    """Corners first … end, lit on the side that their normals point to."""
    for k in range(first, end):
        p, normal = mesh.position[k], mesh.normal[k]
        lit = mesh.albedo[k] * light_at(p, normal, 0.0, shadow, frame) + gloss * gleam_at(p, normal, eye) * LAMP
        mesh.colour[k] = tm.min(lit, 1.0)


@ti.kernel
def light_cloth(
    mesh: ti.template(),
    first: int,
    end: int,
    gloss: float,
    contrast: float,
    eye: tm.vec3,
    shadow: ti.template(),
    frame: tm.vec4,
):
    """Triangles of corners first … end, lit on the side that is seen, and through from the other.

    Of light and shade only the share `contrast` is left, the rest is even: 1 for a cloth, less for colours to be read.
    """
    for t in range(first // 3, end // 3):
        a, b, c = mesh.position[3 * t], mesh.position[3 * t + 1], mesh.position[3 * t + 2]
        side = 1.0
        if (b - a).cross(c - a).dot(eye - a) < 0.0:
            side = -1.0
        for k in ti.static(range(3)):
            p, normal = mesh.position[3 * t + k], side * mesh.normal[3 * t + k]
            light = tm.mix(tm.vec3(0.95), light_at(p, normal, THROUGH, shadow, frame), contrast)
            lit = mesh.albedo[3 * t + k] * light + gloss * gleam_at(p, normal, eye) * LAMP
            mesh.colour[3 * t + k] = tm.min(lit, 1.0)
