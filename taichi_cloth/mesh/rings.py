"""A round sheet as rings of triangles. NumPy only."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray


def rings(radii: Iterable[float]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points (N, 3) of a level disc around the origin, and its triangles (T, 3), counter-clockwise seen from above.

    Ring k, of the k-th radius, has 6·k points, so that the triangles of rings equally far apart are nearly equilateral.
    """
    points, faces = [[0.0, 0.0, 0.0]], []
    inner = [0]
    for k, radius in enumerate(radii, 1):
        angle = np.linspace(0, 2 * np.pi, 6 * k, endpoint=False)
        outer = list(range(len(points), len(points) + 6 * k))
        points += [[radius * np.cos(a), 0.0, -radius * np.sin(a)] for a in angle]
        for sector in range(6):
            out = [outer[(sector * k + n) % len(outer)] for n in range(k + 1)]
            within = [inner[(sector * (k - 1) + n) % len(inner)] for n in range(k)]
            faces += [[within[n], out[n], out[n + 1]] for n in range(k)]
            faces += [[within[n], out[n + 1], within[n + 1]] for n in range(k - 1)]
        inner = outer
    return np.array(points), np.array(faces)
