"""Self-collision: parts of a cloth closer than its thickness are moved apart, with friction.

A contact has up to four particles with weights: two particles (1, −1), a particle and a point of a triangle, or points
of two edges. Σ weight·x is the gap and Σ weight·x_prev the gap at the start of the substep; where they point in
opposite directions the parts have passed through each other and are brought back. Parts that were no farther apart on
the flat sheet do not collide.

Contacts are resolved in Jacobi fashion, all from the same positions. Corrections are summed as integers, which makes
the result independent of order and thread count. Each of n contacts of a particle may apply 1/n of its correction
(Macklin et al. 2014, *Unified particle physics*, section 4.2). Here n is the sum of their depths over the largest
depth, because counting grazing contacts would weaken a deep one (a fold sank to a sixth of the thickness), and the
largest n of the contact's particles, so that momentum is conserved.

Untangling: contact keeps every part of a cloth on its side of the others, also a part that is on the wrong side.
Following Baraff, Witkin and Kass 2003 (*Untangling cloth*), self-contact is switched off for the particles of
intersecting edges and triangles, for one frame at a time, until springs have pulled them apart.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.constraint_math import TINY, friction_correction
from ..kernels.integration import project_position
from ..kernels.layout import packet, read, read_inverse_mass
from ..kernels.step_params import SELF_FRICTION, THICKNESS
from ..kernels.vec import cast
from .self_broadphase import (
    CORRECTIONS,
    DEPTHS,
    MAX_EDGE_STRETCH,
    build_hash,
    edge_box,
    edge_weights,
    for_each_candidate,
    query,
    query_edges,
    query_particles,
    query_triangles,
    triangle_box,
    triangle_weights,
    update_candidates,
)
from .static_friction import slide_since_anchor

# Corrections and depths are summed as integers, in these parts of the thickness. A part must be much shorter than g·h²
# divided by the number of contacts of a particle: its contacts are that deep when it rests.
UNITS = 1 << 24  # of a correction: with 1 << 20 resting layers of 4 mm have too little friction
MAX_CORRECTION = 16.0 * UNITS  # of one contact, so that the sum of 7 fits
DEPTH_UNITS = 1 << 19  # of a depth: with 1 << 12 they bounce
MAX_DEPTH = 2.0  # thicknesses: deeper contacts count as this, so that the sum of 2000 fits
MAX_SEPARATION_SPEED = 1.5  # [m/s] of parts that are moved apart: with 1.0 the ball of `stack` goes through layers
NEIGHBOR_DISTANCE = 1.01  # thicknesses apart on the flat sheet: neighbors must not collide by rounding
OVER_RELAXATION = 1.5  # of friction: with 1 resting layers creep, with more than 2 sliding is reversed and grows


@ti.func
def depth_in_units(depth: float, thickness: float) -> int:
    return ti.cast(ti.min(depth / thickness, MAX_DEPTH) * DEPTH_UNITS, ti.i32)


@ti.func
def in_units(correction: tm.vec3) -> tm.ivec3:
    return cast(tm.clamp(ti.round(correction), -MAX_CORRECTION, MAX_CORRECTION), ti.i32)


@ti.func
def effective_count(depth_sum: int, max_depth: int) -> float:
    """Return the number of contacts as deep as the deepest, n, that a sum of depths amounts to."""
    return ti.cast(depth_sum, ti.f32) / ti.cast(ti.max(max_depth, 1), ti.f32)


@ti.func
def stopped_share(depth: int, max_depth: int) -> float:
    """Return the share of a sliding motion that friction of one contact may stop, in proportion to its depth.

    If each contact of a particle stopped all of it, together they would reverse it, and energy would grow.
    """
    return ti.min(OVER_RELAXATION * ti.cast(depth + 1, ti.f32) / ti.cast(max_depth + 1, ti.f32), 1.0)


@ti.func
def resolve_contact(
    cloth: ti.template(),
    ctx: ti.template(),
    particles: ti.template(),
    weights: ti.template(),
    count: ti.template(),
    contact_pass: int,
    entry: int,
    static_friction: ti.template(),
):
    """Add the depth of a contact to the sum of each of its `count` particles; in the pass `CORRECTIONS`, add their
    corrections.

    Returns 1 if there is a contact. `entry`: of the candidate list, whose anchor static friction uses; −1 for none.
    """
    thickness = ctx.params[THICKNESS]
    gap, intersecting = tm.vec3(0.0), 0
    for k in ti.static(range(count)):
        gap += weights[k] * read(cloth, cloth.x, particles[k])
        intersecting |= cloth.self_contact.is_intersecting[particles[k]]
    distance, touching = gap.norm(), 0
    if distance < thickness and intersecting == 0:
        start_gap, flat_gap, inverse_mass, contacts, deepest = tm.vec3(0.0), tm.vec3(0.0), 0.0, 1.0, 0
        for k in ti.static(range(count)):
            start_gap += weights[k] * read(cloth, cloth.x_prev, particles[k])
            flat_gap += weights[k] * cloth.self_contact.flat_position[particles[k]]
            inverse_mass += weights[k] * weights[k] * read_inverse_mass(cloth, particles[k])
            max_depth = cloth.self_contact.max_depth[particles[k]]
            contacts = ti.max(contacts, effective_count(cloth.self_contact.depth_sum[particles[k]], max_depth))
            deepest = ti.max(deepest, max_depth)
        flat_distance = flat_gap.norm()
        if flat_distance > NEIGHBOR_DISTANCE * thickness and inverse_mass > 0.0:
            touching = 1
            side = ti.select(gap.dot(start_gap) < 0.0, -1.0, 1.0)
            depth = thickness - side * distance
            units = depth_in_units(depth, thickness)
            if contact_pass == DEPTHS:
                for k in ti.static(range(count)):
                    ti.atomic_add(cloth.self_contact.depth_sum[particles[k]], units)
                    ti.atomic_max(cloth.self_contact.max_depth[particles[k]], units)
            else:
                normal = side * gap / ti.max(distance, TINY)
                if distance < 1e-4 * thickness:  # at one point: separate as on the flat sheet
                    normal = flat_gap / flat_distance
                motion = gap - start_gap
                limit = ti.max(MAX_SEPARATION_SPEED * ctx.h * ctx.dt_scale - normal.dot(motion), 0.0)
                push = normal * ti.min(depth, limit)
                slide = motion + push
                if ti.static(static_friction):  # noqa: SIM102 (only this condition is known while compiling)
                    if entry >= 0:
                        slide += slide_since_anchor(cloth.friction_anchors, ctx, entry, normal, start_gap, push)
                push += friction_correction(push, slide * stopped_share(units, deepest), ctx.params[SELF_FRICTION])
                unit = UNITS / (thickness * inverse_mass * contacts)
                for k in ti.static(range(count)):
                    factor = weights[k] * read_inverse_mass(cloth, particles[k]) * unit
                    ti.atomic_add(cloth.self_contact.correction[particles[k]], in_units(push * factor))
    return touching


@ti.func
def contact_vertex_vertex(cloth: ti.template(), ctx: ti.template(), n: int, m: int, contact_pass: int, entry: int = -1):
    particles = tm.ivec2(cloth.self_contact.particle[n], cloth.self_contact.particle[m])
    return resolve_contact(cloth, ctx, particles, tm.vec2(1.0, -1.0), 2, contact_pass, entry, False)


@ti.func
def contact_vertex_vertex_static(
    cloth: ti.template(), ctx: ti.template(), n: int, m: int, contact_pass: int, entry: int = -1
):
    """A contact of two particles with static friction.

    It is a function of its own, because the broad phase takes a function as template argument.
    """
    particles = tm.ivec2(cloth.self_contact.particle[n], cloth.self_contact.particle[m])
    return resolve_contact(cloth, ctx, particles, tm.vec2(1.0, -1.0), 2, contact_pass, entry, True)


@ti.func
def contact_vertex_triangle(
    cloth: ti.template(), ctx: ti.template(), n: int, m: int, contact_pass: int, entry: int = -1
):
    """A contact of triangle n and particle m."""
    a, b, c = cloth.self_contact.triangles[n]
    p = cloth.self_contact.particle[m]
    return resolve_contact(
        cloth, ctx, tm.ivec4(p, a, b, c), triangle_weights(cloth, n, m), 4, contact_pass, entry, False
    )


@ti.func
def contact_edge_edge(cloth: ti.template(), ctx: ti.template(), n: int, m: int, contact_pass: int, entry: int = -1):
    a, b = cloth.self_contact.edges[n]
    c, d = cloth.self_contact.edges[m]
    return resolve_contact(cloth, ctx, tm.ivec4(a, b, c, d), edge_weights(cloth, n, m), 4, contact_pass, entry, False)


@ti.func
def visit_contacts(cloth: ti.template(), features: ti.template(), ctx: ti.template(), contact_pass: int):
    """Visit all candidates once, to sum depths or corrections."""
    if ti.static(features.self_triangles):
        for_each_candidate(
            cloth, ctx, cloth.self_contact.vertex_triangle, query_triangles, contact_vertex_triangle, contact_pass
        )
        for_each_candidate(cloth, ctx, cloth.self_contact.edge_edge, query_edges, contact_edge_edge, contact_pass)
    elif ti.static(features.static_friction):
        for_each_candidate(
            cloth, ctx, cloth.self_contact.vertex_vertex, query_particles, contact_vertex_vertex_static, contact_pass
        )
    else:
        for_each_candidate(
            cloth, ctx, cloth.self_contact.vertex_vertex, query_particles, contact_vertex_vertex, contact_pass
        )


@ti.func
def resolve_self_contacts(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Move apart what is closer than the thickness, one Jacobi iteration."""
    if ti.static(features.self_collision and not features.penetration_free):
        update_candidates(cloth, features, ctx)
        for n in range(cloth.self_contact.particle_count[None]):
            cloth.self_contact.depth_sum[cloth.self_contact.particle[n]] = 0
            cloth.self_contact.max_depth[cloth.self_contact.particle[n]] = 0
            cloth.self_contact.correction[cloth.self_contact.particle[n]] = tm.ivec3(0)
        if ti.static(cloth.is_parallel):
            for contact_pass in ti.static((DEPTHS, CORRECTIONS)):
                visit_contacts(cloth, features, ctx, contact_pass)
        else:
            for contact_pass in range(2):  # DEPTHS, CORRECTIONS
                visit_contacts(cloth, features, ctx, contact_pass)
        unit = ctx.params[THICKNESS] / UNITS
        for i in range(cloth.packet_count[None]):
            project_position(cloth, features, ctx, i, packet(cloth, cloth.self_contact.correction, i) * unit)


# -- untangling --------------------------------------------------------------------------------------------------------


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
    """Return how many times an edge passes through a triangle, of a cloth that has `self_contact`."""
    cloth.self_contact.intersection_count[None] = 0
    for_each_intersection_candidate(cloth, 0, count_intersection, 1)
    return cloth.self_contact.intersection_count[None]
