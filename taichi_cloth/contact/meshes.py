"""How far a place is from a mesh, which way is out, and where a way first meets it: from the distances at the nodes of
a grid (`mesh/distances.py`), linear between them.

Places are along the mesh's own axes, around its middle. Eight of them go one by one: they read from all over the grid.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.maths import TINY
from ..kernels.places import LANES, in_kind, minus, single, size_of

PUSHES = 3  # the first one is enough near the surface
MARCH_STEPS = 64
MARCH_NEAR = 1e-5  # [m]


@ti.func
def half_of(distances: ti.template(), m: int) -> tm.vec3:
    """Half sides of the box of nodes [m]."""
    return in_kind(distances.nodes[m] - 1, ti.f32) * (0.5 * distances.spacing[m])


@ti.func
def distance_to(distances: ti.template(), m: int, place: tm.vec3):
    """Distance to mesh m [m], negative inside, and its gradient. Beyond the grid the distance is the least that it can
    be, and the gradient that of the grid's nearest place.
    """
    nodes, spacing, half = distances.nodes[m], distances.spacing[m], half_of(distances, m)
    inside = ti.min(ti.max(place, minus(half)), half)
    steps = (inside + half) / spacing
    cell = ti.min(in_kind(steps, ti.i32), nodes - 2)
    b = steps - in_kind(cell, ti.f32)
    a = 1.0 - b
    n = distances.first[m] + (cell.x * nodes.y + cell.y) * nodes.z + cell.z
    up, on = nodes.z, nodes.y * nodes.z  # to the next node along y and along x
    v = ti.static(distances.values)
    near_low, near_high = v[n] * a.z + v[n + 1] * b.z, v[n + up] * a.z + v[n + up + 1] * b.z
    far_low, far_high = v[n + on] * a.z + v[n + on + 1] * b.z, v[n + on + up] * a.z + v[n + on + up + 1] * b.z
    near, far = near_low * a.y + near_high * b.y, far_low * a.y + far_high * b.y
    along_z = ((v[n + 1] - v[n]) * a.y + (v[n + up + 1] - v[n + up]) * b.y) * a.x + (
        (v[n + on + 1] - v[n + on]) * a.y + (v[n + on + up + 1] - v[n + on + up]) * b.y
    ) * b.x
    slope = tm.vec3(far - near, (near_high - near_low) * a.x + (far_high - far_low) * b.x, along_z) / spacing
    distance = near * a.x + far * b.x
    beyond = (place - inside).norm_sqr()
    if beyond > 0.0:
        distance = ti.sqrt(beyond + distance * distance)
    return distance, slope


@ti.func
def push_of_one(distances: ti.template(), m: int, margin: float, place: tm.vec3) -> tm.vec3:
    """Push that takes one place to the margin [m], along the gradient; zero outside."""
    push = tm.vec3(0.0)
    if (size_of(place) - half_of(distances, m)).max() < 0.0:  # the grid goes on to beyond the margin
        left = PUSHES
        while left > 0:
            left -= 1
            distance, slope = distance_to(distances, m, place + push)
            if distance < margin:
                push += slope * ((margin - distance) / ti.max(slope.norm(), TINY))
            else:
                left = 0
    return push


@ti.func
def push_from_mesh(distances: ti.template(), m: int, margin: float, place):
    """The same for each place."""
    if ti.static(single(place)):
        return push_of_one(distances, m, margin, place)
    else:
        push = place * 0.0
        for k in range(LANES):
            one = push_of_one(distances, m, margin, tm.vec3(place[0, k], place[1, k], place[2, k]))
            for c in ti.static(range(3)):
                push[c, k] = one[c]
        return push


@ti.func
def march_one(distances: ti.template(), m: int, margin: float, start: tm.vec3, way: tm.vec3):
    """Share of a way at which it comes to the margin, and the slope there; 2 where it does not or begins inside.

    It goes on by the distance to the margin, and where it creeps along it by a part of a cell; once it is beyond, back.
    """
    time, speed, least = 0.0, ti.max(way.norm(), TINY), 0.25 * distances.spacing[m]
    distance, slope = distance_to(distances, m, start)
    gap, met = distance - margin, False
    if gap <= 0.0:
        time = 2.0
    for _ in range(MARCH_STEPS):
        if time <= 1.0 and ti.abs(gap) > MARCH_NEAR:
            met = met or gap < 0.0
            if not met:
                gap = ti.max(gap, least)
            time += gap / speed
            distance, slope = distance_to(distances, m, start + time * way)
            gap = distance - margin
    if not (met or ti.abs(gap) <= MARCH_NEAR) or slope.dot(way) >= 0.0:
        time = 2.0
    return time, slope / ti.max(slope.norm(), TINY)


@ti.func
def march(distances: ti.template(), m: int, margin: float, start, way):
    """The same for each way."""
    if ti.static(single(start)):
        return march_one(distances, m, margin, start, way)
    else:
        times, normals = ti.Vector([2.0 for _ in ti.static(range(LANES))]), start * 0.0
        for k in range(LANES):
            time, normal = march_one(
                distances,
                m,
                margin,
                tm.vec3(start[0, k], start[1, k], start[2, k]),
                tm.vec3(way[0, k], way[1, k], way[2, k]),
            )
            times[k] = time
            for c in ti.static(range(3)):
                normals[c, k] = normal[c]
        return times, normals
