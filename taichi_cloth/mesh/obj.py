"""Reads the points and faces of a Wavefront OBJ file. NumPy only.

Lines `v x y z` are points and lines `f a b c …` faces: corners are counted from 1, or backwards from the last point so
far with −1. What stands behind a slash, and all other lines (normals, texture, groups, materials), is left aside.
"""

from __future__ import annotations

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

Points = NDArray[np.float64]
Faces = NDArray[np.int32]


class ObjError(ValueError):
    """A file is no OBJ that can be used. Its text is a single line: `FILE: line N: REASON`."""

    def __init__(self, path: Path, line: int, reason: str) -> None:
        """`line` 0 is the file as a whole."""
        self.line, self.reason = line, reason
        super().__init__(one_line(": ".join([str(path), *([f"line {line}"] if line else []), reason])))


def read_obj(path: Path) -> tuple[Points, Faces]:
    """Points of shape (N, 3) and triangles (T, 3), indices of points; a face of more corners becomes a fan.

    Raises ObjError.
    """
    points: list[tuple[float, ...]] = []
    faces: list[tuple[int, int, int]] = []
    lines_of_faces: list[int] = []
    for number, line in enumerate(_text(path).splitlines(), 1):
        words = line.partition("#")[0].split()
        try:
            if words[:1] == ["v"]:
                points.append(_point(words[1:]))
            elif words[:1] == ["f"]:
                first, *others = _corners(words[1:], len(points))
                faces += [(first, b, c) for b, c in pairwise(others)]
                lines_of_faces += [number] * (len(others) - 1)
        except ValueError as error:
            raise ObjError(path, number, str(error)) from None
        if len(points) > MOST_POINTS or len(faces) > MOST_TRIANGLES:
            raise ObjError(path, number, f"more than {MOST_POINTS} points or {MOST_TRIANGLES} triangles")
    if not faces:
        raise ObjError(path, 0, "has no faces: lines that begin with `f`")
    triangles = np.array(faces, np.int64)
    if triangles.max() >= len(points):  # a face may stand before its points
        row = int(np.argmax((triangles >= len(points)).any(axis=1)))
        what = f"point {triangles[row].max() + 1} does not exist: the file has {len(points)}"
        raise ObjError(path, lines_of_faces[row], what)
    return np.array(points), triangles.astype(np.int32)


def _text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte
        raise ObjError(path, 0, f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(content) > MOST_BYTES:
        raise ObjError(path, 0, f"is larger than {MOST_BYTES} bytes")
    return content.decode("utf-8", "replace")


def _point(words: list[str]) -> tuple[float, ...]:
    if len(words) < 3:
        raise ValueError(f"a point has three coordinates, not {len(words)}")
    return tuple(_number(word) for word in words[:3])  # a weight or a colour may follow


def _number(word: str) -> float:
    try:
        number = float(word)
    except ValueError:
        raise ValueError(f"{shown(word)} is no number") from None
    if not isfinite(number) or abs(number) > FARTHEST:
        raise ValueError(f"{shown(word)} is out of range: −{FARTHEST:.0f} to {FARTHEST:.0f}")
    return number


def _corners(words: list[str], points: int) -> list[int]:
    """Indices of a face's points, from 0."""
    corners = [_corner(word.partition("/")[0], points) for word in words]
    if len(corners) < 3:
        raise ValueError(f"a face has three corners or more, not {len(corners)}")
    if len(set(corners)) < len(corners):
        raise ValueError("the face has a point twice")
    return corners


def _corner(word: str, points: int) -> int:
    try:
        number = int(word)
    except ValueError:  # or thousands of digits
        raise ValueError(f"{shown(word)} is no number of a point") from None
    if number == 0 or number < -points or number > MOST_POINTS:
        raise ValueError(f"point {shown(number)} does not exist")
    return number - 1 if number > 0 else points + number
