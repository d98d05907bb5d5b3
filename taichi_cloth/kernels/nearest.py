"""Nearest points of triangles and of segments, as weights of their corners (Ericson 2005, *Real-Time Collision
Detection*, sections 5.1.5 and 5.1.9).
"""

import taichi as ti
import taichi.math as tm

from .maths import TINY


@ti.func
def share_along(p: tm.vec3, a: tm.vec3, b: tm.vec3):
    """Share of the way from a to b at which the segment is nearest to p."""
    way = b - a
    return tm.clamp((p - a).dot(way) / ti.max(way.dot(way), TINY * TINY), 0.0, 1.0)


@ti.func
def nearest_on_triangle(p: tm.vec3, a: tm.vec3, b: tm.vec3, c: tm.vec3):
    """Weights of a, b and c at the point of the triangle that is nearest to p; good for a triangle without area too."""
    ab, ac, ap = b - a, c - a, p - a
    d00, d01, d11 = ab.dot(ab), ab.dot(ac), ac.dot(ac)
    d20, d21 = ap.dot(ab), ap.dot(ac)
    area = d00 * d11 - d01 * d01
    v, w = d11 * d20 - d01 * d21, d00 * d21 - d01 * d20
    weights = tm.vec3(0.0)
    if area > 1e-9 * d00 * d11 and v >= 0.0 and w >= 0.0 and v + w <= area:
        weights = tm.vec3(area - v - w, v, w) / area
    else:  # on its border: the nearest of three segments
        best = tm.inf
        for k in ti.static(range(3)):
            p0, p1 = ti.static(((a, b), (b, c), (c, a))[k])
            t = share_along(p, p0, p1)
            away = p0 + (p1 - p0) * t - p
            if away.dot(away) < best:
                best = away.dot(away)
                weights = tm.vec3(0.0)
                weights[k] = 1.0 - t
                weights[(k + 1) % 3] = t
    return weights


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
