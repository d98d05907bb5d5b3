"""The orbit camera against closed forms, and round trips between points and rays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import exp, pi, radians, sqrt, tan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from taichi_cloth.geometry.cloth_builder import build_particles
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.render.camera import (
    FAR,
    FLOOR_CLEARANCE,
    MAX_ELEVATION,
    MAX_ZOOM_LEVEL,
    NEAR,
    ZOOM_STEP,
    OrbitCamera,
    camera_of,
    floor_height,
)
from taichi_cloth.render.webgl import min_aspect
from taichi_cloth.scene.collider_schema import Ground, Mesh, Sphere
from taichi_cloth.scene.schema import Camera, Cloth, Scene

numbers = st.floats(-50, 50)
points = st.tuples(numbers, numbers, numbers)
shares = st.floats(0, 1)
aspects = st.floats(0.3, 3)


@st.composite
def cameras(draw: st.DrawFn) -> OrbitCamera:
    eye, target = draw(points), draw(points)
    camera = OrbitCamera(eye, target, draw(st.floats(10, 110)))
    camera.orbit(draw(numbers), draw(numbers))
    camera.zoom(draw(st.floats(-5, 5)))
    return camera


def front_camera() -> OrbitCamera:
    return OrbitCamera((0, 1, 5), (0, 1, 0), 60)


def test_a_front_camera_has_x_to_the_right_and_y_up() -> None:
    camera, aspect = front_camera(), 2.0
    half = 5 * tan(radians(30))  # half the height of the image at the target
    uv, depth = camera.to_screen([(0, 1, 0), (half * aspect, 1, 0), (0, 1 + half, 0), (0, 1, 2)], aspect)
    assert uv == pytest.approx(np.array([(0.5, 0.5), (1, 0.5), (0.5, 1), (0.5, 0.5)]))
    assert depth == pytest.approx([5, 5, 5, 3])


def test_clip_planes_follow_the_opengl_convention() -> None:
    projection = front_camera().projection(1.5)
    near, far = projection @ (0, 0, -NEAR, 1), projection @ (0, 0, -FAR, 1)
    assert near[2:] == pytest.approx([-NEAR, NEAR])
    assert far[2:] == pytest.approx([FAR, FAR])


@given(cameras())
def test_the_view_matrix_is_rigid_and_maps_the_eye_to_the_origin(camera: OrbitCamera) -> None:
    view = camera.view()
    assert view[:3, :3] @ view[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(view) == pytest.approx(1)
    assert view @ (*camera.eye, 1) == pytest.approx([0, 0, 0, 1], abs=1e-9)
    assert view @ (*camera.target, 1) == pytest.approx([0, 0, -camera.distance, 1], abs=1e-9)


@given(cameras(), shares, shares, aspects, st.floats(1, 100))
def test_a_point_on_a_ray_projects_to_the_screen_point_of_the_ray(
    camera: OrbitCamera, u: float, v: float, aspect: float, reach: float
) -> None:
    origin, direction = camera.ray(u, v, aspect)
    assert np.linalg.norm(direction) == pytest.approx(1)
    uv, depth = camera.to_screen(origin + reach * direction, aspect)
    assert uv[0] == pytest.approx([u, v], abs=1e-9)
    assert 0 < depth[0] <= reach * (1 + 1e-9)


def test_a_point_behind_the_eye_has_no_screen_point() -> None:
    uv, depth = front_camera().to_screen([(0, 1, 6), (0, 1, 0)], 1.0)
    assert np.isnan(uv[0]).all()
    assert depth[0] == pytest.approx(-1)
    assert uv[1] == pytest.approx([0.5, 0.5])


def test_an_orbit_by_one_height_turns_by_half_a_turn() -> None:
    camera = front_camera()
    camera.orbit(1, 0)
    assert camera.eye == pytest.approx((0, 1, -5))


def test_an_orbit_moves_the_near_side_with_the_cursor() -> None:
    camera = front_camera()
    near_side = [(0, 1, 1)]
    camera.orbit(0.1, 0.05)
    (u, v), *_ = camera.to_screen(near_side, 1.0)[0]
    assert u > 0.5
    assert v > 0.5


@given(numbers, numbers)
def test_the_elevation_is_limited_so_that_up_stays_up(right: float, up: float) -> None:
    camera = front_camera()
    camera.orbit(right, up)
    assert abs(camera.elevation) <= MAX_ELEVATION
    assert camera.view()[1, 1] > 0  # up stays up


@pytest.mark.parametrize("eye", [(0, 6, 0), (0, -4, 0), (0, 1, 0)])
def test_an_eye_straight_above_or_at_the_target_gives_a_finite_projection(eye: tuple[float, float, float]) -> None:
    camera = OrbitCamera(eye, (0, 1, 0), 40)
    assert np.isfinite(camera.view_projection(1.5)).all()
    assert camera.to_screen([(0, 1, 0)], 1.5)[0] == pytest.approx(np.array([(0.5, 0.5)]))


def test_zoom_is_exponential_and_limited() -> None:
    camera = front_camera()
    camera.zoom(3)
    camera.zoom(-1)
    once = front_camera()
    once.zoom(2)
    assert camera.distance == pytest.approx(once.distance)
    camera.zoom(1e6)
    assert camera.distance == pytest.approx(5 * exp(-ZOOM_STEP * MAX_ZOOM_LEVEL))
    camera.zoom(-1e6)
    assert camera.distance == pytest.approx(5 * exp(ZOOM_STEP * MAX_ZOOM_LEVEL))


def test_zoom_ends_where_it_is_told_to_and_moves_no_closer_eye_back() -> None:
    camera = front_camera()
    camera.zoom(1.0, nearest=4.9)
    assert camera.distance == pytest.approx(4.9)
    camera.zoom(1.0, nearest=6.0)
    assert camera.distance == pytest.approx(4.9)
    camera.zoom(-1.0, nearest=6.0)
    assert camera.distance == pytest.approx(4.9 * exp(ZOOM_STEP))


@given(cameras(), st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), aspects)
def test_pan_moves_the_old_target_by_that_fraction_of_the_image(
    camera: OrbitCamera, right: float, up: float, aspect: float
) -> None:
    before = camera.target
    camera.pan(right, up)
    uv, depth = camera.to_screen(before, aspect)
    assert uv[0] == pytest.approx([0.5 - right / aspect, 0.5 - up], abs=1e-6)
    assert depth[0] == pytest.approx(camera.distance)


def test_many_small_moves_equal_one_large_move() -> None:
    slow, fast = front_camera(), front_camera()
    for _ in range(100):
        slow.orbit(0.002, 0.001)
        slow.zoom(0.03)
    fast.orbit(0.2, 0.1)
    fast.zoom(3)
    assert slow.eye == pytest.approx(fast.eye)


@given(cameras())
def test_reset_restores_the_first_view(camera: OrbitCamera) -> None:
    camera.reset()
    first = camera.view_projection(1.5)
    camera.orbit(0.3, 0.2)
    camera.zoom(4)
    camera.pan(0.1, 0.1)
    camera.reset()
    assert (camera.view_projection(1.5) == first).all()


@given(st.floats(-5, 1), st.lists(st.tuples(numbers, numbers, st.floats(-5, 5)), max_size=4))
def test_the_eye_stays_above_the_floor(floor: float, moves: list[tuple[float, float, float]]) -> None:
    camera = OrbitCamera((0, 2, 5), (0, 1.2, 0), 60, floor)
    for right, up, zoom in moves:
        camera.orbit(right, up)
        assert camera.eye[1] > floor
        camera.zoom(zoom)
        assert camera.eye[1] > floor
        camera.pan(right, up)
        assert camera.eye[1] > floor


def test_a_camera_above_a_floor_turns_freely_where_it_does_not_reach_it() -> None:
    with_floor, without = OrbitCamera((0, 1, 5), (0, 1, 0), 60, -9.0), front_camera()
    for camera in (with_floor, without):
        camera.orbit(0.3, 0.4)
        camera.pan(0.1, -0.2)
    assert with_floor.eye == without.eye
    low = OrbitCamera((0, 1, 5), (0, 1, 0), 60, 0.0)
    low.orbit(0.0, 0.4)
    assert low.eye[1] == pytest.approx(FLOOR_CLEARANCE * 5)


def test_the_floor_of_a_scene_is_its_ground() -> None:
    assert floor_height(Scene(ground=Ground(height=0.3))) == 0.3
    assert floor_height(Scene()) == -np.inf


def test_azimuth_and_elevation_of_a_known_eye() -> None:
    camera = OrbitCamera((1, sqrt(2), 1), (0, 0, 0), 40)
    assert camera.azimuth == pytest.approx(pi / 4)
    assert camera.elevation == pytest.approx(pi / 4)
    assert camera.eye == pytest.approx((1, sqrt(2), 1))


@given(cameras(), st.floats(-0.5, 0.5), aspects)
def test_view_shift_moves_the_target_on_the_screen_and_centers_look_at(
    camera: OrbitCamera, shift: float, aspect: float
) -> None:
    camera.view_shift = shift
    camera.orbit(0.3, 0.1)
    uv, depth = camera.to_screen(np.array([camera.target, camera.look_at]), aspect)
    assert uv == pytest.approx(np.array([(0.5 + shift / aspect, 0.5), (0.5, 0.5)]), abs=1e-6)
    assert depth == pytest.approx([camera.distance, camera.distance])


@pytest.mark.parametrize(("aspect", "covered"), [(0.5, 0.0), (1.0, 0.0), (1.8, 0.0), (1.8, 0.6)])
def test_points_outside_the_picture_are_included(aspect: float, covered: float) -> None:
    camera = OrbitCamera((0.0, 1.0, 3.0), (0.0, 1.0, 0.0), 40.0, floor=0.0)
    camera.view_shift = covered / 2  # by a panel at the left, of this width [image heights]
    inside = np.array([[0.0, 1.0, 0.0], [0.1, 1.1, 0.0]])
    before = camera.eye
    camera.include(inside, aspect)
    assert camera.eye == before
    outside = np.random.default_rng(0).uniform((-4, 1, -9), (2, 5, 6), (50, 3))  # some behind the eye
    camera.include(outside, aspect)
    uv, _ = camera.to_screen(outside, aspect)
    uv[:, 0] = (uv[:, 0] * aspect - covered) / (aspect - covered)
    assert ((uv >= 0) & (uv <= 1)).all()
    assert np.ptp(uv, axis=0).max() > 0.4, "too far away"
    camera.reset()
    assert camera.eye == pytest.approx(before)


def test_a_cloth_under_the_panel_is_not_in_the_picture() -> None:
    camera = OrbitCamera((0.0, 1.0, 3.0), (0.0, 1.0, 0.0), 40.0)
    camera.view_shift = 0.3
    eye, half_height = camera.eye, 3.0 * np.tan(np.radians(20.0))
    beside, covered = [[1.15 * half_height, 1.0, 0.0]], [[-1.25 * half_height, 1.0, 0.0]]  # the area is ±1.2 wide
    camera.include(beside, 1.8)
    assert camera.eye == eye
    camera.include(covered, 1.8)
    assert camera.eye != eye


def test_a_camera_moves_back_by_at_most_a_quarter_for_a_wide_cloth() -> None:
    camera = OrbitCamera((0.0, 1.0, 3.0), (0.0, 1.0, 0.0), 40.0)
    camera.view_shift = 0.3
    half_width = 1.2 * 3.0 * np.tan(np.radians(20.0))  # [m] of the area beside the panel
    tall = [[0.9 * half_width, 5.0, 0.0], [-0.9 * half_width, 1.0, 0.0]]
    camera.fit_width(tall, 1.8)
    assert camera.distance == 3.0
    wide = [[1.1 * half_width, 1.0, 0.0], [-1.1 * half_width, 1.0, 0.0]]
    camera.fit_width(wide, 1.8)
    assert 1.1 * 3.0 <= camera.distance < 1.1 * 3.0 * 1.02
    assert camera.target == pytest.approx([0.0, 1.0, 0.0])
    camera.reset()
    camera.fit_width([[9.0 * half_width, 1.0, 0.0]], 1.8)
    assert camera.distance == pytest.approx(1.25 * 3.0)


def test_a_camera_moves_back_without_a_jump_as_cloth_leaves_the_picture() -> None:
    """The eye is 3 m away, and sees 1.09 m above and below the target: that stays in the picture."""
    seen = 3.0 * np.tan(np.radians(20.0))
    depths = seen * np.linspace(0.9, 5.5, 93)
    distances, heights = [], []
    for depth in depths:
        camera = OrbitCamera((0.0, 1.0, 3.0), (0.0, 1.0, 0.0), 40.0)
        camera.move_back([[0.0, 1.0, 0.0], [0.1, 1.0 - depth, 0.0]], 1.8)
        distances.append(camera.distance)
        heights.append(float(camera.target[1]))
        uv, _ = camera.to_screen([[0.1, 1.0 - depth, 0.0], [0.0, 1.0 + seen, 0.0]], 1.8)
        assert 0.0 <= uv[0, 1] < uv[1, 1] <= 1.0 + 1e-9
    lower = 1.25 * np.maximum(depths - seen, 0.0)
    assert distances == pytest.approx(3.0 * (1 + lower / 2 / seen))
    assert heights == pytest.approx(1.0 - lower / 2)
    far = OrbitCamera((0.0, 1.0, 3.0), (0.0, 1.0, 0.0), 40.0)
    far.move_back([[0.0, -20.0, 0.0], [0.1, -21.0, 0.0]], 1.8)
    assert far.distance < 3.0
    assert far.target[1] == pytest.approx(-20.5)


def test_a_camera_that_moves_back_sees_what_is_nearer_and_stays_above_the_floor() -> None:
    wide = OrbitCamera((0.0, 1.0, 3.0), (0.0, 1.0, 0.0), 40.0)
    point = [[3.0, 1.2, 1.0]]
    wide.move_back(point, 1.8)
    uv, _ = wide.to_screen(point, 1.8)
    assert 0.7 < uv[0, 0] < 1.0
    low = OrbitCamera((0.0, 0.1, 3.0), (0.0, 1.0, 0.0), 40.0, floor=0.0)
    low.move_back([[0.0, 5.0, 0.0]], 1.8)
    assert low.eye[1] > 0.0


@pytest.mark.parametrize("frame", [OrbitCamera.include, OrbitCamera.fit_width, OrbitCamera.move_back])
def test_zoom_counts_from_the_framed_view(frame: Callable[[OrbitCamera, ArrayLike, float], None]) -> None:
    camera = OrbitCamera((0.0, 1.0, 3.0), (0.0, 1.0, 0.0), 40.0)
    frame(camera, [[-90.0, 1.0, 0.0], [90.0, 1.0, 0.0]], 1.8)
    framed = camera.distance
    assert framed > 3.0
    assert camera.zoom_level == 0.0
    camera.zoom(0.0)
    assert camera.distance == pytest.approx(framed), "the limits of the zoom are those of another view"
    camera.zoom(2.0)
    assert camera.zoom_level == pytest.approx(2.0)
    camera.reset()
    assert camera.zoom_level == 0.0


def test_a_scene_without_a_camera_frames_the_colliders_near_its_cloth() -> None:
    cloth = Cloth(rows=9, columns=9, width=1.0, height=1.0, center=(0.0, 1.0, 0.0))
    near, huge, far = (
        Sphere(center=(0.0, 0.2, 0.0), radius=0.3, margin=0.15, friction=0.0),
        Sphere(radius=50.0, margin=0.15, friction=0.0),
        Sphere(center=(0.0, 9.0, 0.0), margin=0.15, friction=0.0),
    )
    alone = camera_of(Scene(cloth=cloth))
    assert camera_of(Scene(cloth=cloth, spheres=(huge, far))) == alone
    bowl = Mesh(center=(0.0, 0.2, 0.0), margin=0.15)
    small = camera_of(Scene(cloth=cloth, meshes=(bowl,)))
    assert small.target[1] < alone.target[1]
    assert camera_of(Scene(cloth=cloth, meshes=(replace(bowl, scale=50.0),))) == alone
    camera = OrbitCamera.from_scene(Scene(cloth=cloth, spheres=(near,)))
    uv, _ = camera.to_screen(np.array([[0.0, -0.1, 0.0], [0.3, 0.2, 0.0], [0.5, 1.5, 0.0]]), 1.0)
    assert ((uv > 0) & (uv < 1)).all()


@pytest.mark.parametrize("size", [0.1, 1.0, 30.0])
def test_a_scene_without_a_camera_frames_its_cloth(size: float) -> None:
    cloth = Cloth(rows=9, columns=9, width=size, height=size, center=(3.0, 40.0, -2.0))
    camera = OrbitCamera.from_scene(Scene(cloth=cloth))
    corners = build_particles(Scene(cloth=cloth)).start
    for aspect in (1.0, 1.8):
        uv, _ = camera.to_screen(corners, aspect)
        assert ((uv > 0) & (uv < 1)).all()
        assert np.ptp(uv[:, 1]) > 0.5
    own = Camera(eye=(1.0, 2.0, 3.0))
    assert camera_of(Scene(cloth=cloth, camera=own)) == own


@pytest.mark.parametrize(
    ("name", "least", "most"), [("curtain", 1.15, 1.15), ("twist", 1.35, 1.43), ("banner", 1.4375, 1.4375)]
)
def test_pages_show_the_width_of_the_cloth_within_limits(name: str, least: float, most: float) -> None:
    """Also where panels cover both sides of a page; a cloth that is much wider than high would be small."""
    scene = load_scene(name)
    start = build_particles(scene).start
    aspect = min_aspect(scene, start)
    assert least <= aspect <= most
    u = OrbitCamera.from_scene(scene).to_screen(start, aspect)[0][:, 0]
    assert bool((np.abs(u - 0.5) < 0.5).all()) is (name != "banner")


def test_particles_behind_the_eye_do_not_count() -> None:
    scene = load_scene("curtain")
    start = build_particles(scene).start
    behind = np.array(scene.camera.eye) + [0.5, 0.0, 5.0]
    assert min_aspect(scene, np.concatenate([start, [behind]])) == min_aspect(scene, start)
