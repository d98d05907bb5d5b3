"""Closed surfaces: which are, which are not, and the nearest point of a triangle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from taichi_cloth.mesh.surface import closed_surface, face_normals, feature_normals, nearest, smooth_normals

# A tetrahedron with three edges along x, y and z.
POINTS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)

numbers = st.floats(-2, 2, allow_subnormal=False)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)


def test_a_closed_surface_is_moved_to_the_middle_of_its_box() -> None:
    surface = closed_surface(np.concatenate([POINTS + [5.0, 0.0, 0.0], [[99.0, 0.0, 0.0]]]), FACES)  # one is not used
    assert surface.half.tolist() == [0.5, 0.5, 0.5]
    assert surface.points[0].tolist() == [-0.5, -0.5, -0.5]
    assert surface.scaled(2.0).points[1].tolist() == [1.0, -1.0, -1.0]
    assert surface.scaled(2.0).half.tolist() == [1.0, 1.0, 1.0]


def test_faces_that_look_inwards_are_turned() -> None:
    assert (closed_surface(POINTS, FACES).faces == FACES).all()
    turned = closed_surface(POINTS, FACES[:, ::-1])
    assert face_normals(turned) == pytest.approx(face_normals(closed_surface(POINTS, FACES)))


@pytest.mark.parametrize(
    ("faces", "reason"),
    [
        (FACES[:3], "the edge from point 3 to 2 belongs to one face only"),
        (np.concatenate([FACES[:3], FACES[3:, ::-1]]), "the edge from point 3 to 2 belongs to two faces that pass it"),
        (
            np.concatenate([FACES, FACES[:1]]),
            "the edge from point 1 to 3 belongs to two faces that pass it in the same",
        ),
    ],
    ids=["open", "one face turned", "one face twice"],
)
def test_a_surface_that_is_not_closed_names_its_first_bad_edge(faces: np.ndarray, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        closed_surface(POINTS, faces)


def test_a_flat_one_is_refused() -> None:
    with pytest.raises(ValueError, match="encloses no volume"):
        closed_surface(POINTS * [1.0, 1.0, 0.0], FACES)


def test_normals_of_a_tetrahedrons_features() -> None:
    surface = closed_surface(POINTS, FACES)
    slanted = np.full(3, 3**-0.5)
    assert face_normals(surface) == pytest.approx(np.array([[0, 0, -1], [0, -1, 0], [-1, 0, 0], slanted]))
    found = feature_normals(surface)
    # The first face is (0, 2, 1): its first point is the right corner, its edges run along y, the slant and x.
    assert found[0, 1] == pytest.approx(-np.full(3, np.pi / 2))
    assert found[0, 3] == pytest.approx([-1, 0, -1])
    assert found[0, 6] == pytest.approx(slanted + [0, 0, -1])
    assert found[0, 7] == pytest.approx([0, 0, -1])
    assert smooth_normals(surface) == pytest.approx(np.repeat(face_normals(surface)[:, None], 3, axis=1))


def test_faces_that_meet_at_little_are_drawn_smooth() -> None:
    flat = closed_surface(POINTS * [1.0, 1.0, 0.05], FACES)
    assert smooth_normals(flat)[3, 2] == pytest.approx(face_normals(flat)[3])  # all edges there are sharp
    n = 12
    angle = np.arange(n) * 2 * np.pi / n
    rim = np.stack([np.cos(angle), np.zeros(n), np.sin(angle)], axis=1)
    points = np.concatenate([rim, [[0.0, 0.3, 0.0], [0.0, -0.3, 0.0]]])
    here, there = np.arange(n), (np.arange(n) + 1) % n
    faces = np.concatenate([np.stack([there, here, here * 0 + n], 1), np.stack([here, there, here * 0 + n + 1], 1)])
    smooth = smooth_normals(closed_surface(points, faces.astype(np.int32)))
    assert smooth[:n, 2] == pytest.approx(np.tile([0.0, 1.0, 0.0], (n, 1)), abs=1e-12)  # at the tip all are one


@given(vectors, vectors, vectors, vectors)
def test_no_point_of_a_triangle_is_nearer_than_the_nearest(
    place: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray
) -> None:
    corners = np.stack([a, b, c])
    assume(np.linalg.norm(np.cross(b - a, c - a)) > 1e-3)
    [shares] = nearest(place[None], corners[None])
    assert shares.min() >= 0
    assert shares.sum() == pytest.approx(1)
    others = np.random.default_rng(4).dirichlet(np.ones(3), 200) @ corners
    least = np.linalg.norm(others - place, axis=1).min()
    assert np.linalg.norm(shares @ corners - place) <= least + 1e-9


def test_the_nearest_point_of_a_face_an_edge_and_a_corner_by_hand() -> None:
    places = np.array([[0.2, 0.3, 5.0], [0.5, -1.0, 0.0], [-1.0, -2.0, 3.0], [2.0, 2.0, 0.0], [0.5, 0.0, 1.0]])
    shares = nearest(places, np.tile(POINTS[[0, 1, 2]], (5, 1, 1)))
    expected = [[0.5, 0.2, 0.3], [0.5, 0.5, 0.0], [1.0, 0.0, 0.0], [0.0, 0.5, 0.5], [0.5, 0.5, 0.0]]
    assert shares == pytest.approx(np.array(expected))
    assert (shares == 0).tolist() == (np.array(expected) == 0).tolist()


def test_a_triangle_without_area_is_as_near_as_its_edges() -> None:
    line = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]])
    assert nearest(np.array([[1.5, 1.0, 0.0]]), line) @ line[0] == pytest.approx(np.array([[1.5, 0, 0]]))
