"""What every format writes of a cloth: triangles, normals, texture coordinates, and which axis is up. NumPy only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..mesh.topology import Topology

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Sheet:
    """What never moves of a cloth that is written; N particles, T triangles."""

    name: str  # the scene's
    triangles: Faces  # (T, 3)
    uv: Floats  # (N, 2) 0…1 from the left and from the bottom edge of the sheet, whatever its sides


def sheet_of(name: str, topology: Topology) -> Sheet:
    """Where every particle is on the sheet as it was cut; the sheets of a pile share one picture.

    A mesh file lies in any plane: its picture goes along the two longest sides of its box.
    """
    one = topology.one_sheet
    low, sides = one.min(axis=0), np.ptp(one, axis=0)
    across = np.sort(np.argsort(-sides, kind="stable")[:2])
    return Sheet(name, topology.triangles, ((topology.flat - low) / np.where(sides > 0, sides, 1.0))[:, across])


def vertex_normals(x: Floats, triangles: Faces) -> Floats:
    """Unit normal at every particle, (N, 3): of the triangles around it by their area. Zero where they have none."""
    a, b, c = (x[triangles[:, k]] for k in range(3))
    twice_area = np.cross(b - a, c - a)
    corners = triangles.T.ravel()
    total = np.stack(
        [np.bincount(corners, np.tile(twice_area[:, axis], 3), minlength=len(x)) for axis in range(3)], axis=1
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    normals: Floats = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    return normals


def turned_up(vectors: Floats, up: str) -> Floats:
    """Places or directions (…, 3) of this program, where y is up, with the axis `up` upwards: a turn about x."""
    if up == "y":
        return vectors
    x, y, z = np.moveaxis(vectors, -1, 0)
    turned: Floats = np.stack([x, -z, y], axis=-1)
    return turned
