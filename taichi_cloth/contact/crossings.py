"""How often a cloth goes through itself: edges that cross a triangle of which they have no corner."""

import taichi as ti
import taichi.math as tm

from ..kernels.hashing import sort_into_buckets
from ..kernels.layout import at
from .candidates import STRETCHED, edge_box, triangle_box, visit


@ti.func
def volume(a: tm.vec3, b: tm.vec3, c: tm.vec3, d: tm.vec3):
    """Six times that of a tetrahedron, negative where d is behind the triangle a, b, c [m³]."""
    return (b - a).cross(c - a).dot(d - a)


@ti.func
def crosses(p: tm.vec3, q: tm.vec3, a: tm.vec3, b: tm.vec3, c: tm.vec3) -> int:
    """Whether the segment p, q goes through the inside of the triangle a, b, c."""
    on_both_sides = volume(a, b, c, p) * volume(a, b, c, q) < 0.0
    u, v, w = volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)
    inside = (u > 0.0 and v > 0.0 and w > 0.0) or (u < 0.0 and v < 0.0 and w < 0.0)
    return int(on_both_sides and inside)


@ti.func
def are_strangers(cloth: ti.template(), n: int, m: int) -> int:
    """Whether triangle n and edge m share no particle."""
    a, b, c = cloth.near.triangles[n]
    i, j = cloth.near.edges[m]
    return int(a != i and b != i and c != i and a != j and b != j and c != j)


@ti.func
def count_crossing(cloth: ti.template(), now: ti.template(), n: int, m: int, move: int):
    x = ti.static(cloth.x)
    a, b, c = cloth.near.triangles[n]
    i, j = cloth.near.edges[m]
    if crosses(at(cloth, x, i), at(cloth, x, j), at(cloth, x, a), at(cloth, x, b), at(cloth, x, c)):
        ti.atomic_add(cloth.near.crossed[None], 1)


@ti.kernel
def crossings(cloth: ti.template()) -> int:
    """Counts them, for a cloth that has its `near` (`state/near.py`).

    Not seen are edges longer than one and a half times the longest at rest, far from their middle.
    """
    cloth.near.crossed[None] = 0
    widest = 0.5 * STRETCHED * cloth.near.longest[None]
    cloth.near.side[None] = 2.0 * cloth.near.longest[None]
    cloth.near.listed_for[None] = 0.0  # the buckets are used for this now: what may touch is to be listed anew
    sort_into_buckets(cloth.near.sides, cloth, edge_box, cloth.near.edge_count[None], cloth.near.side[None], 1)
    for n in range(cloth.near.triangle_count[None]):
        middle, half = triangle_box(cloth, n)
        visit(cloth, 0, cloth.near.sides, widest, are_strangers, count_crossing, n, middle, half, 0)
    return cloth.near.crossed[None]
