"""Boxes around parts of a moving cloth, packed into integers: two are compared by four subtractions.

A point is one 64-bit integer: 20 bits for each coordinate and a guard bit above each. If the guard bits of b are set,
(b − a) leaves each of them set exactly where the coordinate of b is not less than that of a. A moving box has its lower
and its upper corner at the start and at the end of a period, rounded outward. (Twelve floats of both boxes would have
to be read one by one: 38 ns a comparison instead of 8.)
"""

import taichi as ti
import taichi.math as tm

BITS = 20  # of a coordinate
RANGE = (1 << BITS) - 1
STEP = 2.0**-14  # [m] of a coordinate: the range is ±32 m


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
