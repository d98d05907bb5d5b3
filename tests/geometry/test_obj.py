"""OBJ files: valid ones, and the one-line errors of invalid ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.geometry.mesh_reader import MAX_BYTES, ObjError, read_obj

Write = Callable[[str | bytes], Path]

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


@pytest.fixture(scope="module")
def write(tmp_path_factory: pytest.TempPathFactory) -> Write:
    path = tmp_path_factory.mktemp("obj") / "mine.obj"

    def to_file(text: str | bytes) -> Path:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return to_file


@pytest.mark.parametrize(
    "face",
    ["f 1 2 3 4", "f 1/5 2/6 3/7 4/8", "f 1/5/1 2/6/2 3/7/3 4/8/4", "f 1//1 2//2 3//3 4//4", "f -4 -3 -2 -1 # all"],
)
def test_a_quad_becomes_two_triangles(write: Write, face: str) -> None:
    points, faces = read_obj(write(f"mtllib a.mtl\no square\n{SQUARE}vt 0 0\nvn 0 0 1\nusemtl grey\ns off\n{face}\n"))
    assert points.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_indices_may_be_negative_or_refer_to_later_vertices(write: Write) -> None:
    points, faces = read_obj(write("v 0 0 0 1.0 0.5\r\nf -1 2 3\r\nv 1e-1 -2. .5 0.1 0.2 0.3\r\nv 2 2 2"))
    assert points[1] == pytest.approx([0.1, -2, 0.5])
    assert faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("", 0, "has no faces"),
        (SQUARE, 0, "has no faces"),
        (SQUARE + "f 1 2", 5, "a face needs at least three corners, not 2"),
        (SQUARE + "f 1 2 2", 5, "the face has a vertex twice"),
        (SQUARE + "f 1 2 -3", 5, "the face has a vertex twice"),
        (SQUARE + "\nf 1 2 5", 6, "vertex 5 does not exist: the file has 4"),
        (SQUARE + "f 1 2 0", 5, "vertex 0 does not exist"),
        (SQUARE + "f 1 2 -5", 5, "vertex -5 does not exist"),
        (SQUARE + "f 1 2 x/1", 5, "'x' is not a vertex index"),
        (SQUARE + f"f 1 2 {'9' * 5000}", 5, "is not a vertex index"),
        ("v 1 2", 1, "a vertex needs three numbers, not 2"),
        ("v 1 2 three", 1, "'three' is not a number"),
        ("v 1 2 nan", 1, "'nan' is not a finite number"),
        ("v 1 2 -1e300", 1, "'-1e300' is out of range"),
        (b"\xff\xfev\x00 1 2", 0, "has no faces"),
    ],
)
def test_an_invalid_file_is_refused_in_one_line(write: Write, text: str | bytes, line: int, reason: str) -> None:
    path = write(text)
    with pytest.raises(ObjError) as caught:
        read_obj(path)
    assert str(caught.value).startswith(f"{path}: line {line}: " if line else f"{path}: ")
    assert reason in str(caught.value)
    assert str(caught.value).isprintable()
    assert caught.value.line == line


def test_an_unreadable_file_is_refused(tmp_path: Path, write: Write) -> None:
    for path in (tmp_path / "none.obj", tmp_path, tmp_path / "zero\0byte.obj"):
        with pytest.raises(ObjError, match="cannot be read"):
            read_obj(path)
    with pytest.raises(ObjError, match=f"larger than {MAX_BYTES} bytes"):
        read_obj(write(b"#" * (MAX_BYTES + 1)))


words = st.sampled_from(["v", "f", "vt", "0", "1", "-1", "2", "3", "1/2/3", "//", "nan", "1e9", "\\", "#", "x"])


@given(st.lists(st.lists(words | st.text(max_size=3), max_size=6), max_size=8) | st.binary(max_size=60))
def test_random_content_is_read_or_raises_an_obj_error(write: Write, content: list[list[str]] | bytes) -> None:
    text = content if isinstance(content, bytes) else "\n".join(map(" ".join, content)).encode("utf-8", "replace")
    try:
        points, faces = read_obj(write(SQUARE.encode() + text))
    except ObjError as error:
        assert str(error).isprintable()
    else:
        assert np.isfinite(points).all()
        assert 0 <= faces.min() <= faces.max() < len(points)
