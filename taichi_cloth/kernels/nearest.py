"""Nearest points of triangles and of segments, as weights of their corners (Ericson 2005, *Real-Time Collision
Detection*, sections 5.1.5 and 5.1.9).
"""

import taichi as ti
import taichi.math as tm

from .maths import TINY


@ti.func
def shares_at_origin(a: tm.vec3, b: tm.vec3, c: tm.vec3) -> tm.vec3:
    """Of the triangle's point nearest to the origin: by the region that it lies in (Ericson 2005, *Real-Time Collision
    Detection*, section 5.1.5).
    """
    ab, ac = b - a, c - a
    a1, a2, b1, b2, c1, c2 = -ab.dot(a), -ac.dot(a), -ab.dot(b), -ac.dot(b), -ab.dot(c), -ac.dot(c)
    at_a, at_b, at_c = b1 * c2 - c1 * b2, c1 * a2 - a1 * c2, a1 * b2 - b1 * a2  # areas, times the whole one
    shares = tm.vec3(at_a, at_b, at_c) / ti.max(at_a + at_b + at_c, TINY * TINY)
    if a1 <= 0.0 and a2 <= 0.0:
        shares = tm.vec3(1.0, 0.0, 0.0)
    elif b1 >= 0.0 and b2 <= b1:
        shares = tm.vec3(0.0, 1.0, 0.0)
    elif c2 >= 0.0 and c1 <= c2:
        shares = tm.vec3(0.0, 0.0, 1.0)
    elif at_c <= 0.0 and a1 >= 0.0 and b1 <= 0.0:
        t = a1 / (a1 - b1)
        shares = tm.vec3(1.0 - t, t, 0.0)
    elif at_b <= 0.0 and a2 >= 0.0 and c2 <= 0.0:
        t = a2 / (a2 - c2)
        shares = tm.vec3(1.0 - t, 0.0, t)
    elif at_a <= 0.0 and b2 >= b1 and c1 >= c2:
        t = (b2 - b1) / ((b2 - b1) + (c1 - c2))
        shares = tm.vec3(0.0, 1.0 - t, t)
    return shares


@ti.func
def nearest_on_triangle(p: tm.vec3, a: tm.vec3, b: tm.vec3, c: tm.vec3):
    """Weights of a, b and c at the point of the triangle that is nearest to p."""
    return shares_at_origin(a - p, b - p, c - p)


@ti.func
def nearest_of_segments(a: tm.vec3, b: tm.vec3, c: tm.vec3, d: tm.vec3):
    """Shares of the ways a → b and c → d at which two segments are nearest to each other."""
    u, v, r = b - a, d - c, a - c
    uu, vv, uv = ti.max(u.dot(u), TINY * TINY), ti.max(v.dot(v), TINY * TINY), u.dot(v)
    square = uu * vv - uv * uv  # of |u×v|: nothing where they are parallel
    s = 0.5
    if square > 1e-9 * uu * vv:
        s = tm.clamp((uv * v.dot(r) - vv * u.dot(r)) / square, 0.0, 1.0)
    t = (uv * s + v.dot(r)) / vv
    if t < 0.0 or t > 1.0:
        t = tm.clamp(t, 0.0, 1.0)
        s = tm.clamp((uv * t - u.dot(r)) / uu, 0.0, 1.0)
    return s, t
