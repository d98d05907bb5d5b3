"""Mesh files: Wavefront OBJ, Stanford PLY and PC2 point caches (3ds Max; Blender's Mesh Cache). NumPy only.

- OBJ is text. Numbers have nine digits, as many as float32 has: 10⁻⁹ m at 1 m from the origin.
- PLY is binary: little-endian, float32.
- PC2 has the positions of a mesh at each sample: a header of 32 bytes, then x, y and z of every particle, sample by
  sample; little-endian, float32.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..geometry.topology import Topology
from ..system.errors import one_line
from ..system.files import atomic_file

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class ExportMesh:
    """The constant part of an exported cloth; N particles, T triangles."""

    name: str
    """Name of the scene."""
    triangles: Faces
    """The particles of every triangle, (T, 3)."""
    uv: Floats
    """Texture coordinates, (N, 2): 0…1 from the left and from the bottom edge, whatever the size of the cloth."""


def export_mesh_of(name: str, topology: Topology) -> ExportMesh:
    """Return the constant part of a cloth, with texture coordinates from its flat shape. All layers share one texture.

    A mesh file may lie in any plane: its texture spans the two longest sides of its bounding box.
    """
    layer = topology.first_layer
    low, sides = layer.min(axis=0), np.ptp(layer, axis=0)
    across = np.sort(np.argsort(-sides, kind="stable")[:2])
    return ExportMesh(name, topology.triangles, ((topology.flat - low) / np.where(sides > 0, sides, 1.0))[:, across])


def vertex_normals(x: Floats, triangles: Faces) -> Floats:
    """Return the unit normal of every particle, (N, 3): the mean of its triangles by area, zero without any area."""
    a, b, c = (x[triangles[:, k]] for k in range(3))
    twice_area = np.cross(b - a, c - a)
    corners = triangles.T.ravel()
    total = np.stack(
        [np.bincount(corners, np.tile(twice_area[:, axis], 3), minlength=len(x)) for axis in range(3)], axis=1
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    normals: Floats = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    return normals


def rotate_to_up(vectors: Floats, up: str) -> Floats:
    """Return positions or directions (…, 3), which have y up, rotated about x so that the axis `up` is up."""
    if up == "y":
        return vectors
    x, y, z = np.moveaxis(vectors, -1, 0)
    rotated: Floats = np.stack([x, -z, y], axis=-1)
    return rotated


# -- OBJ ---------------------------------------------------------------------------------------------------------------


def write_obj(path: Path, sheet: ExportMesh, x: Floats, normals: Floats | None = None) -> None:
    """Write positions (N, 3) [m], texture coordinates, and normals (N, 3) unless None. Raises OSError.

    Particles keep their order, which is also that of a point cache.
    """
    corner = "{0}/{0}" if normals is None else "{0}/{0}/{0}"
    face = "f " + " ".join(corner.replace("0", str(k)) for k in range(3)) + "\n"
    with atomic_file(path) as file:
        file.write(f"# taichi_cloth, meters\no {one_line(sheet.name)}\n".encode())
        file.write(_lines("v", x) + _lines("vt", sheet.uv) + (b"s 1\n" if normals is None else _lines("vn", normals)))
        file.write("".join(face.format(*corners) for corners in (sheet.triangles + 1).tolist()).encode())


def _lines(keyword: str, rows: NDArray[np.float64]) -> bytes:
    line = f"{keyword}{' %.9g' * rows.shape[1]}\n"
    return (line * len(rows) % tuple(rows.ravel().tolist())).encode()


# -- PLY ---------------------------------------------------------------------------------------------------------------

VERTEX = ("x", "y", "z", "nx", "ny", "nz", "s", "t")  # property names that other programs expect
FACE = np.dtype([("corners", "u1"), ("corner", "<i4", 3)])


def write_ply(path: Path, sheet: ExportMesh, x: Floats, normals: Floats) -> None:
    """Write positions (N, 3) [m], normals (N, 3) and texture coordinates. Raises OSError."""
    properties = "".join(f"property float {name}\n" for name in VERTEX)
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment taichi_cloth, meters\n"
        f"element vertex {len(x)}\n{properties}"
        f"element face {len(sheet.triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(sheet.triangles), FACE)
    faces["corners"], faces["corner"] = 3, sheet.triangles
    with atomic_file(path) as file:
        file.write(header.encode())
        file.write(np.hstack([x, normals, sheet.uv]).astype("<f4").tobytes())
        file.write(faces.tobytes())


# -- PC2 ---------------------------------------------------------------------------------------------------------------

SIGNATURE, VERSION = b"POINTCACHE2\0", 1
START, RATE = 0.0, 1.0  # [frames] time of the first sample, and between two samples
HEADER = "<12siiffi"  # signature, version, points, start, rate, samples


@contextmanager
def pc2_clip(path: Path, particles: int, samples: int) -> Iterator[Callable[[Floats], None]]:
    """Yield a function that writes the next sample, positions (N, 3) [m]; it must be called `samples` times.

    The file appears at the end of the block. Raises OSError, and ValueError for another number of samples; a partial
    file never remains.
    """
    size = struct.calcsize(HEADER) + 12 * particles * samples
    with atomic_file(path) as file:
        file.write(struct.pack(HEADER, SIGNATURE, VERSION, particles, START, RATE, samples))

        def add(x: Floats) -> None:
            file.write(x.astype("<f4").tobytes())

        yield add
        if file.tell() != size:
            raise ValueError(f"{path}: wrote {file.tell()} bytes, expected {size}")
