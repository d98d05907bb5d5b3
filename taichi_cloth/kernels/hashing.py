"""Finds what is near: points sorted into the buckets of a hash of cubes (Teschner et al. 2003, *Optimized spatial
hashing for collision detection of deformable objects*, section 4.1): count, sum up, fill.

The order within a bucket is any: who walks over buckets must not depend on it.
"""

import taichi as ti
import taichi.math as tm

from .places import in_kind

BLOCK = 256  # buckets that one thread sums up


@ti.func
def cube_of(place: tm.vec3, side: float):
    """Which cube of the given side [m] a place lies in."""
    return in_kind(ti.floor(place / side), ti.i32)


@ti.func
def bucket_of(buckets: ti.template(), cube):
    """Several cubes share a bucket: compare the cubes too. A row of cubes along x has buckets side by side."""
    mixed = cube.x + ((cube.y * 19349663) ^ (cube.z * 83492791))
    return mixed & ti.static(buckets.first.shape[0] - 2)  # their number is a power of two


@ti.func
def sort_into_buckets(
    buckets: ti.template(), cloth: ti.template(), box_of: ti.template(), count: int, side: float, on: int
):
    """Sorts `count` things by the middle of their box: `box_of(cloth, n)` gives that and half its sides.

    `on` is 1, or 0 for nothing at all.

    Afterwards those of bucket b are `members[first[b]]` up to `members[first[b + 1]]`, and their boxes are beside them.
    """
    first = ti.static(buckets.first)
    size = ti.static(buckets.first.shape[0])
    blocks = ti.static((buckets.first.shape[0] + BLOCK - 1) // BLOCK)
    for b in range(on * size):
        first[b] = 0
    for n in range(on * count):
        middle, _half = box_of(cloth, n)
        ti.atomic_add(first[bucket_of(buckets, cube_of(middle, side))], 1)
    for k in range(on * blocks):
        total = 0
        for b in range(k * BLOCK, ti.min((k + 1) * BLOCK, size)):
            total += first[b]
        buckets.sums[k] = total
    for _ in range(on):
        before = 0
        for k in range(blocks):
            total = buckets.sums[k]
            buckets.sums[k] = before
            before += total
    for k in range(on * blocks):
        end = buckets.sums[k]
        for b in range(k * BLOCK, ti.min((k + 1) * BLOCK, size)):
            end += first[b]
            first[b] = end
    for n in range(on * count):
        middle, half = box_of(cloth, n)
        k = ti.atomic_sub(first[bucket_of(buckets, cube_of(middle, side))], 1) - 1
        buckets.members[k] = n
        buckets.middle[k] = middle
        buckets.half[k] = half
