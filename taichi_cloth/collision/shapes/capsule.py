"""Capsule: all points within a radius of a segment along its y axis. Size: half the segment's length, radius."""

import numpy as np
import taichi as ti
import taichi.math as tm

from ...geometry.closed_surface import capsule_triangles, closest_point_on_triangle
from ...kernels.constraint_math import TINY, closest_on_triangle, push_out_of_sphere
from ...kernels.vec import abs_, broadcast, component, dot, from_components, length, scale
from ...scene.collider_schema import Capsule
from .shape import NO_IMPACT, Corners, Floats, Shape, UsdSchema, axis
from .sphere import time_to_sphere


def signed_distance(capsule: Capsule, points: Floats) -> Floats:
    half = capsule.length / 2
    offset = points.copy()
    offset[:, 1] -= np.clip(points[:, 1], -half, half)
    distance: Floats = np.linalg.norm(offset, axis=1) - capsule.radius
    return distance


def triangle_distance(capsule: Capsule, corners: Floats) -> Floats:
    """From the segment's ends and its point in the plane of a triangle to it, and from the segment to its edges."""
    half, least = capsule.length / 2, np.full(len(corners), np.inf)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    steepness = np.where(normal[:, 1] != 0, normal[:, 1], 1.0)
    in_plane = np.clip((normal * corners[:, 0]).sum(axis=1) / steepness, -half, half)
    for y in (-half, half, in_plane):
        end = np.zeros((len(corners), 3))
        end[:, 1] = y
        point = np.einsum("ij,ijk->ik", closest_point_on_triangle(end, corners), corners)
        least = np.minimum(least, np.linalg.norm(point - end, axis=1))
    for k in range(3):
        start, edge = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        across = np.maximum(edge[:, 0] ** 2 + edge[:, 2] ** 2, TINY**2)
        t = np.clip(-(start[:, 0] * edge[:, 0] + start[:, 2] * edge[:, 2]) / across, 0.0, 1.0)
        end = np.zeros_like(start)
        end[:, 1] = np.clip(start[:, 1] + t * edge[:, 1], -half, half)
        along = ((end - start) * edge).sum(axis=1) / np.maximum((edge * edge).sum(axis=1), TINY**2)
        point = start + np.clip(along, 0.0, 1.0)[:, None] * edge
        point[:, 1] -= np.clip(point[:, 1], -half, half)
        least = np.minimum(least, np.linalg.norm(point, axis=1))
    return least - capsule.radius


def triangles(capsule: Capsule) -> Corners:
    return capsule_triangles(capsule.length / 2, capsule.radius)


@ti.func
def push_out(features: ti.template(), axes, size: tm.vec3, margin: float, offset):
    along = broadcast(axis(axes, 1), offset)
    nearest = scale(along, ti.min(ti.max(dot(offset, along), -size.x), size.x))
    return push_out_of_sphere(offset, nearest, size.y + margin)


@ti.func
def radial(size: tm.vec3, point):
    """Return the vector to a point from the closest point of the segment."""
    level = ti.min(ti.max(component(point, 1), -size.x), size.x)
    return point - from_components(level * 0.0, level, level * 0.0, point)


@ti.func
def time_of_impact(features: ti.template(), size: tm.vec3, margin: float, start, path):
    """The first of three impacts: with the cylinder between the ends, and with the sphere at each end."""
    distance = size.y + margin
    in_plane = broadcast(tm.vec3(1.0, 0.0, 1.0), start)
    time = time_to_sphere(start * in_plane, path * in_plane, distance)
    time = ti.select(abs_(component(start + scale(path, time), 1)) <= size.x, time, NO_IMPACT)
    for end in ti.static((-1.0, 1.0)):
        time = ti.min(time, time_to_sphere(start - broadcast(tm.vec3(0.0, end * size.x, 0.0), start), path, distance))
    time = ti.select(length(radial(size, start)) > distance, time, NO_IMPACT)
    offset = radial(size, start + scale(path, time))
    return time, scale(offset, 1.0 / ti.max(length(offset), TINY))


@ti.func
def from_segment(half: float, point: tm.vec3) -> tm.vec3:
    """Return the vector to a point from the closest point of the segment."""
    return point - tm.vec3(0.0, ti.min(ti.max(point.y, -half), half), 0.0)


@ti.func
def fraction_closest_to_segment(half: float, p: tm.vec3, q: tm.vec3) -> float:
    """Return the fraction of p → q closest to the segment: closest to its line first, then to the end it is near."""
    edge = q - p
    across = edge.x * edge.x + edge.z * edge.z
    t = ti.min(ti.max(-(p.x * edge.x + p.z * edge.z) / ti.max(across, TINY), 0.0), 1.0)
    level = ti.min(ti.max(p.y + t * edge.y, -half), half)
    end = tm.vec3(0.0, level, 0.0)
    return ti.min(ti.max((end - p).dot(edge) / ti.max(edge.dot(edge), TINY), 0.0), 1.0)


@ti.func
def closest(size: tm.vec3, a: tm.vec3, b: tm.vec3, c: tm.vec3):
    """The closest of: the triangle to both ends of the segment, its edges to the segment."""
    half = size.x
    top = tm.vec3(0.0, half, 0.0)
    weights = closest_on_triangle(tm.vec3(0.0), a - top, b - top, c - top)
    offset = from_segment(half, weights.x * a + weights.y * b + weights.z * c)
    for k in ti.static(range(4)):
        other = tm.vec3(0.0)
        if ti.static(k == 3):
            other = closest_on_triangle(tm.vec3(0.0), a + top, b + top, c + top)
        else:
            p, q = ti.static(((a, b), (b, c), (c, a))[k])
            t = fraction_closest_to_segment(half, p, q)
            other[k], other[(k + 1) % 3] = 1.0 - t, t
        other_offset = from_segment(half, other.x * a + other.y * b + other.z * c)
        if other_offset.norm_sqr() < offset.norm_sqr():
            weights, offset = other, other_offset
    return weights, offset


@ti.func
def core(size: tm.vec3):
    return size.x, size.y


CAPSULE = Shape(
    section="capsules",
    classes=(Capsule,),
    size=lambda capsule: (capsule.length / 2, capsule.radius, 0.0),
    signed_distance=signed_distance,
    push_out=push_out,
    time_of_impact=time_of_impact,
    closest_on_triangle=closest,
    core=core,
    triangle_distance=triangle_distance,
    triangles=triangles,
    color=(0.47, 0.40, 0.34),
    usd=UsdSchema("Capsule", lambda size: {"Axis": "Y", "Height": 2 * float(size[0]), "Radius": float(size[1])}),
)
