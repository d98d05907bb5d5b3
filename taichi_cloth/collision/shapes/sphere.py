"""Sphere. Size: radius."""

import numpy as np
import taichi as ti
import taichi.math as tm

from ...geometry.closed_surface import closest_point_on_triangle, unit_sphere
from ...kernels.constraint_math import TINY, closest_on_triangle, push_out_of_sphere
from ...kernels.vec import dot, length, neg, scale
from ...scene.collider_schema import Sphere
from .shape import NO_IMPACT, Corners, Floats, Shape, UsdSchema


def signed_distance(sphere: Sphere, points: Floats) -> Floats:
    distance: Floats = np.linalg.norm(points, axis=1) - sphere.radius
    return distance


def triangle_distance(sphere: Sphere, corners: Floats) -> Floats:
    weights = closest_point_on_triangle(np.zeros((len(corners), 3)), corners)
    distance: Floats = np.linalg.norm(np.einsum("ij,ijk->ik", weights, corners), axis=1) - sphere.radius
    return distance


def triangles(sphere: Sphere) -> Corners:
    normals = unit_sphere()
    return sphere.radius * normals, normals


@ti.func
def push_out(features: ti.template(), axes, size: tm.vec3, margin: float, offset):
    return push_out_of_sphere(offset, offset * 0.0, size.x + margin)


@ti.func
def first_root(a, b, c):
    """Return the first time at which a·t² + 2b·t + c, with c > 0, falls to zero; NO_IMPACT if it does not."""
    discriminant = b * b - a * c
    time = (neg(b) - ti.sqrt(ti.max(discriminant, 0.0))) / ti.max(a, TINY * TINY)
    return ti.select((c > 0.0) & (b < 0.0) & (discriminant > 0.0), time, NO_IMPACT)


@ti.func
def time_to_sphere(start, path, radius: float):
    """Return the fraction of a path at which it reaches a sphere around the origin."""
    return first_root(dot(path, path), dot(start, path), dot(start, start) - radius * radius)


@ti.func
def time_of_impact(features: ti.template(), size: tm.vec3, margin: float, start, path):
    time = time_to_sphere(start, path, size.x + margin)
    at = start + scale(path, time)
    return time, scale(at, 1.0 / ti.max(length(at), TINY))


@ti.func
def closest(size: tm.vec3, a: tm.vec3, b: tm.vec3, c: tm.vec3):
    weights = closest_on_triangle(tm.vec3(0.0), a, b, c)
    return weights, weights.x * a + weights.y * b + weights.z * c


@ti.func
def core(size: tm.vec3):
    return 0.0, size.x


SPHERE = Shape(
    section="spheres",
    classes=(Sphere,),
    size=lambda sphere: (sphere.radius, 0.0, 0.0),
    signed_distance=signed_distance,
    push_out=push_out,
    time_of_impact=time_of_impact,
    closest_on_triangle=closest,
    core=core,
    triangle_distance=triangle_distance,
    triangles=triangles,
    color=(0.13, 0.35, 0.50),
    usd=UsdSchema("Sphere", lambda size: {"Radius": float(size[0])}),
)
