"""Contact with triangles in the reference: closest points by sampling, impulses by conservation of momentum."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.evaluation.reference.solution import Motion
from taichi_cloth.evaluation.reference.unilateral_contact import TriangleContact, closest_to_axis, obstacles_of
from taichi_cloth.geometry.spring_model import Floats
from taichi_cloth.scene.collider_schema import Capsule, Sphere
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Scene, Solver

BALL = Sphere(center=(0.0, 0.0, 0.0), radius=0.1, margin=0.02, friction=0.0, collide_with="triangles")
ONE = np.array([[0], [1], [2]])  # a triangle of the first three particles
COORDINATE = st.floats(-1.0, 1.0)


def level(*points: tuple[float, float], height: float = 0.11) -> Floats:
    """Return particles at a height, (3, N)."""
    return np.array([[x, height, z] for x, z in points]).T


def over_origin(weights: tuple[float, float, float]) -> Floats:
    """Return a level triangle whose point with these weights is above the origin."""
    corners = level((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
    shift = corners @ np.array(weights)
    shift[1] = 0.0
    return corners - shift[:, None]


@given(st.lists(COORDINATE, min_size=9, max_size=9), st.floats(0.0, 0.5))
def test_no_point_is_closer_than_the_closest(numbers: list[float], half: float) -> None:
    corners = np.array(numbers).reshape(3, 3, 1)
    if np.linalg.norm(np.cross(corners[1, :, 0] - corners[0, :, 0], corners[2, :, 0] - corners[0, :, 0])) < 1e-3:
        return
    weights, offset = closest_to_axis(corners, half)
    assert weights.sum() == pytest.approx(1.0)
    assert weights.min() >= -1e-12
    point = np.einsum("k,ki->i", weights[:, 0], corners[:, :, 0])
    found = np.linalg.norm(point - [0, np.clip(point[1], -half, half), 0])
    assert found == pytest.approx(float(np.linalg.norm(offset)), abs=1e-9)
    u, w = np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41))
    within = u + w <= 1
    sampled = np.stack([1 - u - w, u, w])[:, within].T @ corners[:, :, 0]
    off = sampled - np.stack([0 * sampled[:, 0], np.clip(sampled[:, 1], -half, half), 0 * sampled[:, 0]], axis=1)
    distances = np.linalg.norm(off, axis=1)
    pierced = _is_pierced(corners[:, :, 0], half)
    assert pierced or found <= distances.min() + 1e-9


def _is_pierced(corners: Floats, half: float) -> bool:
    """Return whether the axis passes through the triangle."""
    matrix = np.array([corners[1] - corners[0], corners[2] - corners[0], [0.0, -1.0, 0.0]]).T
    if abs(np.linalg.det(matrix)) < 1e-12:
        return True
    second, third, along = np.linalg.solve(matrix, -corners[0])
    return bool(second >= 0 and third >= 0 and second + third <= 1 and abs(along) <= half)


@pytest.mark.parametrize("weights", [(1 / 3, 1 / 3, 1 / 3), (0.6, 0.3, 0.1), (0.5, 0.5, 0.0), (0.0, 1.0, 0.0)])
@pytest.mark.parametrize("masses", [(1.0, 1.0, 1.0), (1.0, 2.0, 4.0)])
def test_the_point_stops_and_the_impulse_acts_at_it(
    weights: tuple[float, float, float], masses: tuple[float, float, float]
) -> None:
    """Momentum and angular momentum change as by one impulse at the point."""
    m, x = np.array(masses), over_origin(weights)
    before = np.array([[0.0, 0.0, 0.0], [-1.0, -2.0, -3.0], [0.0, 0.0, 0.0]])
    v = before.copy()
    assert TriangleContact(BALL, ONE, 1 / m).stop_approach(x, v, 0.0).tolist() == [0]
    assert v[1] @ weights == pytest.approx(0.0, abs=1e-12)
    momentum = m * (v - before)
    total = momentum.sum(axis=1)
    assert total[1] > 0
    assert total[[0, 2]] == pytest.approx([0.0, 0.0], abs=1e-12)
    point = x @ np.array(weights)
    assert np.cross(x.T, momentum.T).sum(axis=0) == pytest.approx(np.cross(point, total), abs=1e-12)


def test_receding_triangles_and_those_beyond_the_margin_keep_their_velocities() -> None:
    contact, upward = TriangleContact(BALL, ONE, np.ones(3)), np.outer([0.0, 1.0, 0.0], np.ones(3))
    v = upward.copy()
    contact.stop_approach(over_origin((0.2, 0.3, 0.5)), v, 0.0)
    assert v == pytest.approx(upward)
    v = -upward
    far = over_origin((0.2, 0.3, 0.5)) + np.array([[0.0], [0.011], [0.0]])
    assert len(contact.stop_approach(far, v, 0.0)) == 0
    assert v == pytest.approx(-upward)


@pytest.mark.parametrize(("friction", "left"), [(0.0, 2.0), (0.5, 1.5), (3.0, 0.0)])
def test_friction_is_limited_by_the_normal_impulse_and_the_sliding_velocity(friction: float, left: float) -> None:
    v = np.outer([2.0, -1.0, 0.0], np.ones(3))
    third = over_origin((1 / 3, 1 / 3, 1 / 3))
    TriangleContact(replace(BALL, friction=friction), ONE, np.ones(3)).stop_approach(third, v, 0.0)
    assert v == pytest.approx(np.outer([left, 0.0, 0.0], np.ones(3)), abs=1e-12)


def test_triangles_that_share_corners_all_stop() -> None:
    """A fan of four triangles around a particle above the ball moves down, its tips faster: no point keeps moving."""
    x = level((0.01, 0.0), (0.2, 0.2), (0.2, -0.2), (-0.2, -0.2), (-0.2, 0.2))
    fan = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]]).T
    v = np.array([[0.0] * 5, [-1.0, -3.0, -2.0, -4.0, -2.5], [0.0] * 5])
    contact = TriangleContact(BALL, fan, np.array([1.0, 2.0, 1.0, 3.0, 1.0]))
    within = contact.stop_approach(x, v, 0.0)
    assert len(within) == 4
    for corners in fan.T:
        weights, offset = closest_to_axis(x[:, corners].T[:, :, None], 0.0)
        assert (v[:, corners] @ weights[:, 0]) @ offset[:, 0] >= -1e-12
    contact.project(x, 0.0, within)
    distances = [np.linalg.norm(closest_to_axis(x[:, corners].T[:, :, None], 0.0)[1]) for corners in fan.T]
    assert min(distances) == pytest.approx(0.12, abs=1e-9)


def test_corners_that_are_not_free_do_not_move() -> None:
    v = np.outer([0.0, -1.0, 0.0], np.ones(3))
    TriangleContact(BALL, ONE, np.array([0.0, 1.0, 0.0])).stop_approach(over_origin((0.2, 0.5, 0.3)), v, 0.0)
    assert v[1].tolist() == [-1.0, pytest.approx(1.0), -1.0]
    v = np.outer([0.0, -1.0, 0.0], np.ones(3))
    TriangleContact(BALL, ONE, np.zeros(3)).stop_approach(over_origin((0.2, 0.5, 0.3)), v, 0.0)
    assert (v[1] == -1.0).all()


def test_a_ball_smaller_than_a_cell_supports_a_sheet_that_falls_on_it() -> None:
    """A square of one cell, centered above the ball: no triangle is closer than the margin, and one lies on it."""
    square = Cloth(
        rows=2, columns=2, width=0.5, height=0.5, center=(0.0, 0.3, 0.0), rotation=(-90.0, 0.0, 0.0), pins=()
    )
    fabric = Fabric(warp=500.0, weft=500.0, shear=500.0, bend_spring=0.0)
    scene = Scene(cloth=square, fabric=fabric, solver=Solver(damping=1.0), spheres=(BALL,))
    assert not obstacles_of(scene)
    run = Motion(scene, 100)
    gaps = []
    for _ in range(30):
        corners = run.step_frame()[run._model.topology.triangles]
        gaps.append(np.linalg.norm(closest_to_axis(corners.transpose(1, 2, 0), 0.0)[1], axis=0).min())
    assert min(gaps) == pytest.approx(0.12, abs=1e-9)
    assert max(gaps[20:]) < 0.13
    through = Motion(replace(scene, spheres=(replace(BALL, collide_with="particles"),)), 100)
    assert min(through.step_frame()[:, 1].mean() for _ in range(30)) < -0.5


def test_the_tip_of_a_capsule_acts_as_a_ball() -> None:
    pole = Capsule(center=(0.0, -0.5, 0.0), length=1.0, radius=0.1, margin=0.02, friction=0.0, collide_with="triangles")
    x, fall = over_origin((0.2, 0.3, 0.5)), np.outer([0.3, -1.0, 0.2], np.ones(3))
    by_ball, by_pole = fall.copy(), fall.copy()
    TriangleContact(BALL, ONE, np.ones(3)).stop_approach(x, by_ball, 0.0)
    TriangleContact(pole, ONE, np.ones(3)).stop_approach(x, by_pole, 0.0)
    assert by_pole == pytest.approx(by_ball, abs=1e-12)
    assert (by_pole != fall).any()


def test_the_motion_of_the_collider_counts() -> None:
    """A ball that rises at 1 m/s lifts a triangle at rest."""
    rising = replace(BALL, keyframes=((0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 1.0, 0.0)))
    v = np.zeros((3, 3))
    x = over_origin((1 / 3, 1 / 3, 1 / 3)) + np.array([[0.0], [0.5], [0.0]])
    TriangleContact(rising, ONE, np.ones(3)).stop_approach(x, v, 0.5)
    assert v == pytest.approx(np.outer([0.0, 1.0, 0.0], np.ones(3)), abs=1e-9)
