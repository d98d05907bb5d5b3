"""What a collider shape must provide, and its local frame. Each shape has a file of its own in this folder."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import taichi as ti
import taichi.math as tm
from numpy.typing import NDArray

from ...kernels.vec import broadcast, component, dot, from_components, scale

Floats = NDArray[np.float64]
Corners = tuple[Floats, Floats]  # of triangles, three rows each: positions [m] and normals, both (3·T, 3)
Function = Callable[..., object]  # a ti.func
Color = tuple[float, float, float]

NO_IMPACT = 2.0  # time of impact of a path that does not reach the collider


class UsdSchema(NamedTuple):
    """A UsdGeom class that describes a shape."""

    name: str
    attributes: Callable[[Floats], dict[str, object]]
    """Return its attributes by name, from `Shape.size`."""
    scale: Callable[[Floats], Floats] = lambda size: np.ones(3)
    """Return the scale along the collider's axes, from `Shape.size`."""


class Shape(NamedTuple):
    """One collider shape: its scene section, its collision queries, and how it is drawn and exported.

    The collider is centered at the origin with its own axes along x, y and z ("local"). The kernel functions take
    `features`, `size` and `margin` [m]; positions are a vec3 or eight of them (`kernels/vec.py`).
    """

    section: str
    """Section of `Scene` that holds colliders of this shape."""
    classes: tuple[type, ...]
    """Their scene classes."""
    size: Callable[[object], tuple[float, float, float]]
    """Return up to three lengths [m] that kernels need, from the scene class."""
    signed_distance: Callable[[object, Floats], Floats]
    """Return the signed distance [m] of local points (N, 3) to the surface as drawn, (N,); negative inside."""
    push_out: Function
    """ti.func(features, axes, size, margin, offset): the shortest displacement of a point at `offset` from the center,
    in world axes, that takes it to the margin [m]; zero outside."""
    time_of_impact: Function
    """ti.func(features, size, margin, start, path): the fraction of a straight local path at which a point reaches the
    margin, and the normal there. `NO_IMPACT` if it does not, or starts inside."""
    closest_on_triangle: Function | None = None
    """ti.func(size, a, b, c): weights of the corners of a local triangle at its point closest to the core of the
    collider, and the vector from the core to it. None for a shape that collides with particles only."""
    core: Function | None = None
    """ti.func(size): half the length of that core along y, and the radius around it [m]."""
    nearest_center: Callable[[Floats, Floats], Floats] = lambda center, axes: center
    """Return a center that means the same for a shape at rest, and is nearest to the cloth's origin, from the center
    relative to that origin [m], (3,), and the axes, (3, 3): float32 rounds coarsely far from it."""
    triangle_distance: Callable[[object, Floats], Floats] | None = None
    """Return the distance [m] of local triangles, corners (T, 3, 3), to the surface as drawn, (T,); negative where the
    triangle is inside. None if `closest_on_triangle` is."""
    triangles: Callable[[object], Corners] | None = None
    """Return the local triangles that are drawn for a scene class; None for a shape that is drawn by other means."""
    color: Color = (0.66, 0.52, 0.38)
    usd: UsdSchema | None = None
    """How USD describes the shape exactly; None for a shape that is exported as `polygons`."""
    polygons: Callable[[object], tuple[Floats, NDArray[np.int64]]] | None = None
    """Return local points (P, 3) [m] and polygons (F, vertices) of the exported mesh."""


@ti.func
def axis(axes, k: ti.template()) -> tm.vec3:
    """Return axis k of a collider, a column of `axes`."""
    return tm.vec3(axes[0, k], axes[1, k], axes[2, k])


@ti.func
def to_local(axes, world):
    """Return a vector's components along the collider's axes."""
    x, y, z = broadcast(axis(axes, 0), world), broadcast(axis(axes, 1), world), broadcast(axis(axes, 2), world)
    return from_components(dot(world, x), dot(world, y), dot(world, z), world)


@ti.func
def to_world(axes, local):
    """Return the vector with these components along the collider's axes."""
    x, y, z = broadcast(axis(axes, 0), local), broadcast(axis(axes, 1), local), broadcast(axis(axes, 2), local)
    return scale(x, component(local, 0)) + scale(y, component(local, 1)) + scale(z, component(local, 2))
