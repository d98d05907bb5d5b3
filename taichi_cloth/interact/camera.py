"""A camera that circles a target. Matrices act on columns: clip = projection @ view @ (x, y, z, 1).

Eye space has x right, y up and looks down −z, so that clip w is the distance along the view axis [m].
A *screen point* (u, v) runs from (0, 0) at the bottom left of the picture to (1, 1), as GGUI's cursor does.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import asin, atan2, cos, exp, hypot, log, pi, radians, sin, tan

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..scene.model import Camera as SceneCamera

NEAR, FAR = 0.1, 1000.0  # [m] clip planes, GGUI's own
STEEPEST = radians(89)  # short of the poles, where "up" has no direction
ZOOM_STEP = 0.1  # a step brings the eye nearer by this share
ZOOM_REACH = 20.0  # zooming may change the first distance by this factor either way

Floats = NDArray[np.float64]
Vec3 = tuple[float, float, float]


class OrbitCamera:
    """Looks at `target` from `distance` [m] at `azimuth` (0 on +z, growing towards +x) and `elevation` [radians]."""

    def __init__(self, eye: Sequence[float], target: Sequence[float], fov_degrees: float) -> None:
        """`fov_degrees` is the height of the picture as an angle. An eye on top of the target moves off it."""
        self.fov = radians(fov_degrees)
        self.shift = 0.0  # [heights of the picture] the target is shown this far to the right of the middle
        self._first_target = np.array(target, np.float64)
        x, y, z = np.asarray(eye, np.float64) - self._first_target
        self._first_distance = max(hypot(x, y, z), NEAR)
        self._first_azimuth = atan2(x, z)
        self._first_elevation = _steep(asin(y / self._first_distance))
        self.reset()

    @classmethod
    def from_scene(cls, camera: SceneCamera) -> OrbitCamera:
        """The camera a scene file asks for."""
        return cls(camera.eye, camera.target, camera.fov)

    def reset(self) -> None:
        """Back to where it began."""
        self.target = self._first_target.copy()
        self.distance = self._first_distance
        self.azimuth = self._first_azimuth
        self.elevation = self._first_elevation

    # -- moving: by amounts, never by time, so that speed does not depend on the frame rate ------------------

    def orbit(self, right: float, up: float) -> None:
        """Turns as if the scene hung on the cursor: a drag over one height of the window is half a turn."""
        self.azimuth = (self.azimuth - pi * right) % (2 * pi)
        self.elevation = _steep(self.elevation - pi * up)

    def zoom(self, steps: float) -> None:
        """Nearer by `steps`, or further off if negative. The target stays in the middle."""
        nearest = max(self._first_distance / ZOOM_REACH, NEAR)
        wanted = log(self.distance) - ZOOM_STEP * steps  # compared as a logarithm, which no number of steps overflows
        self.distance = exp(min(max(wanted, log(nearest)), log(self._first_distance * ZOOM_REACH)))

    def pan(self, right: float, up: float) -> None:
        """Moves eye and target sideways, in heights of the picture as they are at the target's distance."""
        axes = self._axes()
        self.target = self.target + self._height() * (right * axes[0] + up * axes[1])

    # -- matrices ----------------------------------------------------------------------------------------

    @property
    def eye(self) -> Vec3:
        """Where the picture is taken from [m]."""
        right, _, back = self._axes()
        x, y, z = self.target + self.distance * back - self.shift * self._height() * right
        return float(x), float(y), float(z)

    @property
    def looks_at(self) -> Vec3:
        """The point in the middle of the picture, as far off as the target; the target unless that is shifted [m]."""
        x, y, z = self.eye - self.distance * self._axes()[2]
        return float(x), float(y), float(z)

    def _height(self) -> float:
        """Height of the picture at the target's distance [m]."""
        return 2 * self.distance * tan(self.fov / 2)

    def _axes(self) -> Floats:
        """Unit vectors right, up and back (from target to eye), as rows."""
        sin_a, cos_a, sin_e, cos_e = sin(self.azimuth), cos(self.azimuth), sin(self.elevation), cos(self.elevation)
        return np.array(
            [[cos_a, 0.0, -sin_a], [-sin_e * sin_a, cos_e, -sin_e * cos_a], [cos_e * sin_a, sin_e, cos_e * cos_a]]
        )

    def view(self) -> Floats:
        """World to eye space, shape (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self._axes()
        matrix[:3, 3] = -self._axes() @ self.eye
        return matrix

    def projection(self, aspect: float) -> Floats:
        """Eye space to clip space, shape (4, 4); `aspect` is width / height."""
        scale = 1 / tan(self.fov / 2)
        depth = (FAR + NEAR) / (NEAR - FAR), 2 * FAR * NEAR / (NEAR - FAR)
        return np.array([[scale / aspect, 0, 0, 0], [0, scale, 0, 0], [0, 0, *depth], [0, 0, -1, 0]])

    def view_projection(self, aspect: float) -> Floats:
        """World to clip space, shape (4, 4)."""
        return self.projection(aspect) @ self.view()

    # -- between screen and world ------------------------------------------------------------------------

    def ray(self, u: float, v: float, aspect: float) -> tuple[Floats, Floats]:
        """Origin [m] and unit direction of the ray through a screen point."""
        half = tan(self.fov / 2)
        right, up, back = self._axes()
        direction = (2 * u - 1) * half * aspect * right + (2 * v - 1) * half * up - back
        return np.array(self.eye), direction / np.linalg.norm(direction)

    def to_screen(self, points: ArrayLike, aspect: float) -> tuple[Floats, Floats]:
        """Screen points, shape (N, 2), and distances along the view axis [m], shape (N,).

        A point that is not in front of the eye has no place on the screen: NaN.
        """
        points = np.atleast_2d(np.asarray(points, np.float64))
        clip = np.column_stack([points, np.ones(len(points))]) @ self.view_projection(aspect).T
        depth = clip[:, 3]
        uv = np.full((len(points), 2), np.nan)
        front = depth > 0
        uv[front] = (clip[front, :2] / depth[front, None] + 1) / 2
        return uv, depth


def _steep(elevation: float) -> float:
    return min(max(elevation, -STEEPEST), STEEPEST)
