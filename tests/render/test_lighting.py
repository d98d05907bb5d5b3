"""Light and shadows on a few triangles, against values computed by hand."""

from collections import Counter
from typing import Any

import numpy as np
import pytest
import taichi as ti
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.geometry.closed_surface import box_triangles
from taichi_cloth.render import shading
from taichi_cloth.render.draw_list import DrawMesh
from taichi_cloth.render.shading import (
    BACKGROUND,
    FLOOR_LIGHT,
    LIGHT_COLOR,
    LIGHT_DIRECTION,
    MOST_DIVISIONS,
    RIM_COLOR,
    RIM_DIRECTION,
    SHADOW_MAP_SIZE,
    SHADOW_U,
    SHADOW_V,
    SKY,
    TRANSMISSION,
    divided,
    shade_cloth,
    shade_floor,
)

FRAME = ti.math.vec4(0.0, 0.0, 0.0, 4.0)  # one texel is 31 mm
TO_LIGHT, AXIS_U, AXIS_V = (np.array(v.to_numpy(), np.float32) for v in (LIGHT_DIRECTION, SHADOW_U, SHADOW_V))


Setup = tuple[DrawMesh, Any]  # a mesh and its shadow map


@pytest.fixture(scope="module")
def setup() -> Setup:
    mesh = DrawMesh(*(ti.Vector.field(3, ti.f32, 12) for _ in range(4)))
    mesh.albedo.fill(1.0)
    return mesh, ti.field(ti.i32, (SHADOW_MAP_SIZE, SHADOW_MAP_SIZE))


def facing_light(distance: float, half: float) -> np.ndarray:
    """Return a triangle perpendicular to the light, on its axis, `distance` [m] toward the light."""
    corners = [(-half, -half), (3 * half, -half), (-half, 3 * half)]
    return np.array([distance * TO_LIGHT + a * AXIS_U + b * AXIS_V for a, b in corners], np.float32)


def put(setup: Setup, triangles: list[np.ndarray], normal: np.ndarray) -> DrawMesh:
    mesh, shadow_map = setup
    rows = np.zeros((12, 3), np.float32)
    rows[: 3 * len(triangles)] = np.concatenate(triangles)
    mesh.position.from_numpy(rows)
    mesh.normal.from_numpy(np.tile(normal.astype(np.float32), (12, 1)))
    mesh.corners = 3 * len(triangles)
    shading.clear_shadow_map(shadow_map)
    shading.cast_shadow(mesh, 0, mesh.corners, shadow_map, FRAME)
    return mesh


def lit(setup: Setup, triangle: int, eye: np.ndarray) -> np.ndarray:
    """Return the color of a white triangle at its first corner."""
    shade_cloth(setup[0], 0, setup[0].corners, 0.0, 1.0, ti.math.vec3(*eye.tolist()), setup[1], FRAME)
    return setup[0].color.to_numpy()[3 * triangle]


def ambient(normal: np.ndarray) -> np.ndarray:
    """Return the light from sky, floor and rim, computed by hand."""
    sky = 0.5 + 0.5 * normal[1]
    rim = max(float(normal @ RIM_DIRECTION.to_numpy()), 0.0) * RIM_COLOR.to_numpy()
    return (1 - sky) * FLOOR_LIGHT.to_numpy() + sky * SKY.to_numpy() + rim


def test_the_axes_of_the_shadow_map_are_orthonormal() -> None:
    axes = np.stack([AXIS_U, AXIS_V, TO_LIGHT])
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=2e-4)
    assert np.linalg.norm(RIM_DIRECTION.to_numpy()) == pytest.approx(1, abs=2e-4)


def test_a_sheet_is_lit_from_the_front_and_transmits_light_to_the_back(setup: Setup) -> None:
    put(setup, [facing_light(0.0, 0.5)], TO_LIGHT)
    front = np.minimum(ambient(TO_LIGHT) + LIGHT_COLOR.to_numpy(), 1)
    assert lit(setup, 0, 5 * TO_LIGHT) == pytest.approx(front, abs=1e-3)
    back = ambient(-TO_LIGHT) + TRANSMISSION * LIGHT_COLOR.to_numpy()
    assert lit(setup, 0, -5 * TO_LIGHT) == pytest.approx(back, abs=1e-3)


