"""Colliders as triangles: each shape once around its own middle, then posed where the body is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..contact.bodies import Body, is_still
from ..mesh.solid import surface_of
from ..mesh.surface import smooth_normals
from ..scene.model import Box, Capsule, Mesh, Plane, Scene
from . import solids

Floats = NDArray[np.float32]
Soup = tuple[Floats, Floats, Floats]  # positions, normals and colours of its corners, each (3·T, 3)

BLOCK, BAR, SLOPE, SOLID = (0.66, 0.52, 0.38), (0.47, 0.40, 0.34), (0.70, 0.72, 0.70), (0.80, 0.77, 0.71)
BALL, POLE = (0.13, 0.35, 0.50), (0.36, 0.24, 0.15)


def split(bodies: list[Body]) -> tuple[list[Body], list[int]]:
    """Those that never move, and the numbers of those that do. Spheres and the ground are drawn by other means."""
    drawn = [k for k, body in enumerate(bodies) if isinstance(body.collider, (Capsule, Box, Plane, Mesh))]
    still = [bodies[k] for k in drawn if is_still(bodies[k].collider)]
    return still, [k for k in drawn if not is_still(bodies[k].collider)]


def soup(body: Body) -> Soup:
    """Around its own middle, along its own axes."""
    match body.collider:
        case Capsule():
            return coloured(*solids.capsule(*body.size[:2]), BAR)
        case Plane():
            slab = body.collider.drawn * np.array([1.0, 0.01, 1.0])
            return coloured(*solids.box(np.array([0.0, -slab[1] / 2, 0.0]), slab), SLOPE)
        case Mesh():
            surface = surface_of(body.collider)
            return coloured(surface.corners.reshape(-1, 3), smooth_normals(surface).reshape(-1, 3), SOLID)
        case _:
            return coloured(*solids.box(np.zeros(3), 2 * body.size), BLOCK)


def pole(scene: Scene, start: NDArray[np.float64]) -> Soup:
    """Along the top edge of a sheet whose particles `start` there, (N, 3) [m], and a little beyond."""
    left, right = start[[0, scene.cloth.columns - 1]]
    overhang, radius = 0.06 * (right - left), 0.012 * scene.cloth.width
    return coloured(*solids.cylinder(left - overhang, right + overhang, radius), POLE)


def posed(body: Body, local: Soup) -> Soup:
    """Where the body is."""
    positions, normals, colours = local
    turn = body.axes.T.astype(np.float32)
    return (positions @ turn + body.center).astype(np.float32), normals @ turn, colours


def coloured(positions: NDArray[np.float64], normals: NDArray[np.float64], colour: tuple[float, float, float]) -> Soup:
    """One colour on all corners."""
    return (
        positions.astype(np.float32),
        normals.astype(np.float32),
        np.tile(np.array(colour, np.float32), (len(positions), 1)),
    )
