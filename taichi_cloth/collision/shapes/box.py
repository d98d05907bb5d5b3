"""Box with its sides along its axes. Size: half its sides. Its margin has rounded edges."""

import numpy as np
import taichi as ti
import taichi.math as tm

from ...geometry.closed_surface import box_triangles
from ...kernels.constraint_math import TINY, push_out_of_box
from ...kernels.vec import abs_, broadcast, component, scale, select
from ...scene.collider_schema import Box
from .shape import NO_IMPACT, Corners, Floats, Shape, UsdSchema, to_local, to_world


def signed_distance(box: Box, points: Floats) -> Floats:
    beyond = np.abs(points) - np.array(box.size) / 2
    distance: Floats = np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)
    return distance


def triangles(box: Box) -> Corners:
    return box_triangles(np.zeros(3), np.array(box.size))


@ti.func
def push_out(features: ti.template(), axes, size: tm.vec3, margin: float, offset):
    local = to_local(axes, offset)
    return to_world(axes, push_out_of_box(local, local * 0.0, broadcast(size, offset), margin))


@ti.func
def time_of_impact(features: ti.template(), size: tm.vec3, margin: float, start, path):
    """The slab method. The margin's edges are sharp here, which stops a point a little before the rounded ones."""
    time, leaves = component(start, 0) * 0.0 - 1.0, component(start, 0) * 0.0 + NO_IMPACT
    normal = start * 0.0
    for c in ti.static(range(3)):
        half = size[c] + margin
        p, d = component(start, c), component(path, c)
        slow = ti.select(d < 0.0, -1.0, 1.0) * ti.max(abs_(d), TINY)
        one, other = (-half - p) / slow, (half - p) / slow
        enters = ti.min(one, other)
        leaves = ti.min(leaves, ti.max(one, other))
        unit = broadcast(ti.Vector([1.0 if k == c else 0.0 for k in ti.static(range(3))]), start)
        normal = select(enters > time, scale(unit, ti.select(d < 0.0, 1.0, -1.0)), normal)
        time = ti.max(time, enters)
    return ti.select((time >= 0.0) & (time <= leaves), time, NO_IMPACT), normal


BOX = Shape(
    section="boxes",
    classes=(Box,),
    size=lambda box: (box.size[0] / 2, box.size[1] / 2, box.size[2] / 2),
    signed_distance=signed_distance,
    push_out=push_out,
    time_of_impact=time_of_impact,
    triangles=triangles,
    usd=UsdSchema("Cube", lambda size: {"Size": 1.0}, scale=lambda size: 2 * size),
)
