"""Half-space below a plane through the center, normal to its y axis. The ground is one. It has no size."""

import numpy as np
import taichi as ti
import taichi.math as tm
from numpy.typing import NDArray

from ...geometry.closed_surface import box_triangles
from ...geometry.topology import FAR
from ...kernels.constraint_math import TINY
from ...kernels.vec import broadcast, component, dot, neg, scale
from ...scene.collider_schema import Ground, Plane
from .shape import NO_IMPACT, Corners, Floats, Shape, axis

GROUND_SIZE = 20.0  # [m] side of the square that is exported for the ground
SQUARE = np.array([[-0.5, 0.0, -0.5], [-0.5, 0.0, 0.5], [0.5, 0.0, 0.5], [0.5, 0.0, -0.5]])  # seen from above


def signed_distance(plane: Plane | Ground, points: Floats) -> Floats:
    return points[:, 1]


def nearest_center(center: Floats, axes: Floats) -> Floats:
    """The point of the plane nearest to the origin, but for cloth near the center: a plane has no middle."""
    up = axes[:, 1]
    foot: Floats = (center @ up) * up
    return foot if np.linalg.norm(center - foot) >= FAR else center


def triangles(plane: Plane) -> Corners:
    """A thin slab under the plane."""
    slab = plane.display_size * np.array([1.0, 0.01, 1.0])
    return box_triangles(np.array([0.0, -slab[1] / 2, 0.0]), slab)


def polygons(plane: Plane | Ground) -> tuple[Floats, NDArray[np.int64]]:
    """A square of the displayed size, for the ground `GROUND_SIZE`."""
    size = GROUND_SIZE if isinstance(plane, Ground) else plane.display_size
    return SQUARE * size, np.arange(4)[None]


@ti.func
def push_out(features: ti.template(), axes, size: tm.vec3, margin: float, offset):
    up = broadcast(axis(axes, 1), offset)
    return scale(up, ti.max(margin - dot(offset, up), 0.0))


@ti.func
def time_of_impact(features: ti.template(), size: tm.vec3, margin: float, start, path):
    above, fall = component(start, 1) - margin, neg(component(path, 1))
    time = ti.select((above > 0.0) & (fall > 0.0), above / ti.max(fall, TINY), NO_IMPACT)
    return time, broadcast(tm.vec3(0.0, 1.0, 0.0), start)


PLANE = Shape(
    section="planes",
    classes=(Plane, Ground),
    size=lambda plane: (0.0, 0.0, 0.0),
    signed_distance=signed_distance,
    push_out=push_out,
    time_of_impact=time_of_impact,
    nearest_center=nearest_center,
    triangles=triangles,
    color=(0.70, 0.72, 0.70),
    polygons=polygons,
)
