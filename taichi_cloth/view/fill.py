"""Kernels that write bodies, the cloth in each of its views, and shadows into a draw mesh."""

import taichi as ti
import taichi.math as tm

from ..kernels.maths import TINY, triangle_area_normal

points = ti.types.ndarray(dtype=tm.vec3, ndim=1)
numbers = ti.types.ndarray(dtype=ti.f32, ndim=1)

# Rows of the floor's table, each a vec3; `draw_list.floor_table` writes it.
ALBEDO, BACKGROUND, AMBIENT, CENTER, SIZES, LAMPS = 0, 1, 2, 3, 4, 5
REACH, SHADE, LIFT = (
    0,
    1,
    2,
)  # components of SIZES: where the floor ends [m], light left in shadow, its height over the floor [m]


@ti.func
def put(mesh: ti.template(), corner: int, position: tm.vec3, normal: tm.vec3, colour: tm.vec3):
    mesh.position[corner] = position
    mesh.normal[corner] = normal
    mesh.colour[corner] = colour


@ti.func
def floor_colour(p: tm.vec3, floor: ti.template(), albedo: tm.vec3) -> tm.vec3:
    """Colour of the floor at p, such that once lit it fades into the background with distance."""
    light = floor[AMBIENT]
    for k in range((floor.shape[0] - LAMPS) // 2):
        light += floor[LAMPS + 2 * k + 1] * tm.max((floor[LAMPS + 2 * k] - p).normalized()[1], 0.0)
    away = (p - floor[CENTER]).norm() / floor[SIZES][REACH]
    return tm.mix(albedo, floor[BACKGROUND] / light, tm.smoothstep(0.4, 0.95, away))


@ti.func
def put_shadow(mesh: ti.template(), corner: int, p: tm.vec3, floor: ti.template()):
    """The shadow that a corner at p throws on the floor, seen from the first lamp.

    A corner under the floor throws it straight up to the floor, so that no shadow grows without end.
    """
    lamp = floor[LAMPS]
    height = floor[CENTER][1]
    fall = tm.max(p[1] - height, 0.0) / tm.max(lamp[1] - p[1], 1e-3)
    place = p + (p - lamp) * fall
    place[1] = height + floor[SIZES][LIFT]
    put(mesh, corner, place, tm.vec3(0.0, 1.0, 0.0), floor_colour(place, floor, floor[ALBEDO] * floor[SIZES][SHADE]))


@ti.kernel
def fill_body(mesh: ti.template(), first: int, position: points, normal: points, colour: points):
    """A body that stands still; the arrays have one element for each corner."""
    for k in range(position.shape[0]):
        put(mesh, first + k, position[k], normal[k], colour[k])


@ti.kernel
def fill_floor(mesh: ti.template(), first: int, position: points, tint: numbers, floor: points):
    """The floor; `tint` lightens or darkens each corner's tile."""
    for k in range(position.shape[0]):
        albedo = floor[ALBEDO] * tint[k]
        put(mesh, first + k, position[k], tm.vec3(0.0, 1.0, 0.0), floor_colour(position[k], floor, albedo))


@ti.kernel
def fill_shadow(mesh: ti.template(), first: int, source: int, corners: int, floor: points):
    """The shadow of a part of the mesh: corners `source … source + corners`."""
    for k in range(corners):
        put_shadow(mesh, first + k, mesh.position[source + k], floor)


@ti.kernel
def fill_balls(mesh: ti.template(), first: int, unit: points, balls: points, radii: numbers, colours: points):
    """A copy of the unit sphere for every ball."""
    for b, k in ti.ndrange(balls.shape[0], unit.shape[0]):
        put(mesh, first + b * unit.shape[0] + k, balls[b] + radii[b] * unit[k], unit[k], colours[b])


@ti.kernel
def particle_normals(cloth: ti.template(), normal: ti.template()):
    """Mean normal of the triangles around each particle, weighted by area."""
    ti.loop_config(serialize=True)
    for _ in range(1):  # one serial task: a sum shared by several triangles has an order
        for i in range(cloth.slot_count[None]):
            normal[i] = tm.vec3(0.0)
        for t in range(cloth.triangle_count[None]):
            i, j, k = cloth.triangles[t]
            area_normal = triangle_area_normal(cloth.x[i], cloth.x[j], cloth.x[k])
            for corner in ti.static((i, j, k)):
                normal[corner] = normal[corner] + area_normal
        for i in range(cloth.slot_count[None]):
            normal[i] = normal[i] / tm.max(normal[i].norm(), TINY)


@ti.kernel
def fill_weave(cloth: ti.template(), mesh: ti.template(), normal: ti.template(), first: int, colour: points):
    """View `shaded`: every triangle in the colour of its check."""
    for t in range(cloth.triangle_count[None]):
        for k in ti.static(range(3)):
            i = cloth.triangles[t][k]
            put(mesh, first + 3 * t + k, cloth.origin[None] + cloth.x[i], normal[i], colour[t])


@ti.func
def strain_colour(strain: float) -> tm.vec3:
    """Blue where shortened, pale at rest, red where stretched; full colour at 10 % (Provot's limit)."""
    depth = tm.clamp(ti.abs(strain) / 0.1, 0.0, 1.0)
    full = tm.vec3(0.80, 0.10, 0.12)
    if strain < 0.0:
        full = tm.vec3(0.13, 0.30, 0.75)
    return tm.mix(tm.vec3(0.90, 0.89, 0.86), full, ti.sqrt(depth))


@ti.kernel
def particle_strains(cloth: ti.template(), strain: ti.template(), springs: int):
    """At every particle the strain of largest size among the first `springs` springs that meet there."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(cloth.slot_count[None]):
            strain[i] = 0.0
        for e in range(springs):
            i, j = cloth.ends[e]
            here = (cloth.x[j] - cloth.x[i]).norm() / cloth.rest[e] - 1.0
            for end in ti.static((i, j)):
                if ti.abs(here) > ti.abs(strain[end]):
                    strain[end] = here


@ti.kernel
def fill_strain(cloth: ti.template(), mesh: ti.template(), normal: ti.template(), strain: ti.template(), first: int):
    """View `strain`: every triangle coloured by the strain at its corners."""
    for t in range(cloth.triangle_count[None]):
        for k in ti.static(range(3)):
            i = cloth.triangles[t][k]
            put(mesh, first + 3 * t + k, cloth.origin[None] + cloth.x[i], normal[i], strain_colour(strain[i]))


@ti.kernel
def fill_springs(
    cloth: ti.template(), mesh: ti.template(), first: int, eye: tm.vec3, width: float, springs: int, colour: points
):
    """View `wireframe`: a thin ribbon turned to the eye for every spring; `colour` has one row a spring."""
    for e in range(springs):
        i, j = cloth.ends[e]
        a, b = cloth.origin[None] + cloth.x[i], cloth.origin[None] + cloth.x[j]
        to_eye = (eye - a).normalized()
        side = (b - a).cross(to_eye)
        side *= 0.5 * width / tm.max(side.norm(), TINY)
        corners = ti.static((a - side, b - side, b + side, a - side, b + side, a + side))
        for k in ti.static(range(6)):
            put(mesh, first + 6 * e + k, corners[k], to_eye, colour[e])


@ti.kernel
def fill_particles(cloth: ti.template(), mesh: ti.template(), first: int, size: float, free: tm.vec3, pinned: tm.vec3):
    """View `particles`: an octahedron for each, shaded like a ball; those without inverse mass in their own colour."""
    for i in range(cloth.slot_count[None]):
        colour, middle = free, cloth.origin[None] + cloth.x[i]
        if cloth.inverse_mass[i] == 0.0:
            colour = pinned
        for octant in ti.static(range(8)):
            x = 1.0 - 2.0 * (octant & 1)
            y = 1.0 - (octant & 2)
            z = 1.0 - 0.5 * (octant & 4)
            points = ti.static((tm.vec3(x, 0.0, 0.0), tm.vec3(0.0, y, 0.0), tm.vec3(0.0, 0.0, z)))
            for k in ti.static(range(3)):
                put(mesh, first + 24 * i + 3 * octant + k, middle + size * points[k], points[k], colour)
