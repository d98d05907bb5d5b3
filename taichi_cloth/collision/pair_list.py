"""Broad phase of penetration-free contact: the list of all pairs that may touch.

A pair is listed if its parts, with their particles anywhere in their moving balls (`moving_balls.py`), may come within
the thickness until the end of the period. When particles get new balls, only the leaves of the bounding tree with their
triangles are searched again.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.constraint_math import TINY, closest_between_segments, closest_on_triangle
from .moving_balls import PERIOD, mark, renew_balls, shorten_reach
from .pair_geometry import EDGE_EDGE, VERTEX_TRIANGLE, are_apart, box_around, extremes, pack_box, refit_inner_nodes

MAX_REDUCTIONS = 6  # of the reach of balls in a substep


@ti.func
def sum_of_paths(data: ti.template(), corners: tm.ivec4) -> int:
    return data.path[corners[0]] + data.path[corners[1]] + data.path[corners[2]] + data.path[corners[3]]


@ti.func
def set_limits(data: ti.template(), limits: ti.template(), k: int, paths: int, margin: int):
    """Note that a pair need not be looked at before its corners have moved by `margin` [µm] in all; −1: always.

    Two corners of different parts may approach each other, so none needs to have moved by more than half of it.
    """
    limits.paths[k], limits.longest_path[k] = paths + margin, data.longest_path[None] + (margin >> 1)


@ti.func
def box_of(data: ti.template(), particles, reach: float):
    """Return the moving box around the balls of some particles, and `reach` [m] around them."""
    low, high, end_low, end_high = tm.vec3(tm.inf), tm.vec3(-tm.inf), tm.vec3(tm.inf), tm.vec3(-tm.inf)
    for c in ti.static(range(particles.n)):
        i = particles[c]
        center, radius = data.center[i], data.radius[i] + reach
        end = center + data.travel[i] * PERIOD
        low, high = ti.min(low, center - radius), ti.max(high, center + radius)
        end_low, end_high = ti.min(end_low, end - radius), ti.max(end_high, end + radius)
    return pack_box(low, high, end_low, end_high)


@ti.func
def refit_leaf(data: ti.template(), leaf: int, reach: float):
    """Set the boxes of a leaf and its elements. A leaf has one or two triangles."""
    tree = ti.static(data.tree)
    for k in range(tree.first_triangle[leaf], tree.first_triangle[leaf + 1]):
        tree.triangle_boxes[k] = box_of(data, tree.triangles[k], reach)
    first, last = tree.first_triangle[leaf], tree.first_triangle[leaf + 1] - 1
    tree.node_boxes[tree.node[leaf]] = box_around(tree.triangle_boxes[first], tree.triangle_boxes[last])
    for k in range(tree.first_edge[leaf], tree.first_edge[leaf + 1]):
        tree.edge_boxes[k] = box_of(data, tree.edges[k], reach)
    for k in range(tree.first_particle[leaf], tree.first_particle[leaf + 1]):
        tree.particle_boxes[k] = box_of(data, ti.Vector([tree.particles[k]]), reach)


@ti.func
def refit_tree(cloth: ti.template(), enabled: int, reach: float):
    """Set the boxes of the marked leaves and of all inner nodes. `enabled` is 1, or 0 to do nothing."""
    data, tree = ti.static(cloth.pair_data, cloth.pair_data.tree)
    for k in range(enabled * tree.queue_count[None]):
        refit_leaf(data, tree.queue[k], reach)
    refit_inner_nodes(tree, ti.static(cloth.is_parallel), enabled)


@ti.func
def update_pairs(cloth: ti.template(), thickness: float, slack: float):
    """Renew balls, and list the pairs of their leaves anew."""
    renew_balls(cloth, thickness, slack)
    if ti.static(cloth.is_parallel):
        for attempt in ti.static(range(2)):
            if ti.static(attempt > 0):
                shorten_reach(cloth, thickness)
            list_marked_leaves(cloth, thickness)
    else:
        for attempt in range(MAX_REDUCTIONS):
            if attempt > 0:
                shorten_reach(cloth, thickness)
            list_marked_leaves(cloth, thickness)


@ti.func
def list_marked_leaves(cloth: ti.template(), thickness: float):
    """List the pairs of all marked leaves anew."""
    data, tree, pairs = ti.static(cloth.pair_data, cloth.pair_data.tree, cloth.pair_data.pairs)
    if ti.static(cloth.is_parallel):  # a list is compacted in order, so all of it is remade
        for leaf in range(int(tree.queue_count[None] > 0) * tree.leaf_count[None]):
            mark(tree, leaf)
    enabled = int(tree.queue_count[None] > 0)
    refit_tree(cloth, enabled, 0.5 * thickness)
    if ti.static(cloth.is_parallel):
        for _ in range(enabled):
            pairs.length[None] = 0
    else:
        remove_pairs_of_marked_leaves(data, enabled)
    if ti.static(cloth.is_parallel):
        for _ in range(enabled):
            pairs.candidate_count[None] = 0
        for k in range(enabled * tree.queue_count[None]):
            find_candidates(cloth, tree.queue[k])
        for k in range(enabled * pairs.candidate_count[None]):
            add_candidate(data, thickness, k)
    else:
        for k in range(enabled * tree.queue_count[None]):
            pairs.candidate_count[None] = 0
            find_candidates(cloth, tree.queue[k])
            for m in range(pairs.candidate_count[None]):
                add_candidate(data, thickness, m)
    for k in range(enabled * tree.queue_count[None]):
        tree.marked[tree.queue[k]] = 0
    for _ in range(enabled):
        tree.queue_count[None] = 0
        pairs.overflowed[None] = int(pairs.length[None] > ti.static(pairs.kind.shape[0]))
        pairs.length[None] = ti.min(pairs.length[None], ti.static(pairs.kind.shape[0]))


@ti.func
def remove_pairs_of_marked_leaves(data: ti.template(), enabled: int):
    """Remove pairs with a marked leaf. The last pair takes the place of each: the order of the list has no meaning."""
    tree, pairs = ti.static(data.tree, data.pairs)
    k, length = 0, enabled * pairs.length[None]
    if tree.queue_count[None] == tree.leaf_count[None]:
        length = 0
    while k < length:
        if tree.marked[pairs.leaves[k][0]] + tree.marked[pairs.leaves[k][1]] == 0:
            k += 1
        else:
            length -= 1
            pairs.corners[k], pairs.kind[k] = pairs.corners[length], pairs.kind[length]
            pairs.leaves[k], pairs.normal[k] = pairs.leaves[length], pairs.normal[length]
            for limits in ti.static((pairs.near, pairs.close)):
                limits.paths[k], limits.longest_path[k] = limits.paths[length], limits.longest_path[length]
    if enabled:
        pairs.length[None] = length


@ti.func
def find_candidates(cloth: ti.template(), a: int):
    """Add all pairs of a marked leaf with others whose boxes meet, those with a marked leaf once."""
    tree = ti.static(cloth.pair_data.tree)
    own = tree.node[a]
    box = tree.node_boxes[own]
    node, end = 0, tree.skip[0]
    if tree.queue_count[None] == tree.leaf_count[None]:  # all leaves are marked: those before are done
        node = own
    particles, particles_end = tree.first_particle[a], tree.first_particle[a + 1]
    triangles, triangles_end = tree.first_triangle[a], tree.first_triangle[a + 1]
    edges, edges_end = tree.first_edge[a], tree.first_edge[a + 1]
    while node < end:
        if are_apart(box, tree.node_boxes[node]):
            node = tree.skip[node]
        else:
            b = tree.leaf[node]
            if b >= 0 and (b >= a or tree.marked[b] == 0):
                triangles_b, triangles_b_end = tree.first_triangle[b], tree.first_triangle[b + 1]
                for k in range(particles, particles_end):
                    own_box = tree.particle_boxes[k]
                    for m in range(triangles_b, triangles_b_end):
                        if not are_apart(own_box, tree.triangle_boxes[m]):
                            add_to_candidates(cloth, k, m, a, b)
                if b != a:
                    for k in range(tree.first_particle[b], tree.first_particle[b + 1]):
                        own_box = tree.particle_boxes[k]
                        for m in range(triangles, triangles_end):
                            if not are_apart(own_box, tree.triangle_boxes[m]):
                                add_to_candidates(cloth, k, m, b, a)
                edges_b, edges_b_end = tree.first_edge[b], tree.first_edge[b + 1]
                for k in range(edges, edges_end):
                    own_box = tree.edge_boxes[k]
                    for m in range(ti.select(a == b, k + 1, edges_b), edges_b_end):
                        if not are_apart(own_box, tree.edge_boxes[m]):
                            add_to_candidates(cloth, -1 - k, m, a, b)
            node += 1


@ti.func
def add_to_candidates(cloth: ti.template(), first: int, second: int, a: int, b: int):
    """Add a particle and a triangle, or two edges: −1 − `first` and `second`."""
    pairs = ti.static(cloth.pair_data.pairs)
    k = 0
    if ti.static(cloth.is_parallel):
        k = ti.atomic_add(pairs.candidate_count[None], 1)
    else:
        k = pairs.candidate_count[None]
        pairs.candidate_count[None] = k + 1
    if k < ti.static(pairs.candidates.shape[0]):
        pairs.candidates[k] = tm.ivec4(first, second, a, b)


@ti.func
def add_candidate(data: ti.template(), thickness: float, k: int):
    """List a candidate if its parts come near enough. If there was no room for it, the list is not complete."""
    tree, pairs = ti.static(data.tree, data.pairs)
    if k >= ti.static(pairs.candidates.shape[0]):
        pairs.length[None] = ti.static(pairs.kind.shape[0]) + 1
    else:
        candidate = pairs.candidates[k]
        m = candidate[1]
        corners, kind = tm.ivec4(0), EDGE_EDGE
        if candidate[0] < 0:
            e, f = tree.edges[-1 - candidate[0]], tree.edges[m]
            corners = tm.ivec4(e[0], e[1], f[0], f[1])
        else:
            t = tree.triangles[m]
            corners, kind = tm.ivec4(tree.particles[candidate[0]], t[0], t[1], t[2]), VERTEX_TRIANGLE
        add_pair(data, thickness, corners, kind, candidate[2], candidate[3])


@ti.func
def gap_in_period(data: ti.template(), kind: int, corners: tm.ivec4) -> float:
    """Return a lower bound of the distance between the parts of a pair in this period [m], with their particles at the
    centers of their balls.

    It is the gap along the direction between the nearest points in the middle of the period: along a fixed direction,
    a gap between corners that move evenly is least at the start or at the end.
    """
    base = data.center[corners[0]] + data.travel[corners[0]] * (0.5 * PERIOD)
    relative = [data.travel[corners[c]] - data.travel[corners[0]] for c in ti.static(range(1, 4))]
    p = [data.center[corners[c]] + data.travel[corners[c]] * (0.5 * PERIOD) - base for c in ti.static(range(1, 4))]
    w = tm.vec4(0.0)  # any direction gives a lower bound: those of nearly parallel edges need not be exact
    if kind == EDGE_EDGE:
        s, t = closest_between_segments(tm.vec3(0.0), p[0], p[1], p[2])
        w = tm.vec4(1.0 - s, s, t - 1.0, -t)
    else:
        v = closest_on_triangle(tm.vec3(0.0), p[0], p[1], p[2])
        w = tm.vec4(1.0, -v.x, -v.y, -v.z)
    n = w[1] * p[0] + w[2] * p[1] + w[3] * p[2]
    n /= ti.max(n.norm(), TINY)
    middle, change = tm.vec4(0.0), tm.vec4(0.0)
    for c in ti.static(range(1, 4)):
        middle[c], change[c] = n.dot(p[c - 1]), n.dot(relative[c - 1]) * (0.5 * PERIOD)
    lowest_start, highest_start = extremes(kind, middle - change)
    lowest_end, highest_end = extremes(kind, middle + change)
    return ti.min(lowest_start - highest_start, lowest_end - highest_end)


@ti.func
def add_pair(data: ti.template(), thickness: float, corners: tm.ivec4, kind: int, a: int, b: int):
    """List a pair if its parts share no particle and may come within the thickness in this period."""
    pairs = ti.static(data.pairs)
    shares = (
        corners[0] == corners[2] or corners[0] == corners[3] or corners[1] == corners[2] or corners[1] == corners[3]
    )
    if kind == VERTEX_TRIANGLE:
        shares = corners[0] == corners[1] or corners[0] == corners[2] or corners[0] == corners[3]
    if not shares:
        r_a, r_1 = data.radius[corners[0]], data.radius[corners[1]]
        r_b = ti.max(data.radius[corners[2]], data.radius[corners[3]])
        if kind == EDGE_EDGE:
            r_a = ti.max(r_a, r_1)
        else:
            r_b = ti.max(r_b, r_1)
        if gap_in_period(data, kind, corners) <= thickness + r_a + r_b:
            k = ti.atomic_add(pairs.length[None], 1)
            if k < ti.static(pairs.kind.shape[0]):
                pairs.corners[k], pairs.kind[k], pairs.leaves[k] = corners, kind, tm.ivec2(a, b)
                pairs.normal[k] = tm.vec3(0.0)
                for limits in ti.static((pairs.near, pairs.close)):
                    set_limits(data, limits, k, sum_of_paths(data, corners), -1)
