"""Broad phase of self-collision: candidate pairs of particles, or of triangles with particles and edges with edges.

A spatial hash sorts items into buckets by the cubic cell their center lies in (Teschner et al. 2003, *Optimized spatial
hashing for collision detection of deformable objects*, section 4.1), in three passes: count, prefix sum, fill. The
order within a bucket is arbitrary; a result must not depend on it.

Candidate lists are neighbor lists (Verlet 1967): pairs are listed up to a skin beyond the thickness, and the lists are
rebuilt only when a particle has moved through half the skin, so one search of the spatial hash serves many substeps. A
list that overflows, for a cloth in a heap, is not used: the hash is then queried in every substep.
"""

import numpy as np
import taichi as ti
import taichi.math as tm

from ..kernels.constraint_math import closest_between_segments, closest_on_triangle
from ..kernels.layout import read
from ..kernels.step_params import THICKNESS
from ..kernels.tensor_fields import i32_array
from ..kernels.vec import abs_, cast
from ..state.contact_data import BLOCK
from ..system.errors import UsageError
from ..system.taichi_runtime import on_cpu
from .static_friction import clear_anchors


@ti.func
def cell_of(point: tm.vec3, size: float):
    """Return the cell of side `size` [m] that contains a point."""
    return cast(ti.floor(point / size), ti.i32)


@ti.func
def bucket_of(buckets: ti.template(), cell):
    """Return the bucket of a cell, which other cells may share. Cells along x have adjacent buckets."""
    mixed = cell.x + ((cell.y * 19349663) ^ (cell.z * 83492791))
    return mixed & ti.static(buckets.first.shape[0] - 2)  # the number of buckets is a power of two


