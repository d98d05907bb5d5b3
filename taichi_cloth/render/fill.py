"""Kernels that write solids, and the cloth in each view, into a draw mesh; `lighting.py` adds the light."""

import taichi as ti
import taichi.math as tm

from ..kernels.constraint_math import TINY, triangle_area_normal

Vec3Array = ti.types.ndarray(dtype=tm.vec3, ndim=1)
FloatArray = ti.types.ndarray(dtype=ti.f32, ndim=1)

FULL_STRAIN = 0.1  # strain from which the view `strain` shows the full color: Provot's limit
UNKNOWN = -2.0  # instead of a strain, which is -1 or more: gray, a color that no strain has


@ti.func
def write_corner(mesh: ti.template(), corner: int, position: tm.vec3, normal: tm.vec3, albedo: tm.vec3):
    """Write one corner."""
    mesh.position[corner] = position
    mesh.normal[corner] = normal
    mesh.albedo[corner] = albedo


# -- solids ------------------------------------------------------------------------------------------------------------


@ti.kernel
def fill_mesh(mesh: ti.template(), first: int, position: Vec3Array, normal: Vec3Array, color: Vec3Array):
    """Write a solid from corner `first` on. The arrays have one element per corner; positions in world space [m]."""
    for k in range(position.shape[0]):
        write_corner(mesh, first + k, position[k], normal[k], color[k])


@ti.kernel
def fill_spheres(
    mesh: ti.template(), first: int, unit: Vec3Array, centers: Vec3Array, radii: FloatArray, colors: Vec3Array
):
    """Write a copy of the unit sphere for every sphere, with its center [m], radius [m] and color."""
    for b, k in ti.ndrange(centers.shape[0], unit.shape[0]):
        write_corner(mesh, first + b * unit.shape[0] + k, centers[b] + radii[b] * unit[k], unit[k], colors[b])


# -- view `shaded` -----------------------------------------------------------------------------------------------------


@ti.kernel
def particle_normals(cloth: ti.template(), normal: ti.template()):
    """Write the area-weighted mean normal of the triangles around each particle."""
    ti.loop_config(serialize=True)
    for _ in range(1):  # one serial task: the sums over triangles have a fixed order
        for i in range(cloth.packet_count[None]):
            normal[i] = tm.vec3(0.0)
        for t in range(cloth.triangle_count[None]):
            i, j, k = cloth.triangles[t]
            area_normal = triangle_area_normal(cloth.x[i], cloth.x[j], cloth.x[k])
            for corner in ti.static((i, j, k)):
                normal[corner] = normal[corner] + area_normal
        for i in range(cloth.packet_count[None]):
            normal[i] = normal[i] / tm.max(normal[i].norm(), TINY)


@ti.kernel
def fill_shaded(cloth: ti.template(), mesh: ti.template(), normal: ti.template(), first: int, color: Vec3Array):
    """Write the triangles in the view `shaded`; `color` is the pattern's color of every corner, (3·T, 3)."""
    for t in range(cloth.triangle_count[None]):
        for k in ti.static(range(3)):
            i = cloth.triangles[t][k]
            write_corner(mesh, first + 3 * t + k, cloth.origin[None] + cloth.x[i], normal[i], color[3 * t + k])


# -- view `strain` -----------------------------------------------------------------------------------------------------


@ti.func
def strain_color(strain: float) -> tm.vec3:
    """Return the color of a strain: blue if compressed, pale at rest, red if stretched; full color at FULL_STRAIN.

    UNKNOWN is gray.
    """
    depth = tm.clamp(ti.abs(strain) / FULL_STRAIN, 0.0, 1.0)
    full = tm.vec3(0.80, 0.10, 0.12)
    if strain < 0.0:
        full = tm.vec3(0.13, 0.30, 0.75)
    color = tm.mix(tm.vec3(0.90, 0.89, 0.86), full, ti.sqrt(depth))
    if strain <= UNKNOWN:
        color = tm.vec3(0.45)
    return color


@ti.kernel
def strain_colors(strain: FloatArray, color: Vec3Array):
    """Write the color of every strain."""
    for k in range(strain.shape[0]):
        color[k] = strain_color(strain[k])


@ti.kernel
def particle_strains(cloth: ti.template(), strain: ti.template(), springs: int):
    """Write for every particle the strain of largest magnitude among its springs, of the first `springs` springs."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(cloth.packet_count[None]):
            strain[i] = 0.0
        for e in range(springs):
            i, j = cloth.ends[e]
            spring_strain = (cloth.x[j] - cloth.x[i]).norm() / cloth.rest[e] - 1.0
            for end in ti.static((i, j)):
                if ti.abs(spring_strain) > ti.abs(strain[end]):
                    strain[end] = spring_strain


@ti.kernel
def fill_strain(cloth: ti.template(), mesh: ti.template(), normal: ti.template(), strain: ti.template(), first: int):
    """Write the triangles in the view `strain`, colored by the strain of their particles."""
    for t in range(cloth.triangle_count[None]):
        for k in ti.static(range(3)):
            i = cloth.triangles[t][k]
            write_corner(mesh, first + 3 * t + k, cloth.origin[None] + cloth.x[i], normal[i], strain_color(strain[i]))


# -- views `wireframe` and `particles` ---------------------------------------------------------------------------------


@ti.kernel
def fill_springs(
    cloth: ti.template(), mesh: ti.template(), first: int, eye: tm.vec3, width: float, springs: int, color: Vec3Array
):
    """Write a ribbon of `width` [m] that faces the eye for each of the first `springs` springs; `color` is (E, 3)."""
    for e in range(springs):
        i, j = cloth.ends[e]
        a, b = cloth.origin[None] + cloth.x[i], cloth.origin[None] + cloth.x[j]
        to_eye = (eye - a).normalized()
        side = (b - a).cross(to_eye)
        side *= 0.5 * width / tm.max(side.norm(), TINY)
        corners = ti.static((a - side, b - side, b + side, a - side, b + side, a + side))
        for k in ti.static(range(6)):
            write_corner(mesh, first + 6 * e + k, corners[k], to_eye, color[e])


@ti.kernel
def fill_particles(cloth: ti.template(), mesh: ti.template(), first: int, size: float, free: tm.vec3, pinned: tm.vec3):
    """Write an octahedron of radius `size` [m] for every particle, with the normals of a sphere.

    `free` and `pinned`: colors of particles with and without inverse mass.
    """
    for i in range(cloth.packet_count[None]):
        color, center = free, cloth.origin[None] + cloth.x[i]
        if cloth.inverse_mass[i] == 0.0:
            color = pinned
        for octant in ti.static(range(8)):
            x = 1.0 - 2.0 * (octant & 1)
            y = 1.0 - (octant & 2)
            z = 1.0 - 0.5 * (octant & 4)
            tips = ti.static((tm.vec3(x, 0.0, 0.0), tm.vec3(0.0, y, 0.0), tm.vec3(0.0, 0.0, z)))
            for k in ti.static(range(3)):
                write_corner(mesh, first + 24 * i + 3 * octant + k, center + size * tips[k], tips[k], color)
