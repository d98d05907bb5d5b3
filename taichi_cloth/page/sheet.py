"""The cloth as arrays that a page reads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..mesh.topology import Topology

STEPS = 2**16 - 1  # from one side of a box to the other

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]


def quantised(x: Floats) -> tuple[Floats, Floats, NDArray[np.uint16]]:
    """Lowest corner of the box (3,) [m], its step along each axis (3,) [m], and places (…, 3) [m] in steps."""
    points = x.reshape(-1, 3)
    low = points.min(axis=0)
    step = np.ptp(points, axis=0) / STEPS
    return low, step, np.rint((x - low) / np.where(step > 0, step, 1.0)).astype(np.uint16)


def vertices(topology: Topology, colours: NDArray[np.float32]) -> tuple[Ids, NDArray[np.uint8], Ids]:
    """Particles (V,) and colours (V, 3) of what triangles (T, 3) share: corners of one particle and one colour."""
    rgb = np.rint(255 * colours).astype(np.int64)
    key = (topology.triangles.ravel().astype(np.int64) << 24) + (rgb << np.array([16, 8, 0])).sum(axis=1)
    one, corners = np.unique(key, return_inverse=True)
    tint = (one[:, None] >> np.array([16, 8, 0]) & 255).astype(np.uint8)
    return one >> 24, tint, corners.reshape(-1, 3)