@pytest.mark.parametrize(("distance", "shaded"), [(1.0, True), (-1.0, False)], ids=["in front", "behind"])
def test_only_triangles_nearer_to_the_light_cast_a_shadow(setup: Setup, distance: float, shaded: bool) -> None:
    put(setup, [facing_light(0.0, 0.3), facing_light(distance, 1.0)], TO_LIGHT)
    expected = ambient(TO_LIGHT) + (0 if shaded else 1) * LIGHT_COLOR.to_numpy()
    assert lit(setup, 0, 5 * TO_LIGHT) == pytest.approx(np.minimum(expected, 1), abs=1e-3)


def test_shadow_edges_are_soft(setup: Setup) -> None:
    """A corner exactly behind the edge of an occluder gets about half of the light."""
    occluder = facing_light(1.0, 1.0) + 1.0 * AXIS_U  # its edge runs through the center
    mesh = put(setup, [facing_light(0.0, 1e-4), occluder], TO_LIGHT)
    mesh.albedo.fill(0.5)
    share = (lit(setup, 0, 5 * TO_LIGHT) / 0.5 - ambient(TO_LIGHT)) / LIGHT_COLOR.to_numpy()
    mesh.albedo.fill(1.0)
    assert 0.2 < share.mean() < 0.8


def test_triangles_that_are_not_finite_or_outside_the_map_have_no_effect(setup: Setup) -> None:
    fine = facing_light(0.0, 0.3)
    put(setup, [fine, np.full((3, 3), np.nan), np.full((3, 3), np.inf), 1e20 * fine], TO_LIGHT)
    assert np.isfinite(lit(setup, 0, 5 * TO_LIGHT)).all()
    assert setup[1].to_numpy().any()


def test_the_floor_fades_into_the_background(setup: Setup) -> None:
    mesh = put(setup, [np.array([[9.0, 0.0, 0.0], [9.0, 0.0, 1.0], [9.0, 0.0, 0.5]], np.float32)], np.array([0, 1, 0]))
    shade_floor(mesh, 3, setup[1], FRAME, ti.math.vec3(0.0), 9.0)
    assert mesh.color.to_numpy()[0] == pytest.approx(BACKGROUND, abs=1e-6)


def edge_lengths(corners: np.ndarray) -> np.ndarray:
    """Return the length of the edge from each corner of triangles to the next [m], (T, 3)."""
    triangles = corners.reshape(-1, 3, 3)
    return np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)


def a_box(size: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the corners of a box, their normals, and colors that equal the positions."""
    positions, normals = (values.astype(np.float32) for values in box_triangles(np.zeros(3), np.array(size)))
    return positions, normals, positions.copy()


@given(st.tuples(*[st.floats(0.05, 5.0)] * 3), st.floats(0.1, 8.0))
def test_a_divided_solid_has_short_edges_and_no_gaps(size: tuple[float, float, float], longest: float) -> None:
    solid = a_box(size)
    positions, normals, colors = divided(solid, longest)
    limit = max(longest, edge_lengths(solid[0]).max() / MOST_DIVISIONS)
    assert edge_lengths(positions).max() <= limit * (1 + 1e-5)  # rounded to float32
    ends = np.stack([positions, np.roll(positions.reshape(-1, 3, 3), -1, axis=1).reshape(-1, 3)], axis=1)
    edges = Counter(frozenset(map(bytes, edge)) for edge in ends)
    assert set(edges.values()) == {2}  # every edge belongs to two triangles
    a, b, c = positions.reshape(-1, 3, 3).swapaxes(0, 1).astype(float)
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6 == pytest.approx(np.prod(size), rel=1e-4)
    assert colors == pytest.approx(positions)
    assert np.einsum("ij,ij->i", np.cross(b - a, c - a), normals[::3]) == pytest.approx(
        np.linalg.norm(np.cross(b - a, c - a), axis=1), rel=1e-4
    )


def test_a_solid_far_from_the_origin_is_divided() -> None:
    """The edges of a box at the coordinates of a map are a few roundings of float32 long."""
    positions, normals, colors = a_box((1.0, 1.0, 1.0))
    far = positions + np.float32(4e6)
    assert (divided((far, normals, colors), 0.1)[0] >= far.min()).all()
    assert len(divided((far, normals, colors), 0.1)[0]) > len(far)


def test_a_solid_with_short_edges_is_not_divided() -> None:
    solid = a_box((1.0, 2.0, 3.0))
    for before, after in zip(solid, divided(solid, 4.0), strict=True):
        assert (before == after).all()


def test_the_number_of_triangles_is_limited() -> None:
    assert len(divided(a_box((1.0, 1.0, 1.0)), 1e-6)[0]) == 3 * 12 * MOST_DIVISIONS**2
