"""Mesh files: Wavefront OBJ, Stanford PLY, PC2 point caches (3ds Max; Blender's Mesh Cache) and glTF. NumPy only.

- OBJ is text. Numbers have nine digits, as many as float32 has: 10⁻⁹ m at 1 m from the origin.
- PLY is binary: little-endian, float32.
- PC2 has the positions of a mesh at each sample: a header of 32 bytes, then x, y and z of every particle, sample by
  sample; little-endian, float32.
- glTF binary (version 2.0 of the Khronos Group) is a JSON text and the arrays that it describes; little-endian,
  float32. The samples of a clip are morph targets of the cloth.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..collision.shapes.plane import SQUARE
from ..geometry.topology import Topology
from ..render.colors import merge_vertices, pattern_colors
from ..scene.schema import Scene
from ..system.errors import UsageError, one_line
from ..system.files import atomic_file

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Faces = NDArray[np.int32]
Json = dict[str, Any]


@dataclass(frozen=True, eq=False)
class ExportMesh:
    """The constant part of an exported cloth; N particles, T triangles."""

    name: str
    """Name of the scene."""
    triangles: Faces
    """The particles of every triangle, (T, 3)."""
    uv: Floats
    """Texture coordinates, (N, 2): 0…1 from the left and from the bottom edge, whatever the size of the cloth."""
    colors: Floats32
    """The color of every corner of every triangle as it is drawn, without light, sRGB factors 0…1, (3·T, 3)."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A mesh beside the cloth: a collider, the floor or the pole; V vertices, T triangles."""

    name: str
    """Its name in the file."""
    color: Floats
    """sRGB factors 0…1, (3,)."""
    positions: Floats
    """Position of every vertex in the coordinates of the solid [m], (V, 3)."""
    normals: Floats
    """Unit normal of every vertex, (V, 3)."""
    triangles: NDArray[np.int64]
    """The vertices of every triangle, (T, 3)."""
    vertices_now: Callable[[], tuple[Floats, Floats]] | None = None
    """Returns positions and normals as they are now, for a solid that deforms."""


def collider_name(number: int, collider: object) -> str:
    """Return the name of a collider in a file. `number`: its index among all colliders of the scene."""
    return f"{type(collider).__name__.lower()}_{number}"


def export_mesh_of(scene: Scene, topology: Topology) -> ExportMesh:
    """Return the constant part of a cloth, with texture coordinates from its flat shape. All layers share one texture.

    A mesh file may lie in any plane: its texture spans the two longest sides of its bounding box.
    """
    layer = topology.first_layer
    low, sides = layer.min(axis=0), np.ptp(layer, axis=0)
    across = np.sort(np.argsort(-sides, kind="stable")[:2])
    uv = ((topology.flat - low) / np.where(sides > 0, sides, 1.0))[:, across]
    return ExportMesh(scene.name, topology.triangles, uv, pattern_colors(topology, scene.look))


FLOOR_SIDE = 2.0  # side of the exported floor, in longest sides of the cloth


def floor_square(x: Floats, center: Floats) -> Floats:
    """Return the corners of the square that is exported for the ground, (4, 3) [m], relative to its `center` (3,) [m].

    It is under the cloth, positions `x` (N, 3) [m], and not much larger: a viewer shows all of a file at once.
    """
    low, high = x.min(axis=0), x.max(axis=0)
    offset = ((low + high) / 2 - center) * [1.0, 0.0, 1.0]
    corners: Floats = offset + FLOOR_SIDE * (high - low).max() * SQUARE
    return corners


def linear_rgb(colors: NDArray[Any]) -> Floats32:
    """Return sRGB colors, factors 0…1, as linear ones, which USD and glTF files have."""
    low = colors <= 0.04045
    return np.where(low, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4).astype(np.float32)


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

# Property names that other programs expect.
VALUES, COLORS = ("x", "y", "z", "nx", "ny", "nz", "s", "t"), ("red", "green", "blue")
VERTEX = np.dtype([("values", "<f4", len(VALUES)), ("color", "u1", len(COLORS))])
FACE = np.dtype([("corners", "u1"), ("corner", "<i4", 3)])


def write_ply(path: Path, sheet: ExportMesh, x: Floats, normals: Floats) -> None:
    """Write positions (N, 3) [m], normals (N, 3), texture coordinates and colors. Raises OSError.

    A particle has one color, that of the first of its triangles, although these may have several.
    """
    properties = "".join([f"property float {name}\n" for name in VALUES] + [f"property uchar {c}\n" for c in COLORS])
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment taichi_cloth, meters\n"
        f"element vertex {len(x)}\n{properties}"
        f"element face {len(sheet.triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    vertices = np.zeros(len(x), VERTEX)
    vertices["values"] = np.hstack([x, normals, sheet.uv])
    particles, corners = np.unique(sheet.triangles, return_index=True)
    vertices["color"][particles] = np.rint(255 * sheet.colors[corners])
    faces = np.empty(len(sheet.triangles), FACE)
    faces["corners"], faces["corner"] = 3, sheet.triangles
    with atomic_file(path) as file:
        file.write(header.encode())
        file.write(vertices.tobytes())
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


