"""Closed surfaces: checks, normals, and the closest point of a triangle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from taichi_cloth.geometry.closed_surface import (
    closed_surface,
    closest_point_on_triangle,
    face_normals,
    feature_normals,
    smooth_normals,
)

# A tetrahedron with three edges along x, y and z.
POINTS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)

numbers = st.floats(-2, 2, allow_subnormal=False)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)


def test_a_closed_surface_is_centered_on_its_bounding_box() -> None:
    with_unused_vertex = np.concatenate([POINTS + [5.0, 0.0, 0.0], [[99.0, 0.0, 0.0]]])
    surface = closed_surface(with_unused_vertex, FACES)
    assert surface.half.tolist() == [0.5, 0.5, 0.5]
    assert surface.vertices[0].tolist() == [-0.5, -0.5, -0.5]
    assert surface.scaled(2.0).vertices[1].tolist() == [1.0, -1.0, -1.0]
    assert surface.scaled(2.0).half.tolist() == [1.0, 1.0, 1.0]


def test_faces_that_point_inward_are_flipped() -> None:
    assert (closed_surface(POINTS, FACES).faces == FACES).all()
    flipped = closed_surface(POINTS, FACES[:, ::-1])
    assert face_normals(flipped) == pytest.approx(face_normals(closed_surface(POINTS, FACES)))


@pytest.mark.parametrize(
    ("faces", "reason"),
    [
        (FACES[:3], "the edge from vertex 3 to 2 belongs to only one face"),
        (
            np.concatenate([FACES[:3], FACES[3:, ::-1]]),
            "the edge from vertex 3 to 2 has the same direction in two faces",
        ),
        (
            np.concatenate([FACES, FACES[:1]]),
            "the edge from vertex 1 to 3 has the same direction in two faces",
        ),
    ],
    ids=["open", "one face flipped", "one face twice"],
)
def test_the_error_of_an_open_surface_names_its_first_bad_edge(faces: np.ndarray, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        closed_surface(POINTS, faces)


def test_a_flat_surface_is_refused() -> None:
    with pytest.raises(ValueError, match="encloses no volume"):
        closed_surface(POINTS * [1.0, 1.0, 0.0], FACES)


def test_feature_normals_of_a_tetrahedron() -> None:
    surface = closed_surface(POINTS, FACES)
    slanted = np.full(3, 3**-0.5)
    assert face_normals(surface) == pytest.approx(np.array([[0, 0, -1], [0, -1, 0], [-1, 0, 0], slanted]))
    found = feature_normals(surface)
    # The first face is (0, 2, 1): its first vertex is the right angle, its edges are along y, the slanted one and x.
    assert found[0, 1] == pytest.approx(-np.full(3, np.pi / 2))
    assert found[0, 3] == pytest.approx([-1, 0, -1])
    assert found[0, 6] == pytest.approx(slanted + [0, 0, -1])
    assert found[0, 7] == pytest.approx([0, 0, -1])
    assert smooth_normals(surface) == pytest.approx(np.repeat(face_normals(surface)[:, None], 3, axis=1))


def test_faces_at_small_angles_are_shaded_smoothly() -> None:
    flat = closed_surface(POINTS * [1.0, 1.0, 0.05], FACES)
    assert smooth_normals(flat)[3, 2] == pytest.approx(face_normals(flat)[3])  # all edges at this vertex are sharp
    n = 12
    angle = np.arange(n) * 2 * np.pi / n
    rim = np.stack([np.cos(angle), np.zeros(n), np.sin(angle)], axis=1)
    points = np.concatenate([rim, [[0.0, 0.3, 0.0], [0.0, -0.3, 0.0]]])
    here, there = np.arange(n), (np.arange(n) + 1) % n
    faces = np.concatenate([np.stack([there, here, here * 0 + n], 1), np.stack([here, there, here * 0 + n + 1], 1)])
    smooth = smooth_normals(closed_surface(points, faces.astype(np.int32)))
    # At the tip all normals are averaged.
    assert smooth[:n, 2] == pytest.approx(np.tile([0.0, 1.0, 0.0], (n, 1)), abs=1e-12)


@given(vectors, vectors, vectors, vectors)
def test_no_point_of_a_triangle_is_closer_than_the_closest_point(
    point: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray
) -> None:
    corners = np.stack([a, b, c])
    assume(np.linalg.norm(np.cross(b - a, c - a)) > 1e-3)
    [shares] = closest_point_on_triangle(point[None], corners[None])
    assert shares.min() >= 0
    assert shares.sum() == pytest.approx(1)
    others = np.random.default_rng(4).dirichlet(np.ones(3), 200) @ corners
    least = np.linalg.norm(others - point, axis=1).min()
    assert np.linalg.norm(shares @ corners - point) <= least + 1e-9


def test_closest_points_on_a_face_an_edge_and_a_corner() -> None:
    points = np.array([[0.2, 0.3, 5.0], [0.5, -1.0, 0.0], [-1.0, -2.0, 3.0], [2.0, 2.0, 0.0], [0.5, 0.0, 1.0]])
    shares = closest_point_on_triangle(points, np.tile(POINTS[[0, 1, 2]], (5, 1, 1)))
    expected = [[0.5, 0.2, 0.3], [0.5, 0.5, 0.0], [1.0, 0.0, 0.0], [0.0, 0.5, 0.5], [0.5, 0.5, 0.0]]
    assert shares == pytest.approx(np.array(expected))
    assert (shares == 0).tolist() == (np.array(expected) == 0).tolist()


def test_the_closest_point_of_a_degenerate_triangle_is_on_an_edge() -> None:
    line = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]])
    assert closest_point_on_triangle(np.array([[1.5, 1.0, 0.0]]), line) @ line[0] == pytest.approx(
        np.array([[1.5, 0, 0]])
    )
