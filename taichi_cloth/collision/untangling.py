"""Untangling: intersections of a cloth with itself are found, counted, and allowed to come apart.

Contact keeps every part of a cloth on its side of the others, also a part that is on the wrong side. Following Baraff,
Witkin and Kass 2003 (*Untangling cloth*), self-contact is switched off for the particles of intersecting edges and
triangles, for one frame at a time, until springs have pulled them apart.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.layout import read
from .self_broadphase import MAX_EDGE_STRETCH, build_hash, edge_box, query, triangle_box


@ti.func
def signed_volume(a: tm.vec3, b: tm.vec3, c: tm.vec3, d: tm.vec3):
    """Return six times the volume of a tetrahedron [m³], negative where d is behind triangle a, b, c."""
    return (b - a).cross(c - a).dot(d - a)


@ti.func
def segment_intersects_triangle(p: tm.vec3, q: tm.vec3, a: tm.vec3, b: tm.vec3, c: tm.vec3) -> int:
    """Return whether the segment p, q passes through the interior of the triangle a, b, c."""
    on_both_sides = signed_volume(a, b, c, p) * signed_volume(a, b, c, q) < 0.0
    u, v, w = signed_volume(p, q, a, b), signed_volume(p, q, b, c), signed_volume(p, q, c, a)
    inside = (u > 0.0 and v > 0.0 and w > 0.0) or (u < 0.0 and v < 0.0 and w < 0.0)
    return int(on_both_sides and inside)


@ti.func
def intersects(cloth: ti.template(), n: int, m: int) -> int:
    """Return whether edge m passes through triangle n."""
    x = ti.static(cloth.x)
    a, b, c = cloth.self_contact.triangles[n]
    i, j = cloth.self_contact.edges[m]
    return segment_intersects_triangle(
        read(cloth, x, i), read(cloth, x, j), read(cloth, x, a), read(cloth, x, b), read(cloth, x, c)
    )


@ti.func
def share_no_vertex(cloth: ti.template(), n: int, m: int) -> int:
    """Filter: triangle n and edge m share no particle."""
    a, b, c = cloth.self_contact.triangles[n]
    i, j = cloth.self_contact.edges[m]
    return int(a != i and b != i and c != i and a != j and b != j and c != j)


@ti.func
def for_each_intersection_candidate(cloth: ti.template(), ctx: ti.template(), act: ti.template(), enabled: int):
    """Call `act` for every triangle and every edge near it.

    Edges longer than `MAX_EDGE_STRETCH` times the longest at rest are missed far from their middle. This uses the hash
    of self-collision, so the candidate lists expire.
    """
    size = 2.0 * cloth.self_contact.longest_edge[None]
    for _ in range(enabled):
        cloth.self_contact.cell_size[None] = size
        cloth.self_contact.list_thickness[None] = 0.0
    build_hash(cloth.self_contact.edge_hash, cloth, edge_box, cloth.self_contact.edge_count[None], size, enabled)
    widest = 0.5 * MAX_EDGE_STRETCH * cloth.self_contact.longest_edge[None]
    for n in range(enabled * cloth.self_contact.triangle_count[None]):
        center, half = triangle_box(cloth, n)
        query(cloth, ctx, cloth.self_contact.edge_hash, widest, share_no_vertex, act, n, center, half, 0)


@ti.func
def mark_intersection(cloth: ti.template(), ctx: ti.template(), n: int, m: int, contact_pass: int):
    if intersects(cloth, n, m):
        marks = ti.static(cloth.self_contact.is_intersecting)
        a, b, c = cloth.self_contact.triangles[n]
        i, j = cloth.self_contact.edges[m]
        marks[a] = marks[b] = marks[c] = marks[i] = marks[j] = 1


@ti.func
def find_intersections(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Mark the particles of all intersections at the start of a frame."""
    if ti.static(features.untangle):
        enabled = int(ctx.s == 0)
        for n in range(enabled * cloth.self_contact.particle_count[None]):
            cloth.self_contact.is_intersecting[cloth.self_contact.particle[n]] = 0
        for_each_intersection_candidate(cloth, ctx, mark_intersection, enabled)


@ti.func
def count_intersection(cloth: ti.template(), ctx: ti.template(), n: int, m: int, contact_pass: int):
    if intersects(cloth, n, m):
        ti.atomic_add(cloth.self_contact.intersection_count[None], 1)


@ti.kernel
def count_intersections(cloth: ti.template()) -> int:
    """Return how many edges pass through a triangle, of a cloth that has `self_contact`."""
    cloth.self_contact.intersection_count[None] = 0
    for_each_intersection_candidate(cloth, 0, count_intersection, 1)
    return cloth.self_contact.intersection_count[None]
