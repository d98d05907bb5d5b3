"""Where a triangle is nearest to the axis of a round body: a ball's middle, or the line between a capsule's round ends.

Places are along the body's own axes, around its middle; a capsule's axis is y. All give the shares of the triangle's
corners and the way to that point from the nearest one of the axis.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.maths import TINY
from ..kernels.nearest import nearest_on_triangle


@ti.func
def shares_at_origin(a: tm.vec3, b: tm.vec3, c: tm.vec3) -> tm.vec3:
    """Of the triangle's point nearest to the origin."""
    return nearest_on_triangle(tm.vec3(0.0), a, b, c)


@ti.func
def share_at_axis(half: float, p: tm.vec3, q: tm.vec3) -> float:
    """How far from p to q the point is that is nearest to the axis: first to the endless one, then to its end."""
    way = q - p
    across = way.x * way.x + way.z * way.z
    t = ti.min(ti.max(-(p.x * way.x + p.z * way.z) / ti.max(across, TINY), 0.0), 1.0)
    level = ti.min(ti.max(p.y + t * way.y, -half), half)
    end = tm.vec3(0.0, level, 0.0)
    return ti.min(ti.max((end - p).dot(way) / ti.max(way.dot(way), TINY), 0.0), 1.0)


@ti.func
def from_axis(half: float, place: tm.vec3) -> tm.vec3:
    """The way to a place from the nearest point of the axis."""
    return place - tm.vec3(0.0, ti.min(ti.max(place.y, -half), half), 0.0)


@ti.func
def nearest_to_ball(size: tm.vec3, a: tm.vec3, b: tm.vec3, c: tm.vec3):
    shares = shares_at_origin(a, b, c)
    return shares, shares.x * a + shares.y * b + shares.z * c


@ti.func
def nearest_to_capsule(size: tm.vec3, a: tm.vec3, b: tm.vec3, c: tm.vec3):
    """The nearest of the triangle to the axis's ends, and of its edges to the axis."""
    half = size.x
    shares = shares_at_origin(a - tm.vec3(0.0, half, 0.0), b - tm.vec3(0.0, half, 0.0), c - tm.vec3(0.0, half, 0.0))
    way = from_axis(half, shares.x * a + shares.y * b + shares.z * c)
    for k in ti.static(range(4)):
        other = tm.vec3(0.0)
        if ti.static(k == 3):
            low = tm.vec3(0.0, half, 0.0)
            other = shares_at_origin(a + low, b + low, c + low)
        else:
            p, q = ti.static(((a, b), (b, c), (c, a))[k])
            t = share_at_axis(half, p, q)
            other[k], other[(k + 1) % 3] = 1.0 - t, t
        there = from_axis(half, other.x * a + other.y * b + other.z * c)
        if there.norm_sqr() < way.norm_sqr():
            shares, way = other, there
    return shares, way


# By the kind of body.
NEAREST = {"spheres": nearest_to_ball, "capsules": nearest_to_capsule}
