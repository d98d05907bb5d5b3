"""Picking the particle under the cursor, and dragging it on a plane parallel to the image."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from taichi_cloth.render.camera import OrbitCamera
from taichi_cloth.viewer.dragging import TOLERANCE, DragPlane, pick_particle

SIZE = (1280, 720)
ASPECT = SIZE[0] / SIZE[1]
FRONT = OrbitCamera((0, 0, 6), (0, 0, 0), 40)

Floats = NDArray[np.float64]


def sheet(count: int = 11, side: float = 2.0) -> tuple[Floats, NDArray[np.int64]]:
    """Return a square of count × count particles in the plane z = 0, and its triangles."""
    ticks = np.linspace(-side / 2, side / 2, count)
    x, y = np.meshgrid(ticks, -ticks)
    corner = np.arange(count * count).reshape(count, count)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]))
    triangles = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1), triangles


def moved(positions: Floats, z: float) -> Floats:
    """Return the sheet moved toward the eye of `FRONT`."""
    return positions + np.array([0, 0, z])


def cursor_at(camera: OrbitCamera, point: Floats) -> tuple[float, float]:
    u, v = camera.to_screen(point, ASPECT)[0][0]
    return float(u), float(v)


@given(st.integers(0, 120), st.floats(-0.09, 0.09), st.floats(-0.09, 0.09))
def test_the_triangle_corner_nearest_to_the_hit_is_picked(index: int, right: float, up: float) -> None:
    positions, triangles = sheet()
    press = np.clip(positions[index] + (right, up, 0), -0.999, 0.999) * (1, 1, 0)
    picked = pick_particle(FRONT, cursor_at(FRONT, press), SIZE, positions, triangles)
    assert picked is not None
    assert picked.point == pytest.approx(tuple(press), abs=1e-9)
    cell = 2 / 10
    assert np.linalg.norm(positions[picked.index] - press) <= cell / np.sqrt(2) + 1e-9
    assert picked.depth == pytest.approx(6)


def test_the_nearer_of_two_layers_is_picked() -> None:
    positions, triangles = sheet()
    both = np.concatenate([positions, moved(positions, 1)])
    layers = np.concatenate([triangles, triangles + len(positions)])
    picked = pick_particle(FRONT, (0.5, 0.5), SIZE, both, layers)
    assert picked is not None
    assert picked.index == len(positions) + 60
    assert picked.depth == pytest.approx(5)


def test_nothing_is_picked_beside_the_cloth_or_behind_the_eye() -> None:
    positions, triangles = sheet()
    assert pick_particle(FRONT, (0.02, 0.9), SIZE, positions, triangles) is None
    assert pick_particle(FRONT, (0.5, 0.5), SIZE, moved(positions, 12), triangles) is None


@pytest.mark.parametrize(("pixels", "found"), [(0.0, True), (0.9 * TOLERANCE, True), (1.2 * TOLERANCE, False)])
def test_a_sheet_seen_edge_on_is_picked_within_the_tolerance(pixels: float, found: bool) -> None:
    positions, triangles = sheet()
    camera = OrbitCamera((6, 0, 0), (0, 0, 0), 40)
    u, v = cursor_at(camera, positions[60])
    picked = pick_particle(camera, (u + pixels / SIZE[0], v), SIZE, positions, triangles)
    assert (picked is not None) is found
    if picked is not None:
        assert positions[picked.index][1] == pytest.approx(0)  # of the row under the cursor
        assert picked.point == pytest.approx(tuple(positions[picked.index]))


def sphere_distance(origin: Floats, direction: Floats) -> float:
    """Return the distance along a ray to a sphere of radius 0.5 m, 2 m in front of the sheet; inf if it misses."""
    offset = origin - [0.0, 0.0, 2.0]
    along = float(offset @ direction)
    inside = along**2 - float(offset @ offset) + 0.25
    return -along - float(np.sqrt(inside)) if inside >= 0 else np.inf


def test_a_collider_hides_the_cloth_behind_it() -> None:
    positions, triangles = sheet()
    in_front, beside = moved(positions, 3), cursor_at(FRONT, positions[0])
    assert pick_particle(FRONT, (0.5, 0.5), SIZE, positions, triangles, sphere_distance) is None
    assert pick_particle(FRONT, (0.5, 0.5), SIZE, in_front, triangles, sphere_distance) is not None
    assert pick_particle(FRONT, beside, SIZE, positions, triangles, sphere_distance) is not None


def test_a_collider_hides_particles_without_triangles() -> None:
    positions, _ = sheet(count=11)
    no_triangles = np.zeros((0, 3), np.int64)
    assert pick_particle(FRONT, (0.5, 0.5), SIZE, positions, no_triangles) is not None
    assert pick_particle(FRONT, (0.5, 0.5), SIZE, positions, no_triangles, sphere_distance) is None


cursors = st.tuples(st.floats(0, 1), st.floats(0, 1))


@given(cursors, cursors, st.floats(-3, 3), st.floats(-0.4, 0.4))
def test_a_dragged_particle_keeps_its_depth_and_its_offset_from_the_cursor(
    start: tuple[float, float], end: tuple[float, float], turn: float, tilt: float
) -> None:
    camera = OrbitCamera((0, 0, 6), (0, 0, 0), 40)
    camera.orbit(turn, tilt)
    particle = np.array([0.3, -0.2, 0.5])
    plane = DragPlane(camera, start, ASPECT, particle)
    assert plane.move(camera, start, ASPECT) == pytest.approx(particle, abs=1e-9)  # no jump

    before, depth = camera.to_screen(particle, ASPECT)
    after, depth_after = camera.to_screen(plane.move(camera, end, ASPECT), ASPECT)
    assert depth_after == pytest.approx(depth, abs=1e-9)
    assert after - before == pytest.approx(np.array([np.subtract(end, start)]), abs=1e-9)


def test_the_target_stays_when_the_camera_turns_away_from_the_plane() -> None:
    camera = OrbitCamera((0, 0, 6), (0, 0, 0), 40)
    plane = DragPlane(camera, (0.5, 0.5), ASPECT, (0.0, 0.0, 0.0))
    away = OrbitCamera((0, 0, 6), (0, 0, 12), 40)
    assert plane.move(away, (0.7, 0.5), ASPECT) == pytest.approx([0, 0, 0])
