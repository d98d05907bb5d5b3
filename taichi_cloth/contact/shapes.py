"""How a particle leaves a body: the shortest push to its margin, by the body's shape.

All take the scene's stages, the body's axes (3×3, its own x, y and z as columns), its size [m] (`contact/bodies.py`),
its margin [m] and where the particle is from its middle [m], and give the push [m], zero outside.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.maths import out_of_box, out_of_sphere
from ..kernels.places import dot, join, part, spread, times
from .meshes import push_from_mesh


@ti.func
def axis_of(axes, k: ti.template()) -> tm.vec3:
    return tm.vec3(axes[0, k], axes[1, k], axes[2, k])


@ti.func
def into(axes, away):
    """Along a body's own axes."""
    x, y, z = spread(axis_of(axes, 0), away), spread(axis_of(axes, 1), away), spread(axis_of(axes, 2), away)
    return join(dot(away, x), dot(away, y), dot(away, z), away)


@ti.func
def back(axes, local):
    """From a body's own axes to those of the world."""
    x, y, z = spread(axis_of(axes, 0), local), spread(axis_of(axes, 1), local), spread(axis_of(axes, 2), local)
    return times(x, part(local, 0)) + times(y, part(local, 1)) + times(z, part(local, 2))


@ti.func
def out_of_ball(stages: ti.template(), axes, size: tm.vec3, margin: float, away):
    return out_of_sphere(away, away * 0.0, size.x + margin)


@ti.func
def out_of_capsule(stages: ti.template(), axes, size: tm.vec3, margin: float, away):
    along = spread(axis_of(axes, 1), away)
    nearest = times(along, ti.min(ti.max(dot(away, along), -size.x), size.x))
    return out_of_sphere(away, nearest, size.y + margin)


@ti.func
def out_of_block(stages: ti.template(), axes, size: tm.vec3, margin: float, away):
    local = into(axes, away)
    return back(axes, out_of_box(local, local * 0.0, spread(size, away), margin))


@ti.func
def out_of_slope(stages: ti.template(), axes, size: tm.vec3, margin: float, away):
    up = spread(axis_of(axes, 1), away)
    return times(up, ti.max(margin - dot(away, up), 0.0))


@ti.func
def out_of_mesh(stages: ti.template(), axes, size: tm.vec3, margin: float, away):
    return back(axes, push_from_mesh(stages.distances, int(size.x), margin, into(axes, away)))


SHAPES = {
    "spheres": out_of_ball,
    "capsules": out_of_capsule,
    "boxes": out_of_block,
    "planes": out_of_slope,
    "meshes": out_of_mesh,
}
