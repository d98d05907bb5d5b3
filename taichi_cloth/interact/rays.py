"""Where a ray first meets triangles, a ball or a box: its distance from the origin [m], infinity for a miss.

Directions are unit vectors. A surface that the ray starts behind does not count.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

OVERLAP = 1e-9  # neighbouring triangles overlap by this share, so that rounding opens no gap between them

Floats = NDArray[np.float64]


def triangle_distances(origin: Floats, direction: Floats, a: Floats, b: Floats, c: Floats) -> Floats:
    """Distance to each of T triangles with corners a, b, c of shape (T, 3), from either side. Shape (T,).

    Möller and Trumbore, "Fast, minimum storage ray-triangle intersection" (1997), for all triangles at once.
    """
    ab, ac, offset = b - a, c - a, origin - a
    p = np.cross(direction, ac)
    q = np.cross(offset, ab)
    determinant = _dot(ab, p)
    # A triangle seen exactly edge-on has determinant 0: the divisions give inf or NaN, which fail the tests.
    with np.errstate(divide="ignore", invalid="ignore"):
        beta = _dot(offset, p) / determinant
        gamma = q @ direction / determinant
        distance = _dot(ac, q) / determinant
        inside = (np.minimum(beta, gamma) >= -OVERLAP) & (beta + gamma <= 1 + OVERLAP) & (distance > 0)
    return np.where(inside, distance, np.inf)


def ball_distance(origin: Floats, direction: Floats, center: Floats, radius: float) -> float:
    """Distance to the surface of a ball."""
    offset = origin - center
    b = float(offset @ direction)
    discriminant = b * b - float(offset @ offset) + radius * radius
    if discriminant < 0:
        return np.inf
    distance = -b - float(np.sqrt(discriminant))
    return distance if distance > 0 else np.inf


def box_distance(origin: Floats, direction: Floats, center: Floats, size: Floats) -> float:
    """Distance to the surface of a box with its sides along the axes and whole lengths `size`."""
    # Where the ray runs along a pair of faces, 0 turns into ±inf: outside that slab never, inside it always.
    with np.errstate(divide="ignore", invalid="ignore"):
        faces = np.stack([center - size / 2 - origin, center + size / 2 - origin]) / direction
    faces = np.where(np.isnan(faces), [[-np.inf], [np.inf]], faces)  # 0/0: the ray runs in a face
    enters, leaves = float(faces.min(axis=0).max()), float(faces.max(axis=0).min())
    return enters if 0 < enters <= leaves else np.inf


def _dot(a: Floats, b: Floats) -> Floats:
    products: Floats = np.einsum("ij,ij->i", a, b)
    return products
