"""Kernels that write bodies and the cloth in each of its views into a draw mesh, without their light."""

import taichi as ti
import taichi.math as tm

from ..kernels.maths import TINY, triangle_area_normal

points = ti.types.ndarray(dtype=tm.vec3, ndim=1)
numbers = ti.types.ndarray(dtype=ti.f32, ndim=1)

FULL_STRAIN = 0.1  # where the colour of the view `strain` is full: Provot's limit


@ti.func
def put(mesh: ti.template(), corner: int, position: tm.vec3, normal: tm.vec3, albedo: tm.vec3):
    mesh.position[corner] = position
    mesh.normal[corner] = normal
    mesh.albedo[corner] = albedo


@ti.kernel
def fill_body(mesh: ti.template(), first: int, position: points, normal: points, colour: points):
    """A body where it is; the arrays have one element for each corner."""
    for k in range(position.shape[0]):
        put(mesh, first + k, position[k], normal[k], colour[k])


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
    """View `shaded`: every corner of a triangle in its colour of the pattern, (3·T, 3)."""
    for t in range(cloth.triangle_count[None]):
        for k in ti.static(range(3)):
            i = cloth.triangles[t][k]
            put(mesh, first + 3 * t + k, cloth.origin[None] + cloth.x[i], normal[i], colour[3 * t + k])


@ti.func
def strain_colour(strain: float) -> tm.vec3:
    """Blue where shortened, pale at rest, red where stretched; full colour at FULL_STRAIN."""
    depth = tm.clamp(ti.abs(strain) / FULL_STRAIN, 0.0, 1.0)
    full = tm.vec3(0.80, 0.10, 0.12)
    if strain < 0.0:
        full = tm.vec3(0.13, 0.30, 0.75)
    return tm.mix(tm.vec3(0.90, 0.89, 0.86), full, ti.sqrt(depth))


@ti.kernel
def strain_colours(strain: numbers, colour: points):
    """The colour of each of some strains."""
    for k in range(strain.shape[0]):
        colour[k] = strain_colour(strain[k])


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
