"""Kernels that write solids, and the cloth in each view, into a draw mesh, and that light its corners.

Lighting: a directional light with a soft shadow and a highlight, light from sky and floor, and a rim light.

Kernels compute it at the corners of the triangles, and renderers add nothing to it. The lights of GGUI, Taichi's window
toolkit, are not used: they light both sides of a cloth alike and cast no shadow.

The shadow map is a square grid of texels perpendicular to the light. Each texel stores the depth of the surface that is
nearest to the light. A `frame` is the position of the map: its center in world space [m] and half its side [m].
"""

import numpy as np
import taichi as ti
import taichi.math as tm
from numpy.typing import NDArray

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


MOST_DIVISIONS = 64  # of the longest edge of a solid: a solid of two triangles then has at most 2 · 64² of them


def divided(
    solid: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]], longest: float
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return a solid whose edges are at most `longest` [m] long: light is computed at corners, and shadows are small.

    Each triangle is halved across its longest edge as long as it is too long. Triangles that share an edge both divide
    it in the middle, so no gaps open. Positions, normals and colors have one row per corner, (3·T, 3).
    """
    # float64: far from the origin, the middle of an edge may round to its end in float32, and halving would not end.
    triangles, finished = np.concatenate(solid, axis=1, dtype=np.float64).reshape(-1, 3, 9), []
    lengths = _edge_lengths(triangles)
    longest = max(longest, float(lengths.max(initial=0.0)) / MOST_DIVISIONS)
    while len(triangles):
        large = lengths.max(axis=1) > longest
        finished.append(triangles[~large])
        first = lengths[large].argmax(axis=1)
        a, b, c = (triangles[large][np.arange(len(first)), (first + k) % 3] for k in range(3))
        middle = (a + b) / 2
        triangles = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        lengths = _edge_lengths(triangles)
    corners = np.concatenate([*finished, triangles]).reshape(-1, 3, 3)
    corners[:, 1] /= np.maximum(np.linalg.norm(corners[:, 1], axis=1, keepdims=True), TINY)
    positions, normals, colors = corners.swapaxes(0, 1).astype(np.float32, order="C")
    return positions, normals, colors


def _edge_lengths(triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the length of the edge from each corner to the next [m], (T, 3)."""
    lengths: NDArray[np.float64] = np.linalg.norm(triangles[:, [1, 2, 0], :3] - triangles[..., :3], axis=2)
    return lengths


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


# -- lighting ----------------------------------------------------------------------------------------------------------

# -- shadow map --------------------------------------------------------------------------------------------------------

LIGHT_DIRECTION = tm.vec3(-0.45991, 0.71986, 0.51990)  # unit vector towards the light: left, up and to the front
SHADOW_U = tm.vec3(0.74900, 0.0, 0.66257)  # axis of the columns
SHADOW_V = tm.vec3(0.47696, 0.69412, -0.53917)  # axis of the rows
SHADOW_MAP_SIZE = 256  # [texels]
DEPTH_STEPS = 2.0**20  # depth steps along half the side of the map
SAMPLE_SPACING = 1.25  # [texels] between two samples; 4 × 4 samples soften the edge of a shadow
SHADOW_BIAS = 1.6  # [texels] offset of a point from its surface towards the light, against self-shadowing


@ti.func
def to_shadow_map(p: tm.vec3, frame: tm.vec4) -> tm.vec3:
    """Return column and row [texels] and depth [steps] of a point; the depth grows towards the light."""
    q = (p - frame.xyz) / frame.w
    return tm.vec3(
        (0.5 + 0.5 * q.dot(SHADOW_U)) * SHADOW_MAP_SIZE,
        (0.5 + 0.5 * q.dot(SHADOW_V)) * SHADOW_MAP_SIZE,
        (1.0 + q.dot(LIGHT_DIRECTION)) * DEPTH_STEPS,
    )


@ti.kernel
def clear_shadow_map(shadow: ti.template()):
    """Set every texel to 0: no surface."""
    for i, j in shadow:
        shadow[i, j] = 0


@ti.kernel
def cast_shadow(mesh: ti.template(), first: int, end: int, shadow: ti.template(), frame: tm.vec4):
    """Write the depth of the nearest of the triangles of corners `first` … `end` − 1 into every texel of a cleared map.

    Texels without a triangle stay 0.
    """
    for t in range(first // 3, end // 3):
        a = to_shadow_map(mesh.position[3 * t], frame)
        b = to_shadow_map(mesh.position[3 * t + 1], frame)
        c = to_shadow_map(mesh.position[3 * t + 2], frame)
        # A value that is not finite becomes the smallest integer, which makes the range empty.
        low, high = ti.cast(tm.min(a, b, c), ti.i32), ti.cast(tm.max(a, b, c), ti.i32)
        area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x)
        if ti.abs(area) > 1e-6:
            for i in range(ti.max(low.x, 0), ti.min(high.x, SHADOW_MAP_SIZE - 1) + 1):
                for j in range(ti.max(low.y, 0), ti.min(high.y, SHADOW_MAP_SIZE - 1) + 1):
                    x, y = i + 0.5 - a.x, j + 0.5 - a.y
                    v = (x * (c.y - a.y) - y * (c.x - a.x)) / area
                    w = (y * (b.x - a.x) - x * (b.y - a.y)) / area
                    if v >= 0.0 and w >= 0.0 and v + w <= 1.0:
                        ti.atomic_max(shadow[i, j], int(a.z + v * (b.z - a.z) + w * (c.z - a.z)))


