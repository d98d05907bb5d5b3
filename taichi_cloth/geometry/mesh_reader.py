"""Reader of meshes: vertices and faces of Wavefront OBJ files, and clips of deforming meshes. NumPy only.

A line `v x y z` is a vertex, and a line `f a b c …` a face. Vertices are counted from 1; −1 is the last vertex before
the line. A line `vt u v` is a texture coordinate, and faces refer to it after the first slash of a corner. Lines `g`,
`o` and `usemtl` name the faces that follow. Everything else (normals, smoothing, materials) is ignored.

A clip has the points of a mesh over time, from PC2 files, OBJ sequences or USD files. Positions between two samples are
interpolated linearly. The readers check everything that a simulation relies on: the number of points, finite numbers,
and at least one sample.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scene.collider_schema import Mesh
from ..scene.presets import mesh_path
from ..system.errors import one_line, short_repr, shown_path
from ..system.files import Version, file_version

MAX_BYTES = 64_000_000
MAX_POINTS, MAX_TRIANGLES = 500_000, 1_000_000
FARTHEST = 1e6  # largest absolute coordinate: squared lengths stay finite
COUNTS = {2: "two", 3: "three"}

Points = NDArray[np.float64]
Faces = NDArray[np.int32]


class ObjError(ValueError):
    """An OBJ file that cannot be used. The message is one line: `FILE: line N: REASON`."""

    def __init__(self, path: Path, line: int, reason: str) -> None:
        """`line` is 0 if the error concerns the whole file."""
        self.path, self.line, self.reason = path, line, reason
        super().__init__(one_line(": ".join([str(shown_path(path)), *([f"line {line}"] if line else []), reason])))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.path, self.line, self.reason)


@dataclass(frozen=True, eq=False)
class Obj:
    """The contents of an OBJ file."""

    path: Path
    vertices: Points
    """Vertex positions, in the unit of the file, (N, 3)."""
    faces: list[tuple[int, ...]]
    """Vertex indices of every face."""
    lines: list[int]
    """Line number of every face."""
    marks: list[tuple[int, str, tuple[str, ...]]]
    """Lines `g`, `o` and `usemtl`: the first face that follows, the kind of line, and its names."""
    texture: Points
    """Texture coordinates `vt`, (M, 2)."""
    texture_faces: list[tuple[int, ...]]
    """Indices of the texture coordinates of every face's corners; empty if a corner has none."""

    def error(self, face: int, reason: str) -> ObjError:
        """Return an error for one of the faces, with its line."""
        return ObjError(self.path, self.lines[face], reason)


def read_obj(path: Path) -> tuple[Points, Faces]:
    """Return vertex positions, (N, 3), and triangles, (T, 3); faces of more corners are split into fans.

    Raises ObjError.
    """
    obj = parse_obj(path)
    fans = [(first, b, c) for first, *others in obj.faces for b, c in pairwise(others)]
    return obj.vertices, np.array(fans, np.int32)


def parse_obj(path: Path, *, texture: bool = False) -> Obj:
    """Read an OBJ file, with its texture coordinates if `texture`. Raises ObjError."""
    points: list[tuple[float, ...]] = []
    coordinates: list[tuple[float, ...]] = []
    obj = Obj(path, np.zeros((0, 3)), [], [], [], np.zeros((0, 2)), [])
    triangles = 0
    for number, line in enumerate(_text(path).splitlines(), 1):
        kind, *words = line.partition("#")[0].split() or [""]
        try:
            if kind == "v":
                points.append(_numbers(words, 3, "a vertex"))  # a weight or a color may follow
            elif kind == "f":
                obj.faces.append(_corners(words, len(points)))
                obj.lines.append(number)
                triangles += len(words) - 2
                if texture:
                    obj.texture_faces.append(_texture_corners(words, len(coordinates)))
            elif kind == "vt" and texture:
                coordinates.append(_numbers(words, 2, "a texture coordinate"))
            elif kind in ("g", "o", "usemtl"):
                obj.marks.append((len(obj.faces), kind, tuple(words)))
        except ValueError as error:
            raise ObjError(path, number, str(error)) from None
        if max(len(points), len(coordinates)) > MAX_POINTS or triangles > MAX_TRIANGLES:
            raise ObjError(path, number, f"more than {MAX_POINTS} vertices or {MAX_TRIANGLES} triangles")
    if not obj.faces:
        raise ObjError(path, 0, "has no faces (lines that begin with `f`)")
    for name, defined, faces in (("vertex", points, obj.faces), ("texture coordinate", coordinates, obj.texture_faces)):
        for k, face in enumerate(faces):  # a face may precede its vertices
            if max(face, default=-1) >= len(defined):
                raise obj.error(k, f"{name} {max(face) + 1} does not exist: the file has {len(defined)}")
    return replace(obj, vertices=np.array(points), texture=np.array(coordinates).reshape(-1, 2))


