"""OBJ files as cloth: valid ones, and the one-line errors of files that cannot be cloth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from meshes import quads, write_obj

from taichi_cloth.geometry import grid
from taichi_cloth.geometry.cloth_mesh import ClothMesh, read_cloth
from taichi_cloth.geometry.mesh_reader import ObjError
from taichi_cloth.scene.presets import mesh_path

Write = Callable[[str], Path]

SIX = "v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nv 1 1 0\nv 2 1 0\n"  # lines 1 to 6: 4 5 6 over 1 2 3


@pytest.fixture(scope="module")
def write(tmp_path_factory: pytest.TempPathFactory) -> Write:
    path = tmp_path_factory.mktemp("cloth") / "mine.obj"

    def to_file(text: str) -> Path:
        path.write_text(text, encoding="utf-8", errors="replace")
        return path

    return to_file


def test_a_mesh_may_have_quads_and_triangles(write: Write) -> None:
    file = read_cloth(write(SIX + "f 1 2 5 4\nf 2 3 6\nf 2 6 5\n"))
    assert file.vertices[0].tolist() == [-1, -0.5, 0]  # the center of the bounding box is the origin
    assert file.faces.tolist() == [[0, 1, 4, 3], [1, 2, 5, -1], [1, 5, 4, -1]]
    assert file.triangles.tolist() == [[1, 2, 5], [1, 5, 4], [0, 1, 4], [0, 4, 3]]
    assert file.edges[0].tolist() == [[0, 1], [0, 3], [1, 2], [1, 4], [1, 5], [2, 5], [3, 4], [4, 5]]
    assert file.graph_distance[0].tolist() == [0, 1, 2, 1, 2, 2]
    assert (file.groups, file.uv, file.graph_distance[1]) == ({}, None, 1)


def test_a_group_extends_to_the_next_line_of_its_kind(write: Write) -> None:
    text = SIX + "o flag\nusemtl red\ng left hem\nf 1 2 5 4\ng right\nf 2 3 6 5\ng none\n"
    groups = read_cloth(write(text)).groups
    assert {name: points.tolist() for name, points in groups.items()} == {
        "left": [0, 1, 3, 4],
        "hem": [0, 1, 3, 4],
        "right": [1, 2, 4, 5],
        "flag": [0, 1, 2, 3, 4, 5],
        "red": [0, 1, 2, 3, 4, 5],
    }


def test_texture_coordinates_are_those_of_the_first_face_that_has_them(write: Write) -> None:
    coordinates = "vt 0 0\nvt 1 0\nvt 1 1 0\nvt 0 1\nvt 0.5 0.5\n"
    file = read_cloth(write(SIX + coordinates + "f 1/1 2/2 5/3 4/4\nf 2/5 3/1/1 6/-4 5/5\n"))
    assert file.uv is not None
    assert file.uv.tolist() == [[0, 0], [1, 0], [0, 0], [0, 1], [1, 1], [1, 0]]
    assert read_cloth(write(SIX + coordinates + "f 1/1 2/2 5/3 4/4\nf 2 3 6 5\n")).uv is None


def test_quads_are_cut_like_the_cells_of_a_grid(tmp_path: Path) -> None:
    file = read_cloth(write_obj(tmp_path / "grid.obj", *quads(4, 6)))
    of_grid, _ = grid.triangles(4, 6)
    assert {tuple(sorted(t)) for t in file.triangles.tolist()} == {tuple(sorted(t)) for t in of_grid.tolist()}


@pytest.mark.parametrize(
    ("faces", "line", "reason"),
    [
        ("", 0, "has no faces"),
        ("f 1 2 5 4\nf 2 3 6 5\nf 1 2 9\n", 9, "vertex 9 does not exist: the file has 6"),
        ("f 1 2 3 6 5 4\n", 7, "the face has 6 corners, not 3 or 4"),
        ("f 1 2 5 4\n", 0, "vertex 3 belongs to no face, and 1 more: delete loose vertices"),
        ("f 1 2 5 4\nf 2 3 6 5\nf 5 4 1 2\n", 9, "the face has the same vertices as that on line 7: delete one"),
        (
            "f 1 2 4\nf 2 1 5\nf 1 2 6\nf 3 6 5\n",
            0,
            "the edge from vertex 1 to 2 belongs to 3 faces (lines 7, 8, 9), not to one or two",
        ),
        ("f 1 2 5 4\nf 2 5 6 3\n", 8, "has the edge from vertex 2 to 5 in the same direction as the face on line 7"),
        ("f 1 2 3\nf 4 5 2 1\nf 5 6 3 2\n", 7, "the face of vertices 1, 2, 3 has a corner of zero area"),
        ("f 1 5 2\nf 1 2 5 4\nf 1 6 3\n", 8, "vertices 1 and 5 are opposite corners of the quad"),
        ("v 0 0 1\nv 0 1 1\nf 1 2 5 4\nf 1 7 5 8\nf 2 3 6\n", 10, "vertices 1 and 5 are opposite corners of the quad"),
        ("v 0.3 0.2 0\nf 1 2 7 4\nf 2 3 6 5\n", 8, "the quad is not convex"),
        ("v 1 1 nan\nf 1 2 7\n", 7, "'nan' is not a finite number"),
        ("v inf 1 0\nf 1 2 7\n", 7, "'inf' is not a finite number"),
        ("vt 0 0\nf 1/1 2/2 5/1 4/1\n", 8, "texture coordinate 2 does not exist: the file has 1"),
        ("vt 0\nf 1 2 5 4\n", 7, "a texture coordinate needs two numbers, not 1"),
    ],
)
def test_an_invalid_file_is_refused_in_one_line(write: Write, faces: str, line: int, reason: str) -> None:
    path = write(SIX + faces)
    with pytest.raises(ObjError) as caught:
        read_cloth(path)
    assert str(caught.value).startswith(f"{path}: line {line}: " if line else f"{path}: ")
    assert reason in str(caught.value)
    assert str(caught.value).isprintable()


words = st.sampled_from(["1", "2", "3", "4", "5", "6", "-1", "1/1", "2/1", "7", "0", "nan", "x", "//"])
corners = st.lists(st.sampled_from(range(1, 7)), min_size=3, max_size=4, unique=True).map(
    lambda c: " ".join(map(str, c))
)
rows = st.tuples(st.just("f"), corners) | st.tuples(
    st.sampled_from(["v", "vt", "f", "g", "o", "usemtl", "#", ""]), st.lists(words, max_size=5).map(" ".join)
)


@given(st.lists(rows, max_size=8))
@example([("f", "1 5 2"), ("f", "1 2 5 4"), ("f", "1 6 3")])
def test_random_text_is_read_or_raises_an_obj_error(write: Write, content: list[tuple[str, str]]) -> None:
    try:
        file = read_cloth(write(SIX + "\n".join(map(" ".join, content))))
    except ObjError as error:
        assert str(error).isprintable()
    else:
        check_cloth(file)


def check_cloth(file: ClothMesh) -> None:
    """Check that every vertex has a triangle, every triangle an area, and no directed side occurs twice."""
    assert np.isfinite(file.vertices).all()
    assert set(file.triangles.reshape(-1)) == set(range(len(file.vertices)))
    a, b, c = (file.vertices[file.triangles[:, k]] for k in range(3))
    assert (np.linalg.norm(np.cross(b - a, c - a), axis=1) > 0).all()
    sides = np.concatenate([file.triangles[:, [0, 1]], file.triangles[:, [1, 2]], file.triangles[:, [2, 0]]])
    assert len(np.unique(sides, axis=0)) == len(sides)


@pytest.mark.parametrize("name", ["round", "bust", "disc"])
def test_shipped_meshes_are_cloth(name: str) -> None:
    check_cloth(read_cloth(mesh_path(name, "")))