@ti.func
def light_visibility(shadow: ti.template(), frame: tm.vec4, p: tm.vec3, normal: tm.vec3) -> float:
    """Return the fraction of the directional light that reaches p, 0…1; 1 outside the shadow map."""
    texel = 2.0 * frame.w / SHADOW_MAP_SIZE
    side = 1.0
    if normal.dot(LIGHT_DIRECTION) < 0.0:
        side = -1.0
    q = to_shadow_map(p + SHADOW_BIAS * texel * (side * normal + LIGHT_DIRECTION), frame)
    fraction = 1.0
    if q.x > 4.0 and q.x < SHADOW_MAP_SIZE - 4.0 and q.y > 4.0 and q.y < SHADOW_MAP_SIZE - 4.0:
        for i in range(4):
            for j in range(4):
                column = ti.math.clamp(int(q.x + SAMPLE_SPACING * (i - 1.5)), 0, SHADOW_MAP_SIZE - 1)
                row = ti.math.clamp(int(q.y + SAMPLE_SPACING * (j - 1.5)), 0, SHADOW_MAP_SIZE - 1)
                if shadow[column, row] > ti.max(int(q.z), 0):
                    fraction -= 1.0 / 16.0
    return fraction


# -- shading -----------------------------------------------------------------------------------------------------------

BACKGROUND = (0.875, 0.885, 0.895)  # factors 0…1, like all colors here
LIGHT_COLOR = tm.vec3(0.60, 0.57, 0.51)
SKY, FLOOR_LIGHT = tm.vec3(0.53, 0.545, 0.575), tm.vec3(0.36, 0.34, 0.33)  # light on surfaces that face up, and down
RIM_COLOR = tm.vec3(0.11, 0.13, 0.17)  # from the right, for surfaces that face away from the light; casts no shadow
RIM_DIRECTION = tm.vec3(0.90226, 0.25063, -0.35088)
TRANSMISSION = 0.42  # fraction of the directional light that passes through the cloth
SPECULAR_EXPONENT = 22.0  # exponent of the highlight (Blinn 1977)


@ti.func
def diffuse_at(p: tm.vec3, normal: tm.vec3, through: float, shadow: ti.template(), frame: tm.vec4) -> tm.vec3:
    """Return the red, green and blue light on a white surface at p. `through`: fraction that passes from the back."""
    cosine = normal.dot(LIGHT_DIRECTION)
    direct = tm.max(cosine, 0.0) + through * tm.max(-cosine, 0.0)
    visible = 0.0
    if direct > 0.0:  # the shadow map is most of the cost, and half of a solid faces away from the light
        visible = light_visibility(shadow, frame, p, normal)
    ambient = tm.mix(FLOOR_LIGHT, SKY, 0.5 + 0.5 * normal[1])
    return ambient + visible * direct * LIGHT_COLOR + tm.max(normal.dot(RIM_DIRECTION), 0.0) * RIM_COLOR


@ti.func
def specular_at(p: tm.vec3, normal: tm.vec3, eye: tm.vec3) -> float:
    """Return the highlight at p seen from the eye, 0…1."""
    half = ((eye - p).normalized(TINY) + LIGHT_DIRECTION).normalized(TINY)
    return tm.max(normal.dot(half), 0.0) ** SPECULAR_EXPONENT


@ti.kernel
def shade_floor(mesh: ti.template(), end: int, shadow: ti.template(), frame: tm.vec4, center: tm.vec3, reach: float):
    """Light the floor, corners 0 … `end` − 1, and fade it into the background with the distance from `center` [m].

    It is fully faded at 80 % of `reach` [m].
    """
    for k in range(end):
        p = mesh.position[k]
        distance = (p - center).norm() / reach
        lit = mesh.albedo[k] * diffuse_at(p, mesh.normal[k], 0.0, shadow, frame)
        mesh.color[k] = tm.mix(tm.min(lit, 1.0), tm.vec3(BACKGROUND), tm.smoothstep(0.2, 0.8, distance))


@ti.kernel
def shade_solids(
    mesh: ti.template(), first: int, end: int, gloss: float, eye: tm.vec3, shadow: ti.template(), frame: tm.vec4
):
    """Light corners `first` … `end` − 1 on the side of their normals."""
    for k in range(first, end):
        p, normal = mesh.position[k], mesh.normal[k]
        lit = (
            mesh.albedo[k] * diffuse_at(p, normal, 0.0, shadow, frame)
            + gloss * specular_at(p, normal, eye) * LIGHT_COLOR
        )
        mesh.color[k] = tm.min(lit, 1.0)


@ti.kernel
def shade_cloth(
    mesh: ti.template(),
    first: int,
    end: int,
    gloss: float,
    contrast: float,
    eye: tm.vec3,
    shadow: ti.template(),
    frame: tm.vec4,
):
    """Light the triangles of corners `first` … `end` − 1 on the side that faces the eye, and through from the back.

    `contrast` is the fraction of the computed light, the rest is uniform: 1 for a realistic image, less for colors that
    stand for values.
    """
    for t in range(first // 3, end // 3):
        a, b, c = mesh.position[3 * t], mesh.position[3 * t + 1], mesh.position[3 * t + 2]
        side = 1.0
        if (b - a).cross(c - a).dot(eye - a) < 0.0:
            side = -1.0
        for k in range(3):
            p, normal = mesh.position[3 * t + k], side * mesh.normal[3 * t + k]
            light = tm.mix(tm.vec3(0.95), diffuse_at(p, normal, TRANSMISSION, shadow, frame), contrast)
            lit = mesh.albedo[3 * t + k] * light + gloss * specular_at(p, normal, eye) * LIGHT_COLOR
            mesh.color[3 * t + k] = tm.min(lit, 1.0)
