"""Where a ray meets triangles: its distance from the origin [m], infinity for a miss. Directions are unit vectors."""

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


def _dot(a: Floats, b: Floats) -> Floats:
    products: Floats = np.einsum("ij,ij->i", a, b)
    return products
