"""Where a body or a grip is at a time, and how it moves, from the keys of `[[grips]]` and of colliders, in float64.

The motion is that of the keys at every moment: no straight ways between frames.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..scene.model import Collider, Ground, Motion
from .springs import Floats

INSTANT = 1e-5  # [s] half of the time over which velocities are taken


class Pose(NamedTuple):
    """A body at one time."""

    center: Floats  # [m] (3,)
    axes: Floats  # (3, 3) its own axes as columns
    velocity: Floats  # [m/s] (3,) of its center
    spin: Floats  # [1/s] (3,) angular velocity

    def local(self, x: Floats) -> Floats:
        """Places (3, M) along its own axes, from its center."""
        return self.axes.T @ (x - self.center[:, None])

    def surface_velocity(self, x: Floats) -> Floats:
        """Of its material at places (3, M) [m/s], (3, M)."""
        return self.velocity[:, None] + cross(self.spin, x - self.center[:, None])


def cross(spin: Floats, arm: Floats) -> Floats:
    """spin × arm for (3,) and (3, M)."""
    return np.stack(
        [
            spin[1] * arm[2] - spin[2] * arm[1],
            spin[2] * arm[0] - spin[0] * arm[2],
            spin[0] * arm[1] - spin[1] * arm[0],
        ]
    )


def euler(degrees: Floats) -> Floats:
    """Rotation about x, then y, then z, (3, 3)."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    found: Floats = about_z @ about_y @ about_x
    return found


def about(vector: Floats) -> Floats:
    """Rotation about a vector by its length [radians], (3, 3)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    found: Floats = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)
    return found


def is_still(body: Motion | Ground) -> bool:
    """Whether it never moves."""
    return isinstance(body, Ground) or not (any(body.sway) or any(body.rock) or any(body.spin) or body.path)


def placed(body: Motion | Ground, seconds: float) -> tuple[Floats, Floats]:
    """Center [m] and axes at a time."""
    if isinstance(body, Ground):
        return np.array([0.0, body.height, 0.0]), np.eye(3)
    wave = np.sin(2 * np.pi * seconds / np.array(body.period) + np.radians(body.phase))
    center = np.array(body.center) + np.array(body.sway) * wave
    axes = euler(np.array(body.rock) * wave) if any(body.rock) else np.eye(3)
    if isinstance(body, Collider) and any(body.rotation):
        axes = axes @ euler(np.array(body.rotation))
    if body.path:
        times, moved = [row[0] for row in body.path], np.array([(*row[1:], 0.0, 0.0, 0.0)[:6] for row in body.path])
        offset = np.array([np.interp(seconds, times, column) for column in moved.T])
        center, axes = center + offset[:3], euler(offset[3:]) @ axes
    return center, about(np.radians(body.spin) * seconds) @ axes


@lru_cache(maxsize=64)  # every body is asked for several times in a step
def pose(body: Motion | Ground, seconds: float) -> Pose:
    """All of it, for reading only; velocities by central differences."""
    center, axes = placed(body, seconds)
    if is_still(body):
        return Pose(center, axes, np.zeros(3), np.zeros(3))
    (before, turned_before), (after, turned_after) = (placed(body, seconds + t) for t in (-INSTANT, INSTANT))
    turn = turned_after @ turned_before.T
    spin = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    return Pose(center, axes, (after - before) / (2 * INSTANT), spin / (2 * INSTANT))
