"""The motion of a body within a frame, as kernels read it from the collider table."""

import numpy as np
import pytest
import taichi as ti

from taichi_cloth.collision.colliders import collider_table, pose, rotation_vector_between
from taichi_cloth.kernels.integration import motion_at, pose_at
from taichi_cloth.kernels.step_params import collider_array
from taichi_cloth.scene.collider_schema import Attachment, Box, Collider, Motion

FRAME = 1 / 60
ORIGIN = (0.3, -0.2, 0.1)
WAVED = {"oscillation": (0.3, 0.0, 0.2), "rocking": (0.0, 10.0, 20.0), "period": (0.4, 0.5, 0.6)}
BODIES = [Box(size=(0.2, 0.4, 0.6), rotation=(20.0, 40.0, 0.0), **WAVED), Attachment(pins=("top",), **WAVED)]


@ti.kernel
def read_motion(table: collider_array, fraction: float, found: ti.types.ndarray(dtype=ti.f32, ndim=1)):
    center, axes = pose_at(table, 0, fraction)
    travel, rotation = motion_at(table, 0, fraction)
    for k in ti.static(range(3)):
        found[k], found[12 + k], found[15 + k] = center[k], travel[k], rotation[k]
        for column in ti.static(range(3)):
            found[3 + 3 * k + column] = axes[k, column]


def motion(body: Motion, start: float, fraction: float) -> tuple[np.ndarray, ...]:
    """Return center [m], axes, and linear [m] and angular [rad] velocity per frame, as kernels compute them."""
    found = np.zeros(18, np.float32)
    read_motion(collider_table([body], start, start + FRAME, origin=ORIGIN), fraction, found)
    return found[:3] + ORIGIN, found[3:12].reshape(3, 3), found[12:15], found[15:]


def exact_motion(body: Motion, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return linear [m] and angular [rad] velocity per frame, as central differences of the pose."""
    step = 1e-4 * FRAME
    (before, axes_before), (after, axes_after) = pose(body, seconds - step), pose(body, seconds + step)
    return (after - before) / 2e-4, rotation_vector_between(axes_before, axes_after) / 2e-4


@pytest.mark.parametrize("body", BODIES, ids=["collider", "attachment"])
@pytest.mark.parametrize("fraction", [0.0, 0.25, 0.5, 0.8, 1.0])
def test_a_body_follows_its_curve_within_a_frame(body: Motion, fraction: float) -> None:
    """The error is of third order: ω³Δt³·A/125 = 5e-5 m at most for the fastest wave, and 2.6e-3 m on a chord."""
    start = 0.4
    center, axes, travel, rotation = motion(body, start, fraction)
    exact_center, exact_axes = pose(body, start + fraction * FRAME)
    assert center == pytest.approx(exact_center, abs=1e-4)
    assert np.linalg.norm(rotation_vector_between(exact_axes, axes)) < 2e-4
    exact_travel, exact_rotation = exact_motion(body, start + fraction * FRAME)
    assert travel == pytest.approx(exact_travel, abs=2e-3)
    if isinstance(body, Collider):
        assert rotation == pytest.approx(exact_rotation, abs=2e-3)


@pytest.mark.parametrize("fraction", [0.0, 0.4, 1.0])
def test_even_motion_stays_even(fraction: float) -> None:
    keyframes = ((0.0, 0.0, 0.0, 0.0), (1.0, 0.3, 0.0, 0.6))
    body = Box(center=(0.0, 0.0, 0.0), size=(0.2, 0.2, 0.2), spin=(0.0, 90.0, 0.0), keyframes=keyframes)
    center, _, travel, rotation = motion(body, 0.5, fraction)
    assert center == pytest.approx(np.array([0.3, 0.0, 0.6]) * (0.5 + fraction * FRAME), abs=1e-6)
    assert travel == pytest.approx(np.array([0.3, 0.0, 0.6]) * FRAME, abs=1e-6)
    assert rotation == pytest.approx([0.0, np.radians(90.0) * FRAME, 0.0], abs=1e-6)


def test_a_body_that_teleports_does_not_move_within_the_frame() -> None:
    body = Box(size=(0.2, 0.2, 0.2), **WAVED, keyframes=((0.4, 0, 0, 0), (0.41, 50.0, 0, 0)))
    for fraction in (0.0, 0.5):
        center, _, travel, _ = motion(body, 0.4, fraction)
        assert center == pytest.approx(pose(body, 0.4 + FRAME)[0], abs=1e-5)
        assert travel == pytest.approx(np.zeros(3), abs=1e-6)