def _text(path: Path) -> str:
    """Return the content of a file as text. Raises ObjError."""
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte
        raise ObjError(path, 0, f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(content) > MAX_BYTES:
        raise ObjError(path, 0, f"is larger than {MAX_BYTES} bytes")
    return content.decode("utf-8", "replace")


def _numbers(words: list[str], count: int, what: str) -> tuple[float, ...]:
    """Return the first `count` numbers of a line. Raises ValueError."""
    if len(words) < count:
        raise ValueError(f"{what} needs {COUNTS[count]} numbers, not {len(words)}")
    return tuple(_number(word) for word in words[:count])


def _number(word: str) -> float:
    try:
        number = float(word)
    except ValueError:
        raise ValueError(f"{short_repr(word)} is not a number") from None
    if not isfinite(number):
        raise ValueError(f"{short_repr(word)} is not a finite number")
    if abs(number) > FARTHEST:
        raise ValueError(f"{short_repr(word)} is out of range: −{FARTHEST:.0f} to {FARTHEST:.0f}")
    return number


def _corners(words: list[str], points: int) -> tuple[int, ...]:
    """Return the vertex indices of a face, from 0. Raises ValueError."""
    corners = tuple(_corner(word.partition("/")[0], points, "vertex") for word in words)
    if len(corners) < 3:
        raise ValueError(f"a face needs at least three corners, not {len(corners)}")
    if len(set(corners)) < len(corners):
        raise ValueError("the face has a vertex twice")
    return corners


def _texture_corners(words: list[str], count: int) -> tuple[int, ...]:
    """Return the texture coordinate indices of a face, from 0; empty if a corner has none. Raises ValueError."""
    indices = [(word.split("/") + [""])[1] for word in words]
    return tuple(_corner(word, count, "texture coordinate") for word in indices) if all(indices) else ()


def _corner(word: str, count: int, what: str) -> int:
    """Return an index from 0. `count`: number of entries before this line. Raises ValueError."""
    try:
        number = int(word)
    except ValueError:  # also for thousands of digits
        raise ValueError(f"{short_repr(word)} is not a {what} index") from None
    if number == 0 or number < -count or number > MAX_POINTS:
        raise ValueError(f"{what} {short_repr(number)} does not exist")
    return number - 1 if number > 0 else count + number


# -- clips -------------------------------------------------------------------------------------------------------------

Floats = NDArray[np.float64]
Samples = list[NDArray[np.floating[Any]]]  # (points, 3) each

MAX_CLIP_BYTES = 1_000_000_000  # of all samples of a clip
PC2_HEADER = struct.Struct("<12siiffi")  # signature, version, points, start frame, sampling rate, samples
PC2_SIGNATURE = b"POINTCACHE2\0"
USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


@dataclass(frozen=True, eq=False)
class MeshClip:
    """The points of a mesh at equal intervals, in the unit of the file."""

    samples: NDArray[np.float32]
    """(samples, points, 3)."""
    rate: float
    """Samples per second."""
    loops: bool
    """Whether the first sample follows the last; otherwise the last one stays."""

    def at(self, seconds: float) -> Floats:
        """Return the points at a time [s], (points, 3)."""
        count, position = len(self.samples), seconds * self.rate
        position = position % count if self.loops else min(max(position, 0.0), count - 1.0)
        k = min(int(position), count - 1)
        share = position - k
        after = (k + 1) % count if self.loops else min(k + 1, count - 1)
        points: Floats = (1 - share) * self.samples[k].astype(np.float64) + share * self.samples[after]
        return points


def clip_of(mesh: Mesh, points: int) -> MeshClip:
    """Return the clip of a deforming mesh whose file has this number of points. It is cached (`file_version`).

    Raises ValueError with a one-line message if the clip cannot be used.
    """
    path = clip_path(mesh)
    return MeshClip(*_cached(path, file_version(path), points, mesh.clip_rate), mesh.clip_loop)


def clip_path(mesh: Mesh) -> Path:
    """Return the absolute path of the clip of a mesh, with a `*` for a sequence of files."""
    return mesh_path(mesh.file, mesh.folder).absolute().parent / mesh.clip


@lru_cache(maxsize=16)
def _cached(path: Path, version: Version, points: int, rate: float) -> tuple[NDArray[np.float32], float]:
    """Return the samples of a clip and their number per second."""
    if "*" in path.name:
        samples = _read_sequence(path)
    elif path.suffix == ".pc2":
        samples = _read_pc2(path)
    elif path.suffix in USD_SUFFIXES:
        samples, rate = _read_usd(path)
    else:
        raise _error(path, f"is no clip: use a .pc2 file, a USD file ({', '.join(USD_SUFFIXES)}), or walk_*.obj")
    for k, sample in enumerate(samples):
        if sample.shape != (points, 3):
            raise _error(path, f"sample {k} has {len(sample)} points, but the mesh has {points}")
        if not np.isfinite(sample).all() or np.abs(sample).max() > FARTHEST:
            bad = int(np.argmax(~(np.abs(sample) <= FARTHEST).all(axis=1)))
            raise _error(path, f"point {bad} of sample {k} is {sample[bad].tolist()}: not finite, or too far away")
    return np.array(samples, np.float32), rate


def _error(path: Path, reason: str) -> ObjError:
    return ObjError(path, 0, reason)


def _read_sequence(pattern: Path) -> Samples:
    """Return the vertices of all OBJ files that match, in the order of their names."""
    files = sorted(pattern.parent.glob(pattern.name))
    if not files:
        raise _error(pattern, "no file matches")
    return [read_obj(file)[0] for file in files]


def _read_pc2(path: Path) -> Samples:
    """Return the samples of a PC2 point cache."""
    try:
        with path.open("rb") as file:
            content = file.read(MAX_CLIP_BYTES + 1)
    except (OSError, ValueError) as error:
        raise _error(path, f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(content) > MAX_CLIP_BYTES:
        raise _error(path, f"is larger than {MAX_CLIP_BYTES} bytes")
    if len(content) < PC2_HEADER.size or not content.startswith(PC2_SIGNATURE):
        raise _error(path, "is no PC2 point cache")
    _, version, points, _, _, samples = PC2_HEADER.unpack_from(content)
    if version != 1 or not 0 < points <= MAX_POINTS or samples < 1:
        raise _error(path, f"is a PC2 point cache of version {version} with {points} points and {samples} samples")
    expected = PC2_HEADER.size + 12 * points * samples
    if len(content) != expected:
        raise _error(path, f"has {len(content)} bytes, but {samples} samples of {points} points are {expected}")
    return list(np.frombuffer(content, "<f4", offset=PC2_HEADER.size).reshape(samples, points, 3))


def _read_usd(path: Path) -> tuple[Samples, float]:
    """Return the samples of the first mesh of a USD file whose points move, and their number per second."""
    try:
        from pxr import Usd, UsdGeom
    except ImportError:
        raise _error(path, "needs the package usd-core: pip install '.[usd]'") from None
    if not path.is_file():
        raise _error(path, "cannot be read: No such file or directory")
    try:
        stage = Usd.Stage.Open(str(path))
    except Exception as error:  # the errors of USD have several lines
        raise _error(path, f"cannot be read: {str(error).splitlines()[0]}") from None
    for prim in stage.Traverse():
        attribute = UsdGeom.Mesh(prim).GetPointsAttr()
        times = attribute.GetTimeSamples() if prim.IsA(UsdGeom.Mesh) else []
        if len(times) > 1:
            steps = np.diff(times)
            if np.ptp(steps) > 1e-6 * steps.mean():
                raise _error(path, f"the samples of {prim.GetPath()} are not at equal intervals")
            samples = [np.array(attribute.Get(time), np.float32) for time in times]
            return samples, float(stage.GetTimeCodesPerSecond() / steps.mean())
    raise _error(path, "has no mesh whose points have time samples")
