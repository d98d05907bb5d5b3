"""Reader of vertices and faces of Wavefront OBJ files. NumPy only.

A line `v x y z` is a vertex, and a line `f a b c …` a face. Vertices are counted from 1; −1 is the last vertex before
the line. A line `vt u v` is a texture coordinate, and faces refer to it after the first slash of a corner. Lines `g`,
`o` and `usemtl` name the faces that follow. Everything else (normals, smoothing, materials) is ignored.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..system.errors import one_line, short_repr, shown_path

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
