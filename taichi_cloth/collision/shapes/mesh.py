"""Closed triangle mesh, by a signed distance grid (`geometry/signed_distance.py`). Size: its number among the grids.

Distances are trilinear between nodes. The SIMD layout queries its eight points one by one: they read from all over the
grid.
"""

import numpy as np
import taichi as ti
import taichi.math as tm
from numpy.typing import NDArray

from ...geometry.closed_surface import smooth_normals
from ...geometry.signed_distance import collider_sdf, collider_surface, distances_to_surface
from ...kernels.constraint_math import TINY
from ...kernels.vec import LANES, abs_, cast, is_scalar, neg
from ...scene.collider_schema import Mesh
from .shape import NO_IMPACT, Corners, Floats, Shape, to_local, to_world

PUSH_ITERATIONS = 3  # near the surface the first is enough
MAX_TRACE_STEPS = 64
TRACE_TOLERANCE = 1e-5  # [m]


def signed_distance(mesh: Mesh, points: Floats) -> Floats:
    return distances_to_surface(collider_surface(mesh), points) if mesh.clip else collider_sdf(mesh).at(points)


def triangles(mesh: Mesh) -> Corners:
    surface = collider_surface(mesh)
    return surface.corners.reshape(-1, 3), smooth_normals(surface).reshape(-1, 3)


def polygons(mesh: Mesh) -> tuple[Floats, NDArray[np.int64]]:
    surface = collider_surface(mesh)
    return surface.vertices, surface.faces


@ti.func
def half_extent(sdf: ti.template(), m: int) -> tm.vec3:
    """Return half the sides of the grid of mesh m [m]."""
    return cast(sdf.nodes[m] - 1, ti.f32) * (0.5 * sdf.spacing[m])


@ti.func
def sdf_at(sdf: ti.template(), m: int, point: tm.vec3):
    """Return the signed distance to mesh m [m] and its gradient.

    Outside the grid the distance is a lower bound, and the gradient that of the closest point of the grid.
    """
    nodes, spacing, half = sdf.nodes[m], sdf.spacing[m], half_extent(sdf, m)
    inside = ti.min(ti.max(point, neg(half)), half)
    steps = (inside + half) / spacing
    cell = ti.min(cast(steps, ti.i32), nodes - 2)
    b = steps - cast(cell, ti.f32)
    a = 1.0 - b
    n = sdf.first[m] + (cell.x * nodes.y + cell.y) * nodes.z + cell.z
    up, on = nodes.z, nodes.y * nodes.z  # to the next node along y and along x
    v = ti.static(sdf.values)
    near_low, near_high = v[n] * a.z + v[n + 1] * b.z, v[n + up] * a.z + v[n + up + 1] * b.z
    far_low, far_high = v[n + on] * a.z + v[n + on + 1] * b.z, v[n + on + up] * a.z + v[n + on + up + 1] * b.z
    near, far = near_low * a.y + near_high * b.y, far_low * a.y + far_high * b.y
    along_z = ((v[n + 1] - v[n]) * a.y + (v[n + up + 1] - v[n + up]) * b.y) * a.x + (
        (v[n + on + 1] - v[n + on]) * a.y + (v[n + on + up + 1] - v[n + on + up]) * b.y
    ) * b.x
    gradient = tm.vec3(far - near, (near_high - near_low) * a.x + (far_high - far_low) * b.x, along_z) / spacing
    distance = near * a.x + far * b.x
    outside = (point - inside).norm_sqr()
    if outside > 0.0:
        distance = ti.sqrt(outside + distance * distance)
    return distance, gradient


@ti.func
def push_out_one(sdf: ti.template(), m: int, margin: float, point: tm.vec3) -> tm.vec3:
    """Return the displacement of one local point to the margin, along the gradient; zero outside."""
    push = tm.vec3(0.0)
    if (abs_(point) - half_extent(sdf, m)).max() < 0.0:  # the grid extends beyond the margin
        left = PUSH_ITERATIONS
        while left > 0:
            left -= 1
            distance, gradient = sdf_at(sdf, m, point + push)
            if distance < margin:
                push += gradient * ((margin - distance) / ti.max(gradient.norm(), TINY))
            else:
                left = 0
    return push


@ti.func
def push_out_local(sdf: ti.template(), m: int, margin: float, point):
    if ti.static(is_scalar(point)):
        return push_out_one(sdf, m, margin, point)
    else:
        push = point * 0.0
        for k in range(LANES):
            one = push_out_one(sdf, m, margin, tm.vec3(point[0, k], point[1, k], point[2, k]))
            for c in ti.static(range(3)):
                push[c, k] = one[c]
        return push


@ti.func
def push_out(features: ti.template(), axes, size: tm.vec3, margin: float, offset):
    return to_world(axes, push_out_local(features.sdf, int(size.x), margin, to_local(axes, offset)))


@ti.func
def sphere_trace_one(sdf: ti.template(), m: int, margin: float, start: tm.vec3, path: tm.vec3):
    """Sphere tracing: advance by the distance to the margin, at least by a part of a cell; once past it, go back."""
    time, speed, least = 0.0, ti.max(path.norm(), TINY), 0.25 * sdf.spacing[m]
    distance, gradient = sdf_at(sdf, m, start)
    gap, crossed = distance - margin, False
    if gap <= 0.0:
        time = NO_IMPACT
    for _ in range(MAX_TRACE_STEPS):
        if time <= 1.0 and ti.abs(gap) > TRACE_TOLERANCE:
            crossed = crossed or gap < 0.0
            if not crossed:
                gap = ti.max(gap, least)
            time += gap / speed
            distance, gradient = sdf_at(sdf, m, start + time * path)
            gap = distance - margin
    if not (crossed or ti.abs(gap) <= TRACE_TOLERANCE) or gradient.dot(path) >= 0.0:
        time = NO_IMPACT
    return time, gradient / ti.max(gradient.norm(), TINY)


@ti.func
def sphere_trace(sdf: ti.template(), m: int, margin: float, start, path):
    if ti.static(is_scalar(start)):
        return sphere_trace_one(sdf, m, margin, start, path)
    else:
        times, normals = ti.Vector([NO_IMPACT for _ in ti.static(range(LANES))]), start * 0.0
        for k in range(LANES):
            time, normal = sphere_trace_one(
                sdf,
                m,
                margin,
                tm.vec3(start[0, k], start[1, k], start[2, k]),
                tm.vec3(path[0, k], path[1, k], path[2, k]),
            )
            times[k] = time
            for c in ti.static(range(3)):
                normals[c, k] = normal[c]
        return times, normals


@ti.func
def time_of_impact(features: ti.template(), size: tm.vec3, margin: float, start, path):
    """To a quarter of a cell within the margin: where `push_out` left a point between nodes it is off by less."""
    m = int(size.x)
    return sphere_trace(features.sdf, m, margin - 0.25 * features.sdf.spacing[m], start, path)


MESH = Shape(
    section="meshes",
    classes=(Mesh,),
    size=lambda mesh: (0.0, 0.0, 0.0),  # `colliders.collider_table` sets the number
    signed_distance=signed_distance,
    push_out=push_out,
    time_of_impact=time_of_impact,
    triangles=triangles,
    color=(0.80, 0.77, 0.71),
    polygons=polygons,
)
