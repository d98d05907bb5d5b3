"""Where a particle on its way first meets a body: by the body's shape, in the frame that moves and turns with it.

All take the scene's stages, the body's size [m] (`contact/bodies.py`), its margin [m], where the particle begins and
the straight way that it goes, both along the body's own axes. They give the share of the way at which it is at the
margin, `NEVER` where it does not get there or begins inside, and the normal there. A block's margin has sharp edges
here: it stops a particle a little before its rounded one; a mesh's is a quarter of a cell less.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.maths import TINY
from ..kernels.places import choose, dot, join, length, minus, part, size_of, spread, times
from .meshes import march

NEVER = 2.0


@ti.func
def root_of(a, b, c):
    """First time at which a·t² + 2b·t + c falls to zero, for c > 0; NEVER where it does not."""
    under = b * b - a * c
    time = (minus(b) - ti.sqrt(ti.max(under, 0.0))) / ti.max(a, TINY * TINY)
    return ti.select((c > 0.0) & (b < 0.0) & (under > 0.0), time, NEVER)


@ti.func
def meet_round(start, way, radius: float):
    """A ball around the origin."""
    return root_of(dot(way, way), dot(start, way), dot(start, start) - radius * radius)


@ti.func
def meet_ball(stages: ti.template(), size: tm.vec3, margin: float, start, way):
    time = meet_round(start, way, size.x + margin)
    at = start + times(way, time)
    return time, times(at, 1.0 / ti.max(length(at), TINY))


@ti.func
def off_axis(size: tm.vec3, place):
    """From the nearest point of a capsule's axis."""
    level = ti.min(ti.max(part(place, 1), -size.x), size.x)
    return place - join(level * 0.0, level, level * 0.0, place)


@ti.func
def meet_capsule(stages: ti.template(), size: tm.vec3, margin: float, start, way):
    """Its round side between the ends, or one of the balls there."""
    reach = size.y + margin
    flat, flat_way = start * spread(tm.vec3(1.0, 0.0, 1.0), start), way * spread(tm.vec3(1.0, 0.0, 1.0), start)
    time = meet_round(flat, flat_way, reach)
    time = ti.select(size_of(part(start + times(way, time), 1)) <= size.x, time, NEVER)
    for end in ti.static((-1.0, 1.0)):
        time = ti.min(time, meet_round(start - spread(tm.vec3(0.0, end * size.x, 0.0), start), way, reach))
    time = ti.select(length(off_axis(size, start)) > reach, time, NEVER)
    away = off_axis(size, start + times(way, time))
    return time, times(away, 1.0 / ti.max(length(away), TINY))


@ti.func
def meet_block(stages: ti.template(), size: tm.vec3, margin: float, start, way):
    """Between three pairs of faces: in when it is in between the last, out when it leaves the first."""
    time, leaves = part(start, 0) * 0.0 - 1.0, part(start, 0) * 0.0 + NEVER
    normal = start * 0.0
    for c in ti.static(range(3)):
        half = size[c] + margin
        p, d = part(start, c), part(way, c)
        slow = ti.select(d < 0.0, -1.0, 1.0) * ti.max(size_of(d), TINY)
        one, other = (-half - p) / slow, (half - p) / slow
        enters = ti.min(one, other)
        leaves = ti.min(leaves, ti.max(one, other))
        axis = spread(ti.Vector([1.0 if k == c else 0.0 for k in ti.static(range(3))]), start)
        normal = choose(enters > time, times(axis, ti.select(d < 0.0, 1.0, -1.0)), normal)
        time = ti.max(time, enters)
    return ti.select((time >= 0.0) & (time <= leaves), time, NEVER), normal


@ti.func
def meet_slope(stages: ti.template(), size: tm.vec3, margin: float, start, way):
    above, fall = part(start, 1) - margin, minus(part(way, 1))
    time = ti.select((above > 0.0) & (fall > 0.0), above / ti.max(fall, TINY), NEVER)
    return time, spread(tm.vec3(0.0, 1.0, 0.0), start)


@ti.func
def meet_mesh(stages: ti.template(), size: tm.vec3, margin: float, start, way):
    """It stops a little within the margin: what was pushed there along a gradient between nodes lies off it by less."""
    m = int(size.x)
    return march(stages.distances, m, margin - 0.25 * stages.distances.spacing[m], start, way)


MEETINGS = {
    "spheres": meet_ball,
    "capsules": meet_capsule,
    "boxes": meet_block,
    "planes": meet_slope,
    "meshes": meet_mesh,
}