# -- glTF --------------------------------------------------------------------------------------------------------------

MAX_GLB = 2**32  # [bytes] a glTF binary file has its length as 32 bits
COMPONENT_TYPES = {"f": 5126, "u": 5125}  # float32 and uint32, by the kind of NumPy's type
VECTOR_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}  # by the number of components
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963  # targets of buffer views: vertices, and corners of triangles
CLOTH_ROUGHNESS, SOLID_ROUGHNESS = 0.9, 0.6


@contextmanager
def glb_clip(
    path: Path, sheet: ExportMesh, solids: Sequence[Solid], samples: int, rate: float
) -> Iterator[Callable[[Floats, Floats], None]]:
    """Yield a function that adds the next sample: positions (N, 3) [m], y up, and poses (K, 4, 4) of the K solids.

    `samples`: how many will follow, at `rate` per second. The file is written at the end of the block, with an
    animation if it has several samples. Raises OSError, and UsageError for a clip that is too long for the format and
    for a cloth without triangles; a partial file never remains.
    """
    if not len(sheet.triangles):
        raise UsageError(f"{path}: a glTF file needs triangles, and all of this cloth are torn")
    clip = _GlbClip(sheet, solids)
    size = samples * clip.sample_bytes + 4 * samples**2
    if size > MAX_GLB:
        raise UsageError(
            f"{path}: a glTF file has at most {MAX_GLB >> 30} GiB, and {samples} samples need {size / 2**30:.0f}; "
            "use a shorter clip, or --every K"
        )
    yield clip.add
    with atomic_file(path) as file:
        clip.write(file, rate)


