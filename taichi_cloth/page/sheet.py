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
    axes = np.ascontiguousarray(x.reshape(-1, 3).T)  # NumPy looks through rows ten times as fast as through columns
    low = axes.min(axis=1)
    step = (axes.max(axis=1) - low) / STEPS
    inverse = np.divide(1.0, step, out=np.zeros(3), where=step > 0)
    return low, step, ((x - low) * inverse + 0.5).astype(np.uint16)  # cut off, which is cheaper than to round


def vertices(topology: Topology, colours: NDArray[np.float32]) -> tuple[Ids, NDArray[np.uint8], Ids]:
    """Particles (V,) and colours (V, 3) of what triangles (T, 3) share: corners of one particle and one colour."""
    rgb = np.rint(255 * colours).astype(np.int64)
    key = (topology.triangles.ravel().astype(np.int64) << 24) + (rgb << np.array([16, 8, 0])).sum(axis=1)
    one, corners = np.unique(key, return_inverse=True)
    tint = (one[:, None] >> np.array([16, 8, 0]) & 255).astype(np.uint8)
    return one >> 24, tint, corners.reshape(-1, 3)


def left_of(whole: Topology, torn: Topology) -> NDArray[np.bool_]:
    """Which triangles of a whole cloth (T,) are still there when it is torn."""
    left: NDArray[np.bool_] = np.isin(_keys(whole), _keys(torn))
    return left


def _keys(topology: Topology) -> Ids:
    """A number for every triangle, by its particles: the same in whatever is left of a cloth."""
    a, b, c = topology.triangles.T.astype(np.int64)
    keys: Ids = (a * topology.particle_count + b) * topology.particle_count + c
    return keys
