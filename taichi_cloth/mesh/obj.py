"""Reads the points and faces of a Wavefront OBJ file. NumPy only.

Lines `v x y z` are points and lines `f a b c …` faces: corners are counted from 1, or backwards from the last point so
far with −1. Lines `vt u v` and what stands behind a first slash place them on a picture. Lines `g`, `o` and `usemtl`
name the faces that follow. All else (normals, smoothing, materials) is left aside.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import one_line
from ..scene.errors import shown

MOST_BYTES = 64_000_000
MOST_POINTS, MOST_TRIANGLES = 500_000, 1_000_000
FARTHEST = 1e6  # of a coordinate: squares of lengths stay finite
COUNTS = {2: "two", 3: "three"}

Points = NDArray[np.float64]
Faces = NDArray[np.int32]


class ObjError(ValueError):
    """A file is no OBJ that can be used. Its text is a single line: `FILE: line N: REASON`."""

    def __init__(self, path: Path, line: int, reason: str) -> None:
        """`line` 0 is the file as a whole."""
        self.line, self.reason = line, reason
        super().__init__(one_line(": ".join([str(path), *([f"line {line}"] if line else []), reason])))


@dataclass(frozen=True, eq=False)
class Obj:
    """What stands in a file, face by face."""

    path: Path
    points: Points  # (N, 3)
    faces: list[tuple[int, ...]]  # indices of points
    lines: list[int]  # of each face
    marks: list[tuple[int, str, tuple[str, ...]]]  # a line `g`, `o` or `usemtl`: the face it begins with, and its names
    texture: Points  # (M, 2) `vt`
    texture_faces: list[tuple[int, ...]]  # indices of those for each corner of a face, or none

    def error(self, face: int, reason: str) -> ObjError:
        """The error that one of its faces is."""
        return ObjError(self.path, self.lines[face], reason)


def read_obj(path: Path) -> tuple[Points, Faces]:
    """Points of shape (N, 3) and triangles (T, 3), indices of points; a face of more corners becomes a fan.

    Raises ObjError.
    """
    obj = parse_obj(path)
    fans = [(first, b, c) for first, *others in obj.faces for b, c in pairwise(others)]
    return obj.points, np.array(fans, np.int32)


def parse_obj(path: Path, *, texture: bool = False) -> Obj:
    """All that is read of a file. `texture`: its places on a picture too. Raises ObjError."""
    points: list[tuple[float, ...]] = []
    spots: list[tuple[float, ...]] = []
    obj = Obj(path, np.zeros((0, 3)), [], [], [], np.zeros((0, 2)), [])
    triangles = 0
    for number, line in enumerate(_text(path).splitlines(), 1):
        kind, *words = line.partition("#")[0].split() or [""]
        try:
            if kind == "v":
                points.append(_numbers(words, 3, "a point"))  # a weight or a colour may follow
            elif kind == "f":
                obj.faces.append(_corners(words, len(points)))
                obj.lines.append(number)
                triangles += len(words) - 2
                if texture:
                    obj.texture_faces.append(_spots(words, len(spots)))
            elif kind == "vt" and texture:
                spots.append(_numbers(words, 2, "a texture point"))
            elif kind in ("g", "o", "usemtl"):
                obj.marks.append((len(obj.faces), kind, tuple(words)))
        except ValueError as error:
            raise ObjError(path, number, str(error)) from None
        if max(len(points), len(spots)) > MOST_POINTS or triangles > MOST_TRIANGLES:
            raise ObjError(path, number, f"more than {MOST_POINTS} points or {MOST_TRIANGLES} triangles")
    if not obj.faces:
        raise ObjError(path, 0, "has no faces: lines that begin with `f`")
    for what, found, faces in (("point", points, obj.faces), ("texture point", spots, obj.texture_faces)):
        for k, face in enumerate(faces):  # one may stand before its points
            if max(face, default=-1) >= len(found):
                raise obj.error(k, f"{what} {max(face) + 1} does not exist: the file has {len(found)}")
    return replace(obj, points=np.array(points), texture=np.array(spots).reshape(-1, 2))


def _text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte
        raise ObjError(path, 0, f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(content) > MOST_BYTES:
        raise ObjError(path, 0, f"is larger than {MOST_BYTES} bytes")
    return content.decode("utf-8", "replace")


def _numbers(words: list[str], count: int, what: str) -> tuple[float, ...]:
    if len(words) < count:
        raise ValueError(f"{what} has {COUNTS[count]} coordinates, not {len(words)}")
    return tuple(_number(word) for word in words[:count])


def _number(word: str) -> float:
    try:
        number = float(word)
    except ValueError:
        raise ValueError(f"{shown(word)} is no number") from None
    if not isfinite(number) or abs(number) > FARTHEST:
        raise ValueError(f"{shown(word)} is out of range: −{FARTHEST:.0f} to {FARTHEST:.0f}")
    return number


def _corners(words: list[str], points: int) -> tuple[int, ...]:
    """Indices of a face's points, from 0."""
    corners = tuple(_corner(word.partition("/")[0], points, "point") for word in words)
    if len(corners) < 3:
        raise ValueError(f"a face has three corners or more, not {len(corners)}")
    if len(set(corners)) < len(corners):
        raise ValueError("the face has a point twice")
    return corners


def _spots(words: list[str], spots: int) -> tuple[int, ...]:
    """Indices of the texture points at a face's corners, from 0; empty where a corner has none."""
    told = [(word.split("/") + [""])[1] for word in words]
    return tuple(_corner(word, spots, "texture point") for word in told) if all(told) else ()


def _corner(word: str, points: int, what: str) -> int:
    try:
        number = int(word)
    except ValueError:  # or thousands of digits
        raise ValueError(f"{shown(word)} is no number of a {what}") from None
    if number == 0 or number < -points or number > MOST_POINTS:
        raise ValueError(f"{what} {shown(number)} does not exist")
    return number - 1 if number > 0 else points + number