class _GlbClip:
    """A glTF file: arrays are appended to its binary part one by one, and the JSON text is written at the end.

    A vertex has a single color, so a particle at the edge of a pattern is several vertices.
    """

    def __init__(self, sheet: ExportMesh, solids: Sequence[Solid]) -> None:
        self._data: list[bytes] = []
        self._size = 0  # [bytes]
        self._views: list[Json] = []
        self._accessors: list[Json] = []
        self._sheet, self._solids = sheet, solids
        self._owner, colors, corners = merge_vertices(sheet.triangles, sheet.colors)
        self.sample_bytes = 2 * 12 * len(self._owner)  # positions and normals
        uv = sheet.uv[self._owner] * [1, -1] + [0, 1]  # glTF counts from the top edge
        self._constant = {"TEXCOORD_0": self._vertices(uv), "COLOR_0": self._vertices(linear_rgb(colors / 255))}
        self._corners = self._array(corners.astype("<u4").ravel(), ELEMENT_ARRAY_BUFFER)
        self._first: dict[int, NDArray[np.float32]] = {}  # positions and normals of the first sample, by node
        self._samples: dict[int, list[Json]] = {}  # by node: 0 is the cloth, then the solids that deform
        self._poses: list[Floats] = []
        self.sample_bytes += sum(2 * 12 * len(solid.positions) for solid in solids if solid.vertices_now)

    def add(self, x: Floats, poses: Floats) -> None:
        """Add a sample."""
        normals = vertex_normals(x, self._sheet.triangles)
        self._add_shape(0, x[self._owner], normals[self._owner])
        for k, solid in enumerate(self._solids):
            if solid.vertices_now is not None:
                self._add_shape(1 + k, *solid.vertices_now())
        self._poses.append(poses)

    def _add_shape(self, node: int, positions: Floats, normals: Floats) -> None:
        """Add a sample of a node. All but the first are morph targets: differences from the first."""
        shape = np.stack([positions, normals]).astype(np.float32)
        change = shape - self._first[node] if node in self._first else self._first.setdefault(node, shape)
        sample = {"POSITION": self._vertices(change[0]), "NORMAL": self._vertices(change[1])}
        self._samples.setdefault(node, []).append(sample)

    def write(self, file: BinaryIO, rate: float) -> None:
        """Write the file. `rate`: samples per second."""
        poses = np.array(self._poses)
        first, *targets = self._samples[0]
        cloth = {"attributes": first | self._constant, "indices": self._corners, "material": 0}
        content: Json = {
            "asset": {"version": "2.0", "generator": f"taichi_cloth {__version__}"},
            "scene": 0,
            "scenes": [{"name": one_line(self._sheet.name), "nodes": list(range(1 + len(self._solids)))}],
            "nodes": [{"name": "cloth", "mesh": 0}],
            "meshes": [{"name": "cloth", "primitives": [cloth | ({"targets": targets} if targets else {})]}],
            "materials": [{"name": "cloth", "doubleSided": True, **_surface(np.ones(3), CLOTH_ROUGHNESS)}],
        }
        for k, solid in enumerate(self._solids):
            content["nodes"].append({"name": solid.name, "mesh": 1 + k, **_pose(poses[0, k])})
            content["meshes"].append({"name": solid.name, "primitives": [self._primitive(solid, 1 + k)]})
            content["materials"].append({"name": solid.name, **_surface(linear_rgb(solid.color), SOLID_ROUGHNESS)})
        if targets:
            content["animations"] = [self._animation(poses, rate)]
        content |= {"accessors": self._accessors, "bufferViews": self._views, "buffers": [{"byteLength": self._size}]}
        text = json.dumps(content, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)  # chunks begin at multiples of four bytes
        file.write(struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + self._size))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", self._size, b"BIN\0"))
        file.writelines(self._data)

    def _primitive(self, solid: Solid, material: int) -> Json:
        """Append the mesh of a solid and return its description. `material`: its number, which is that of its node."""
        if solid.vertices_now is None:
            attributes: Json = {"POSITION": self._vertices(solid.positions), "NORMAL": self._vertices(solid.normals)}
            targets: list[Json] = []
        else:
            attributes, *targets = self._samples[material]
        corners = self._array(solid.triangles.astype("<u4").ravel(), ELEMENT_ARRAY_BUFFER)
        morphs = {"targets": targets} if targets else {}
        return {"attributes": attributes, "indices": corners, "material": material, **morphs}

    def _animation(self, poses: Floats, rate: float) -> Json:
        """Append the weights of the morph targets and the poses of moving solids, and return the animation.

        Each sample has weight 1 at its time. Between two samples the weights, and with them the positions, are
        interpolated linearly.
        """
        samples = len(poses)
        tracks = [(node, "weights", np.eye(samples, samples - 1, -1).ravel()) for node in self._samples]
        for k, of_solid in enumerate(np.swapaxes(poses, 0, 1)):
            if (of_solid != of_solid[0]).any():
                tracks.append((1 + k, "translation", of_solid[:, :3, 3]))
                tracks.append((1 + k, "rotation", _quaternions(of_solid[:, :3, :3])))
        times = self._array((np.arange(samples) / rate).astype("<f4"))
        return {
            "samplers": [{"input": times, "output": self._array(values.astype("<f4"))} for _, _, values in tracks],
            "channels": [
                {"sampler": k, "target": {"node": node, "path": path}} for k, (node, path, _) in enumerate(tracks)
            ],
        }

    def _vertices(self, values: NDArray[Any]) -> int:
        return self._array(values.astype("<f4"), ARRAY_BUFFER)

    def _array(self, values: NDArray[Any], target: int | None = None) -> int:
        """Append an array, (n,) or (n, components), and return the number of its accessor."""
        view: Json = {"buffer": 0, "byteOffset": self._size, "byteLength": values.nbytes}
        self._views.append(view if target is None else view | {"target": target})
        self._data.append(values.tobytes())
        self._size += values.nbytes
        columns = values.reshape(len(values), -1)
        self._accessors.append(
            {
                "bufferView": len(self._views) - 1,
                "componentType": COMPONENT_TYPES[values.dtype.kind],
                "type": VECTOR_TYPES[columns.shape[1]],
                "count": len(values),
                "min": columns.min(axis=0).tolist(),
                "max": columns.max(axis=0).tolist(),
            }
        )
        return len(self._accessors) - 1


def _surface(color: NDArray[Any], roughness: float) -> Json:
    """Return the material of a matte surface. `color`: linear factors 0…1."""
    look = {"baseColorFactor": [*color.tolist(), 1.0], "metallicFactor": 0.0, "roughnessFactor": roughness}
    return {"pbrMetallicRoughness": look}


def _pose(pose: Floats) -> Json:
    return {"translation": pose[:3, 3].tolist(), "rotation": _quaternions(pose[None, :3, :3])[0].tolist()}


def _quaternions(rotations: Floats) -> Floats:
    """Return rotation matrices (S, 3, 3) as unit quaternions x, y, z, w, (S, 4), each near the one before it.

    A quaternion is the eigenvector with the largest eigenvalue (I. Bar-Itzhack, 2000). Its sign is free.
    """
    r = rotations
    k = np.zeros((len(r), 4, 4))
    k[:, :3, :3] = r + np.swapaxes(r, 1, 2)
    trace = np.trace(r, axis1=1, axis2=2)
    k[:, range(3), range(3)] -= trace[:, None]
    k[:, 3, 3] = trace
    k[:, 3, :3] = k[:, :3, 3] = np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]], 1)
    found: Floats = np.linalg.eigh(k)[1][:, :, -1]
    turns = np.where((found[1:] * found[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    found[1:] *= np.cumprod(turns)[:, None]
    return found