@ti.func
def build_hash(
    buckets: ti.template(), cloth: ti.template(), box_of: ti.template(), count: int, size: float, enabled: int
):
    """Sort `count` items; `box_of(cloth, n)` returns the center of an item's bounding box and half its sides.

    The items of bucket b are then `members[first[b]:first[b + 1]]`. `enabled` is 1, or 0 to do nothing: a parallel loop
    must be outermost, not under an `if`.
    """
    first = ti.static(buckets.first)
    entries = ti.static(buckets.first.shape[0])
    blocks = ti.static((buckets.first.shape[0] + BLOCK - 1) // BLOCK)
    for b in range(enabled * entries):
        first[b] = 0
    for n in range(enabled * count):
        center, _half = box_of(cloth, n)
        ti.atomic_add(first[bucket_of(buckets, cell_of(center, size))], 1)
    for k in range(enabled * blocks):
        total = 0
        for b in range(k * BLOCK, ti.min((k + 1) * BLOCK, entries)):
            total += first[b]
        buckets.sums[k] = total
    for _ in range(enabled):
        before = 0
        for k in range(blocks):
            total = buckets.sums[k]
            buckets.sums[k] = before
            before += total
    for k in range(enabled * blocks):
        end = buckets.sums[k]
        for b in range(k * BLOCK, ti.min((k + 1) * BLOCK, entries)):
            end += first[b]
            first[b] = end
    for n in range(enabled * count):
        center, half = box_of(cloth, n)
        k = ti.atomic_sub(first[bucket_of(buckets, cell_of(center, size))], 1) - 1
        buckets.members[k] = n
        buckets.center[k] = center
        buckets.half_size[k] = half


DEPTHS, CORRECTIONS = 0, 1  # the two passes over all contacts (`self_collision.py`): sum depths, then corrections

SKIN, EDGE_SKIN = 0.5, 0.2  # of the thickness; of the longest edge, where triangles collide: the larger
MAX_EDGE_STRETCH = 1.5  # length of an edge over the longest at rest, up to which it is found
MAX_CELLS = 8  # along each axis that one query visits: bounds the search in a cloth that has blown up


@ti.func
def triangle_weights(cloth: ti.template(), n: int, m: int):
    """Return the weights of particle m and of the vertices of triangle n in the gap at its closest point."""
    a, b, c = cloth.self_contact.triangles[n]
    p = cloth.self_contact.particle[m]
    x = ti.static(cloth.x)
    w = closest_on_triangle(read(cloth, x, p), read(cloth, x, a), read(cloth, x, b), read(cloth, x, c))
    return tm.vec4(1.0, -w.x, -w.y, -w.z)


@ti.func
def edge_weights(cloth: ti.template(), n: int, m: int):
    """Return the weights of the ends of edges n and m in the gap between their closest points."""
    a, b = cloth.self_contact.edges[n]
    c, d = cloth.self_contact.edges[m]
    x = ti.static(cloth.x)
    s, t = closest_between_segments(read(cloth, x, a), read(cloth, x, b), read(cloth, x, c), read(cloth, x, d))
    return tm.vec4(1.0 - s, s, t - 1.0, -t)


@ti.func
def is_vertex_triangle(cloth: ti.template(), n: int, m: int) -> int:
    """Filter: particle m is not a vertex of triangle n."""
    a, b, c = cloth.self_contact.triangles[n]
    p = cloth.self_contact.particle[m]
    return int(p != a and p != b and p != c)


@ti.func
def is_edge_edge(cloth: ti.template(), n: int, m: int) -> int:
    """Filter: edges n and m share no particle, in this order only."""
    a, b = cloth.self_contact.edges[n]
    c, d = cloth.self_contact.edges[m]
    return int(n < m and a != c and a != d and b != c and b != d)


@ti.func
def particle_position(cloth: ti.template(), n: int):
    return read(cloth, cloth.x, cloth.self_contact.particle[n])


@ti.func
def particle_box(cloth: ti.template(), n: int):
    return particle_position(cloth, n), tm.vec3(0.0)


@ti.func
def edge_box(cloth: ti.template(), n: int):
    i, j = cloth.self_contact.edges[n]
    a, b = read(cloth, cloth.x, i), read(cloth, cloth.x, j)
    return 0.5 * (a + b), 0.5 * abs_(a - b)


@ti.func
def triangle_box(cloth: ti.template(), n: int):
    i, j, k = cloth.self_contact.triangles[n]
    a, b, c = read(cloth, cloth.x, i), read(cloth, cloth.x, j), read(cloth, cloth.x, k)
    low, high = ti.min(a, b, c), ti.max(a, b, c)
    return 0.5 * (low + high), 0.5 * (high - low)


# -- queries -------------------------------------------------------------------------------------------------------


@ti.func
def query(
    cloth: ti.template(),
    ctx: ti.template(),
    buckets: ti.template(),
    widest: float,
    accepts: ti.template(),
    act: ti.template(),
    n: int,
    center: tm.vec3,
    half: tm.vec3,
    contact_pass: int,
):
    """Call `act(cloth, ctx, n, m, contact_pass)` for every item m of the hash whose box overlaps this one and that
    `accepts`.

    `widest`: half the widest box in the hash [m]. `contact_pass`: `DEPTHS` or `CORRECTIONS`, passed on to `act`.
    """
    size = cloth.self_contact.cell_size[None]
    first, last = cell_of(center - half - widest, size), cell_of(center + half + widest, size)
    last = ti.min(last, first + MAX_CELLS)
    for cx in range(first.x, last.x + 1):
        for cy in range(first.y, last.y + 1):
            for cz in range(first.z, last.z + 1):
                b = bucket_of(buckets, tm.ivec3(cx, cy, cz))
                for k in range(buckets.first[b], buckets.first[b + 1]):
                    other = buckets.center[k]
                    if (abs_(other - center) - buckets.half_size[k] - half).max() <= 0.0:
                        cell = cell_of(other, size)
                        m = buckets.members[k]
                        # Another cell may share this bucket.
                        if cell.x == cx and cell.y == cy and cell.z == cz and accepts(cloth, n, m):
                            act(cloth, ctx, n, m, contact_pass)


@ti.func
def query_particles(cloth: ti.template(), ctx: ti.template(), act: ti.template(), contact_pass: int, enabled: int):
    """Call `act` for every pair of particles closer than the distance of the lists. `enabled` is 1, or 0 to do nothing.

    A particle looks at those after it in its own cell and at half of the cells around it, five rows along x, so that
    each pair is found once.
    """
    list_distance, size = cloth.self_contact.list_distance[None], cloth.self_contact.cell_size[None]
    centers = ti.static(cloth.self_contact.particle_hash.center)
    first, members = ti.static(cloth.self_contact.particle_hash.first, cloth.self_contact.particle_hash.members)
    for k in range(enabled * cloth.self_contact.particle_count[None]):  # in hash order, which is cache friendly
        position = centers[k]
        own_cell = cell_of(position, size)
        for r in range(5):
            down = ti.select(r < 2, r, r - 3)
            for along in range(ti.select(r == 0, 0, -1), 2):
                cell = own_cell + tm.ivec3(along, down, int(r >= 2))
                b = bucket_of(cloth.self_contact.particle_hash, cell)
                start = first[b]
                if r == 0 and along == 0:
                    start = k + 1
                for other in range(start, first[b + 1]):
                    gap = centers[other] - position
                    if gap.dot(gap) < list_distance * list_distance and all(cell_of(centers[other], size) == cell):
                        act(cloth, ctx, members[k], members[other], contact_pass)


@ti.func
def query_triangles(cloth: ti.template(), ctx: ti.template(), act: ti.template(), contact_pass: int, enabled: int):
    """Call `act` for every triangle and every particle near it."""
    list_distance = cloth.self_contact.list_distance[None]
    for n in range(enabled * cloth.self_contact.triangle_count[None]):
        center, half = triangle_box(cloth, n)
        query(
            cloth,
            ctx,
            cloth.self_contact.particle_hash,
            0.0,
            is_vertex_triangle,
            act,
            n,
            center,
            half + list_distance,
            contact_pass,
        )


@ti.func
def query_edges(cloth: ti.template(), ctx: ti.template(), act: ti.template(), contact_pass: int, enabled: int):
    """Call `act` for every pair of edges near each other."""
    list_distance = cloth.self_contact.list_distance[None]
    widest = 0.5 * MAX_EDGE_STRETCH * cloth.self_contact.longest_edge[None]
    for n in range(enabled * cloth.self_contact.edge_count[None]):
        center, half = edge_box(cloth, n)
        query(
            cloth,
            ctx,
            cloth.self_contact.edge_hash,
            widest,
            is_edge_edge,
            act,
            n,
            center,
            half + list_distance,
            contact_pass,
        )


# -- candidate lists -----------------------------------------------------------------------------------------------


@ti.func
def append_candidate(candidates: ti.template(), n: int, m: int):
    """Add a pair. Beyond the capacity it is only counted."""
    k = ti.atomic_add(candidates.count[None], 1)
    if k < ti.static(candidates.pairs.shape[0]):
        candidates.pairs[k] = tm.ivec2(n, m)


@ti.func
def add_vertex_vertex(cloth: ti.template(), ctx: ti.template(), n: int, m: int, contact_pass: int):
    append_candidate(cloth.self_contact.vertex_vertex, n, m)


@ti.func
def add_vertex_triangle(cloth: ti.template(), ctx: ti.template(), n: int, m: int, contact_pass: int):
    a, b, c = cloth.self_contact.triangles[n]
    p = cloth.self_contact.particle[m]
    w = triangle_weights(cloth, n, m)
    x = ti.static(cloth.x)
    foot = w.y * read(cloth, x, a) + w.z * read(cloth, x, b) + w.w * read(cloth, x, c)
    if (read(cloth, x, p) + foot).norm() < cloth.self_contact.list_distance[None]:
        append_candidate(cloth.self_contact.vertex_triangle, n, m)


@ti.func
def add_edge_edge(cloth: ti.template(), ctx: ti.template(), n: int, m: int, contact_pass: int):
    a, b = cloth.self_contact.edges[n]
    c, d = cloth.self_contact.edges[m]
    w = edge_weights(cloth, n, m)
    x = ti.static(cloth.x)
    gap = w.x * read(cloth, x, a) + w.y * read(cloth, x, b)
    gap += w.z * read(cloth, x, c) + w.w * read(cloth, x, d)
    if gap.norm() < cloth.self_contact.list_distance[None]:
        append_candidate(cloth.self_contact.edge_edge, n, m)


@ti.func
def check_expired(cloth: ti.template(), thickness: float):
    """Set `expired` if the thickness has changed, or a particle has moved through half the skin."""
    for _ in range(1):
        cloth.self_contact.expired[None] = int(cloth.self_contact.list_thickness[None] != thickness)
    limit = 0.5 * (cloth.self_contact.list_distance[None] - thickness)
    for n in range(cloth.self_contact.particle_count[None]):
        moved = particle_position(cloth, n) - cloth.self_contact.list_position[n]
        if not moved.dot(moved) <= limit * limit:
            cloth.self_contact.expired[None] = 1


@ti.func
def update_candidates(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Rebuild the candidate lists if they have expired."""
    thickness = ctx.params[THICKNESS]
    check_expired(cloth, thickness)
    enabled = cloth.self_contact.expired[None]
    list_distance = (1.0 + SKIN) * thickness
    size = list_distance
    if ti.static(features.self_triangles):
        list_distance = ti.max(list_distance, thickness + EDGE_SKIN * cloth.self_contact.longest_edge[None])
        size = 2.0 * ti.max(list_distance, cloth.self_contact.longest_edge[None])
    for _ in range(enabled):
        cloth.self_contact.list_distance[None] = list_distance
        cloth.self_contact.list_thickness[None] = thickness
        cloth.self_contact.cell_size[None] = size
        cloth.self_contact.vertex_vertex.count[None] = 0
        cloth.self_contact.vertex_triangle.count[None] = 0
        cloth.self_contact.edge_edge.count[None] = 0
    for n in range(enabled * cloth.self_contact.particle_count[None]):
        cloth.self_contact.list_position[n] = particle_position(cloth, n)
    particles = cloth.self_contact.particle_count[None]
    build_hash(cloth.self_contact.particle_hash, cloth, particle_box, particles, size, enabled)
    if ti.static(features.self_triangles):
        build_hash(cloth.self_contact.edge_hash, cloth, edge_box, cloth.self_contact.edge_count[None], size, enabled)
        query_triangles(cloth, ctx, add_vertex_triangle, 0, enabled)
        query_edges(cloth, ctx, add_edge_edge, 0, enabled)
    else:
        query_particles(cloth, ctx, add_vertex_vertex, 0, enabled)
        if ti.static(features.static_friction):
            clear_anchors(cloth, enabled * cloth.self_contact.vertex_vertex.count[None])


@ti.func
def for_each_candidate(
    cloth: ti.template(),
    ctx: ti.template(),
    candidates: ti.template(),
    query_all: ti.template(),
    act: ti.template(),
    contact_pass: int,
):
    """Call `act(cloth, ctx, n, m, contact_pass, entry)` for every candidate, or if the list has overflowed for every
    pair that `query_all` finds, without `entry`.

    `act` returns whether the pair is in contact. The pass `CORRECTIONS` skips candidates that were not in `DEPTHS`.
    """
    count = candidates.count[None]
    fits = int(count <= ti.static(candidates.pairs.shape[0]))
    for k in range(fits * count):
        if contact_pass == DEPTHS:
            candidates.touching[k] = act(cloth, ctx, candidates.pairs[k][0], candidates.pairs[k][1], contact_pass, k)
        elif candidates.touching[k]:
            act(cloth, ctx, candidates.pairs[k][0], candidates.pairs[k][1], contact_pass, k)
    query_all(cloth, ctx, act, contact_pass, 1 - fits)


# -- a probe: does the driver compile atomic sums in loops correctly? -------------------------------------------------


@ti.kernel
def count_in_loop(total: i32_array, count: int):
    for _ in range(1):
        for _k in range(count):
            ti.atomic_add(total[0], 1)


def check_atomic_sums() -> None:
    """Raise UsageError if the driver of the GPU would not find all pairs.

    Mesa's software Vulkan driver (22.3.6) leaves a loop after the second atomic sum of integers to the same address.
    """
    if on_cpu():
        return
    total = np.zeros(1, np.int32)
    count_in_loop(total, 5)
    if total[0] != 5:
        raise UsageError(
            "self-collision does not work with this Vulkan driver, which leaves loops with atomic sums too early; use"
            " --arch cpu"
        )
