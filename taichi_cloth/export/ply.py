"""PLY files (Stanford), binary, little-endian, float32. NumPy only."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..files import whole_file
from .sheet import Floats, Sheet

VERTEX = ("x", "y", "z", "nx", "ny", "nz", "s", "t")  # the names that readers look for
FACE = np.dtype([("corners", "u1"), ("corner", "<i4", 3)])


def write_ply(path: Path, sheet: Sheet, x: Floats, normals: Floats) -> None:
    """Places (N, 3) [m], normals (N, 3) and texture coordinates. Raises OSError."""
    properties = "".join(f"property float {name}\n" for name in VERTEX)
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment taichi_cloth, metres\n"
        f"element vertex {len(x)}\n{properties}"
        f"element face {len(sheet.triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(sheet.triangles), FACE)
    faces["corners"], faces["corner"] = 3, sheet.triangles
    with whole_file(path) as file:
        file.write(header.encode())
        file.write(np.hstack([x, normals, sheet.uv]).astype("<f4").tobytes())
        file.write(faces.tobytes())
