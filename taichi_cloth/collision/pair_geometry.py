"""Geometry of a pair of parts of a cloth: a particle and a triangle, or two edges, and boxes around parts.

Both are convex, so a direction n along which all of part A lies beyond all of part B proves that they do not touch.
`separation` is that gap for any n; it is greatest, and then the distance, for n between the nearest points.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.constraint_math import TINY, closest_on_triangle, fraction_on_segment

BITS = 20  # of a coordinate
RANGE = (1 << BITS) - 1
STEP = 2.0**-14  # [m] of a coordinate: the range is ±32 m
VERTEX_TRIANGLE, EDGE_EDGE = 0, 1
NEARLY_PARALLEL = 1e-4  # sin² of two edges, below which the point where their lines are nearest is ill-conditioned


@ti.func
def nearest_weights(kind: int, p0: tm.vec3, p1: tm.vec3, p2: tm.vec3, p3: tm.vec3) -> tm.vec4:
    """Return the weights of the corners in the gap between the nearest points: Σ w·p points from part B to part A."""
    weights = tm.vec4(0.0)
    if kind == VERTEX_TRIANGLE:
        w = closest_on_triangle(p0, p1, p2, p3)
        weights = tm.vec4(1.0, -w.x, -w.y, -w.z)
    else:
        s, t = nearest_on_edges(p0, p1, p2, p3)
        weights = tm.vec4(1.0 - s, s, t - 1.0, -t)
    return weights


@ti.func
def nearest_on_edges(a: tm.vec3, b: tm.vec3, c: tm.vec3, d: tm.vec3):
    """Return the fractions of a → b and c → d at which two segments are nearest, also if they are parallel.

    The nearest points lie inside both, or at an end of one: all five cases are compared.
    """
    u, v, r = b - a, d - c, a - c
    uu, vv, uv = u.dot(u), v.dot(v), u.dot(v)
    cross_squared = uu * vv - uv * uv
    best, s, t = tm.inf, 0.0, 0.0
    if cross_squared > NEARLY_PARALLEL * uu * vv:
        inner_s = (uv * v.dot(r) - vv * u.dot(r)) / cross_squared
        inner_t = (uu * v.dot(r) - uv * u.dot(r)) / cross_squared
        if inner_s >= 0.0 and inner_s <= 1.0 and inner_t >= 0.0 and inner_t <= 1.0:
            s, t = inner_s, inner_t
            best = (r + u * s - v * t).norm_sqr()
    if best == tm.inf:
        for k in ti.static(range(4)):
            end_s, end_t = float(k % 2), float(k % 2)
            if ti.static(k < 2):
                end_t = fraction_on_segment(a + u * end_s, c, d)
            else:
                end_s = fraction_on_segment(c + v * end_t, a, b)
            distance = (r + u * end_s - v * end_t).norm_sqr()
            if distance < best:
                best, s, t = distance, end_s, end_t
    return s, t


@ti.func
def extremes(kind: int, k: tm.vec4):
    """Return the lowest height of part A and the highest of part B, from the heights of the corners along a normal."""
    lowest, highest = k[0], ti.max(k[2], k[3])
    if kind == EDGE_EDGE:
        lowest = ti.min(k[0], k[1])
    else:
        highest = ti.max(k[1], highest)
    return lowest, highest


@ti.func
def heights(field: ti.template(), corners: tm.ivec4, base: tm.vec3, n: tm.vec3) -> tm.vec4:
    """Return the heights of the corners along n, above `base`: differences lose less to rounding than positions."""
    return tm.vec4([n.dot(field[corners[k]] - base) for k in ti.static(range(4))])


@ti.func
def separation(field: ti.template(), corners: tm.ivec4, kind: int, n: tm.vec3) -> float:
    """Return the gap between the parts along n [m]: if it is positive, they do not touch."""
    lowest, highest = extremes(kind, heights(field, corners, field[corners[0]], n))
    return lowest - highest


@ti.func
def separation_of_any(data: ti.template(), corners: tm.ivec4, kind: int, n: tm.vec3) -> float:
    """Return the gap along n [m] that remains whichever corners are where they were and which are where they want."""
    base = data.x_safe[corners[0]]
    lowest_start, highest_start = extremes(kind, heights(data.x_safe, corners, base, n))
    lowest_end, highest_end = extremes(kind, heights(data.x_target, corners, base, n))
    return ti.min(lowest_start, lowest_end) - ti.max(highest_start, highest_end)


@ti.func
def separating_direction(data: ti.template(), corners: tm.ivec4, kind: int, last: tm.vec3):
    """Return the direction of the greatest gap at the safe positions, that gap [m], and the weights of the corners.

    Candidates are the direction between the nearest points, the last one that separated the parts, and the normal of
    the triangle or of both edges, which stays well-conditioned where the nearest points do not.
    """
    x = ti.static(data.x_safe)
    p0 = x[corners[0]]
    p1, p2, p3 = x[corners[1]] - p0, x[corners[2]] - p0, x[corners[3]] - p0
    weights = nearest_weights(kind, tm.vec3(0.0), p1, p2, p3)
    apart = weights[1] * p1 + weights[2] * p2 + weights[3] * p3
    distance = apart.norm()
    n, gap = last, separation(x, corners, kind, last)
    if distance > TINY:
        direction = apart / distance
        found = separation(x, corners, kind, direction)
        if found > gap:
            n, gap = direction, found
    if gap < 0.9 * distance:
        across = (p2 - p1).cross(p3 - p1)
        if kind == EDGE_EDGE:
            across = p1.cross(p3 - p2)
        if across.norm() > TINY * TINY:
            across = across.normalized() * ti.select(across.dot(n) < 0.0, -1.0, 1.0)
            found = separation(x, corners, kind, across)
            if found > gap:
                n, gap = across, found
    return n, gap, weights


# -- boxes around parts ------------------------------------------------------------------------------------------------

# Boxes around parts of a moving cloth are packed into integers: two are compared by four subtractions. A point is one
# 64-bit integer: 20 bits for each coordinate and a guard bit above each. If the guard bits of b are set, (b − a) leaves
# each of them set exactly where the coordinate of b is not less than that of a. A moving box has its lower and its
# upper corner at the start and at the end of a period, rounded outward. (Twelve floats of both boxes would have to be
# read one by one: 38 ns a comparison instead of 8.)


@ti.func
def packed(low: tm.vec3) -> ti.i64:
    """Return the packed point of three whole numbers, limited to the range."""
    word = ti.cast(0, ti.i64)
    for c in ti.static(range(3)):
        value = ti.cast(tm.clamp(low[c] + 0.5 * RANGE, 0.0, float(RANGE)), ti.i64)
        word = word | (value << ti.static((BITS + 1) * c))
    return word


@ti.func
def guards() -> ti.i64:
    one = ti.cast(1, ti.i64)
    return (one << BITS) | (one << (2 * BITS + 1)) | (one << (3 * BITS + 2))


@ti.func
def pack_box(low: tm.vec3, high: tm.vec3, end_low: tm.vec3, end_high: tm.vec3):
    """Return a packed moving box."""
    return ti.Vector(
        [
            packed(ti.floor(low / STEP)),
            packed(ti.ceil(high / STEP)),
            packed(ti.floor(end_low / STEP)),
            packed(ti.ceil(end_high / STEP)),
        ]
    )


@ti.func
def are_apart(a, b) -> int:
    """Return whether two moving boxes stay apart.

    Sides move evenly: they do not meet if they are in the same order, along the same axis, at the start and at the end.
    """
    guard = guards()
    below = ((b[1] | guard) - a[0]) | ((b[3] | guard) - a[2])  # guards set where b reaches up to a
    above = ((a[1] | guard) - b[0]) | ((a[3] | guard) - b[2])
    return int((below & above & guard) != guard)


@ti.func
def least(a: ti.i64, b: ti.i64) -> ti.i64:
    """Return the lower corner around two points."""
    word = ti.cast(0, ti.i64)
    for c in ti.static(range(3)):
        mask = ti.cast(RANGE, ti.i64) << ti.static((BITS + 1) * c)
        word = word | ti.min(a & mask, b & mask)
    return word


@ti.func
def greatest(a: ti.i64, b: ti.i64) -> ti.i64:
    """Return the upper corner around two points."""
    word = ti.cast(0, ti.i64)
    for c in ti.static(range(3)):
        mask = ti.cast(RANGE, ti.i64) << ti.static((BITS + 1) * c)
        word = word | ti.max(a & mask, b & mask)
    return word


@ti.func
def box_around(a, b):
    """Return the moving box around two others."""
    return ti.Vector([least(a[0], b[0]), greatest(a[1], b[1]), least(a[2], b[2]), greatest(a[3], b[3])])


MAX_LEVELS = 20  # of a tree, in the parallel layout: a million triangles


@ti.func
def refit_node(tree: ti.template(), node: int):
    """Set the box of an inner node."""
    tree.node_boxes[node] = box_around(tree.node_boxes[node + 1], tree.node_boxes[tree.skip[node + 1]])


@ti.func
def node_at(levels: int, level: int, position: int) -> int:
    """Return the node at a position of a level of a perfect tree in depth-first order. The root has level 0."""
    node = 0
    for k in range(level):
        child_size = (1 << (levels - 1 - k)) - 1
        node += 1 + ((position >> (level - 1 - k)) & 1) * child_size
    return node


@ti.func
def refit_inner_nodes(tree: ti.template(), is_parallel: ti.template(), enabled: int):
    """Set the boxes of all inner nodes from those of the leaves. `enabled` is 1, or 0 to do nothing."""
    if ti.static(is_parallel):
        for k in ti.static(range(MAX_LEVELS)):
            level = tree.levels[None] - 2 - k
            for position in range(ti.select(level < 0, 0, enabled << ti.max(level, 0))):
                refit_node(tree, node_at(tree.levels[None], tree.levels[None] - 2 - k, position))
    else:
        nodes = 2 * tree.leaf_count[None] - 1
        for k in range(enabled * nodes):  # children have higher numbers
            if tree.leaf[nodes - 1 - k] < 0:
                refit_node(tree, nodes - 1 - k)
