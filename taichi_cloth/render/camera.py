"""The orbit camera. Matrices act on column vectors: clip = projection @ view @ (x, y, z, 1).

In eye space x points right and y up, and the camera looks along −z; clip w is therefore the distance along the view
axis [m]. A screen point (u, v) runs from (0, 0) at the bottom left of the image to (1, 1), like the cursor of GGUI,
Taichi's window toolkit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import asin, atan2, cos, exp, hypot, inf, log, pi, radians, sin, tan

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry.cloth_builder import build_particles
from ..geometry.signed_distance import collider_surface
from ..scene import Camera, Scene

NEAR, FAR = 0.1, 1000.0  # [m] clip planes, those of GGUI
MAX_ELEVATION = radians(89)  # largest elevation: at 90° the up direction is undefined
ZOOM_STEP = 0.1  # change of log(distance) per step
MAX_ZOOM_LEVEL = 30.0  # [steps] from the framed view, in both directions: a factor of 20
WIDTH_MARGIN = 1.25  # largest factor of the distance in `fit_width`
FAR_MARGIN = 4.0  # largest factor of the distance in `move_back`
OVERFLOW = 1.25  # how far `move_back` moves, over what is needed
INCLUDE_MARGIN = 1.1  # factor of the distance at which `include` just sees all points
FLOOR_CLEARANCE = 0.02  # smallest height of eye and target above the floor, as a fraction of the initial distance

Floats = NDArray[np.float64]
Vec3 = tuple[float, float, float]


class OrbitCamera:
    """Camera that orbits `target` [m] at a `distance` [m].

    `azimuth` [rad] is 0 on the +z axis and grows towards +x; `elevation` [rad] is 0 on the horizontal plane. No motion
    takes the eye below the floor, from where an opaque floor hides the cloth.
    """

    def __init__(self, eye: Sequence[float], target: Sequence[float], fov_degrees: float, floor: float = -inf) -> None:
        """`fov_degrees`: vertical field of view. `floor`: its height [m].

        An eye that coincides with the target is moved away from it.
        """
        self.fov = radians(fov_degrees)
        self.view_shift = 0.0
        """Distance of the target to the right of the image center [image heights]."""
        self._initial_target = np.array(target, np.float64)
        x, y, z = np.asarray(eye, np.float64) - self._initial_target
        self._initial_distance = max(hypot(x, y, z), NEAR)
        self._initial_azimuth = atan2(x, z)
        self._initial_elevation = _clamp_elevation(asin(y / self._initial_distance))
        self._lowest = floor + FLOOR_CLEARANCE * self._initial_distance  # [m] height of eye and target
        self.reset()

    @classmethod
    def from_scene(cls, scene: Scene) -> OrbitCamera:
        """Return the camera of a scene, above its ground."""
        camera = camera_of(scene)
        return cls(camera.eye, camera.target, camera.fov, floor_height(scene))

    def reset(self) -> None:
        """Return to the initial target, distance and angles."""
        self.target = self._initial_target.copy()
        self.distance = self._unzoomed_distance = self._initial_distance
        self.azimuth = self._initial_azimuth
        self.elevation = self._initial_elevation

    @property
    def zoom_level(self) -> float:
        """Zoom steps from the distance that the scene or the last framing set, positive if the eye is closer."""
        return log(self._unzoomed_distance / self.distance) / ZOOM_STEP

    def include(self, points: ArrayLike, aspect: float) -> None:
        """Move the target to the middle of `points`, (N, 3) [m], and the eye back, if not all are in the picture.

        `aspect`: width over height of the picture. Of a picture whose target is shifted to the right, only the part on
        both sides of the target counts, which a panel does not cover.
        """
        points = np.asarray(points, np.float64)
        uv = self._in_uncovered_part(points, aspect)
        aspect -= 2 * self.view_shift
        if ((uv >= 0) & (uv <= 1)).all():  # NaN behind the eye
            return
        self.target = (points.min(axis=0) + points.max(axis=0)) / 2
        right, up, back = ((points - self.target) @ axis for axis in self._axes())
        half = tan(self.fov / 2)
        right = right + 2 * self.view_shift * half * back  # nearer points are shifted more than the target
        needed = np.maximum(np.abs(up), np.abs(right) / aspect) / half + back
        self.distance = self._unzoomed_distance = max(INCLUDE_MARGIN * float(needed.max()), NEAR)
        self._stay_above_floor()

    def move_back(self, points: ArrayLike, aspect: float) -> None:
        """Move target and eye so that `points` come into the picture, in addition to what it shows at the target.

        So images of cloth that moves out of the picture show its motion, without a jump: what leaves it by some
        distance extends it by `OVERFLOW` times that. Only beyond `FAR_MARGIN` times the distance the cloth is framed
        alone, as by `include`. Arguments as there; the target is not shifted.
        """
        points, half = np.asarray(points, np.float64), tan(self.fov / 2)
        right, up, back = ((points - self.target) @ axis for axis in self._axes())
        moves, needed = [], []
        for across, slope in ((right, half * aspect), (up, half)):
            shown = slope * self.distance  # to each side, at the target; nearer points need more
            low, high = (shown + OVERFLOW * max(0.0, (side + slope * back - shown).max()) for side in (-across, across))
            moves.append((high - low) / 2)
            needed.append((high + low) / 2 / slope)
        if max(needed) > FAR_MARGIN * self.distance:
            self.include(points, aspect)
            return
        self.target = self.target + np.array(moves) @ self._axes()[:2]
        self.distance = self._unzoomed_distance = max(needed)
        self._stay_above_floor()

    def fit_width(self, points: ArrayLike, aspect: float) -> None:
        """Move the eye back by at most a quarter of the distance, until `points` are in the picture sideways.

        Arguments as for `include`, which also fits the height: cloth that falls would then be small at the end.
        """
        largest = WIDTH_MARGIN * self.distance
        while self.distance < largest:
            across = self._in_uncovered_part(points, aspect)[:, 0]
            if ((across >= 0) & (across <= 1)).all():
                return
            self.distance = self._unzoomed_distance = min(1.02 * self.distance, largest)

    def _in_uncovered_part(self, points: ArrayLike, aspect: float) -> NDArray[np.float64]:
        """Return screen points, (N, 2), in the part of the picture that `include` describes: 0…1 in each direction."""
        uv, _ = self.to_screen(points, aspect)
        covered = 2 * self.view_shift
        uv[:, 0] = (aspect * uv[:, 0] - covered) / (aspect - covered)
        return uv

    # -- motion: by amounts, not by time, so that the speed does not depend on the frame rate --------------------------

    def orbit(self, right: float, up: float) -> None:
        """Rotate about the target as if the cursor dragged the scene by `right` and `up` [window heights].

        A drag by 1 is half a turn.
        """
        self.azimuth = (self.azimuth - pi * right) % (2 * pi)
        self.elevation = _clamp_elevation(self.elevation - pi * up)
        self._stay_above_floor()

    def zoom(self, steps: float, nearest: float = NEAR) -> None:
        """Move the eye closer by `steps`, or farther away if negative. The target stays in the center.

        The eye comes no closer to the target than `nearest` [m], and does not move if it is closer already.
        """
        middle, range_ = log(self._unzoomed_distance), ZOOM_STEP * MAX_ZOOM_LEVEL
        closest = min(max(middle - range_, log(max(nearest, NEAR))), log(self.distance))
        log_distance = log(self.distance) - ZOOM_STEP * steps  # no number of steps overflows a logarithm
        self.distance = exp(min(max(log_distance, closest), middle + range_))
        self._stay_above_floor()

    def pan(self, right: float, up: float) -> None:
        """Move eye and target parallel to the image by `right` and `up` [image heights at the target's distance]."""
        axes = self._axes()
        self.target = self.target + self._image_height() * (right * axes[0] + up * axes[1])
        self._stay_above_floor()

    def _stay_above_floor(self) -> None:
        """Raise the target, and turn the eye up, to what lies above the floor."""
        self.target[1] = max(self.target[1], self._lowest)
        self.elevation = max(self.elevation, asin(max((self._lowest - self.target[1]) / self.distance, -1.0)))

    # -- matrices ------------------------------------------------------------------------------------------------------

    @property
    def eye(self) -> Vec3:
        """Position of the eye [m]."""
        right, _, back = self._axes()
        x, y, z = self.target + self.distance * back - self.view_shift * self._image_height() * right
        return float(x), float(y), float(z)

    @property
    def look_at(self) -> Vec3:
        """Point in the image center at the distance of the target [m]; equal to the target if `shift` is 0."""
        x, y, z = self.eye - self.distance * self._axes()[2]
        return float(x), float(y), float(z)

    def on_screen(self, length: float, depth: float) -> float:
        """Return a length [m] at a distance along the view axis [m], as a fraction of the image's height."""
        return length / (2 * depth * tan(self.fov / 2))

    def _image_height(self) -> float:
        """Return the height of the visible area at the distance of the target [m]."""
        return 2 * self.distance * tan(self.fov / 2)

    def _axes(self) -> Floats:
        """Return the unit vectors right, up and back (from target to eye) as rows, (3, 3)."""
        sin_a, cos_a, sin_e, cos_e = sin(self.azimuth), cos(self.azimuth), sin(self.elevation), cos(self.elevation)
        return np.array(
            [[cos_a, 0.0, -sin_a], [-sin_e * sin_a, cos_e, -sin_e * cos_a], [cos_e * sin_a, sin_e, cos_e * cos_a]]
        )

    def view(self) -> Floats:
        """Return the matrix from world to eye space, (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self._axes()
        matrix[:3, 3] = -self._axes() @ self.eye
        return matrix

    def projection(self, aspect: float) -> Floats:
        """Return the matrix from eye to clip space, (4, 4). `aspect`: width / height."""
        scale = 1 / tan(self.fov / 2)
        depth = (FAR + NEAR) / (NEAR - FAR), 2 * FAR * NEAR / (NEAR - FAR)
        return np.array([[scale / aspect, 0, 0, 0], [0, scale, 0, 0], [0, 0, *depth], [0, 0, -1, 0]])

    def view_projection(self, aspect: float) -> Floats:
        """Return the matrix from world to clip space, (4, 4). `aspect`: width / height."""
        return self.projection(aspect) @ self.view()

    # -- between screen and world --------------------------------------------------------------------------------------

    def ray(self, u: float, v: float, aspect: float) -> tuple[Floats, Floats]:
        """Return the origin [m] and the unit direction of the ray through a screen point, each (3,)."""
        half = tan(self.fov / 2)
        right, up, back = self._axes()
        direction = (2 * u - 1) * half * aspect * right + (2 * v - 1) * half * up - back
        return np.array(self.eye), direction / np.linalg.norm(direction)

    def to_screen(self, points: ArrayLike, aspect: float) -> tuple[Floats, Floats]:
        """Return the screen points, (N, 2), of `points`, (N, 3) [m], and their distances along the view axis [m], (N,).

        The screen point of a point that is not in front of the eye is NaN.
        """
        points = np.atleast_2d(np.asarray(points, np.float64))
        clip = np.column_stack([points, np.ones(len(points))]) @ self.view_projection(aspect).T
        depth = clip[:, 3]
        uv = np.full((len(points), 2), np.nan)
        front = depth > 0
        uv[front] = (clip[front, :2] / depth[front, None] + 1) / 2
        return uv, depth


DISTANCE_OF_COVER = 0.95  # of the eye, over that at which a ball around the cloth is as high as the image


def camera_of(scene: Scene) -> Camera:
    """Return the camera of a scene; if it sets none, one that frames the cloth and the colliders near it at their
    start, from the same side.
    """
    camera = scene.camera
    if camera != Camera():
        return camera
    points = _with_colliders(build_particles(scene).start, scene)
    target = (points.min(axis=0) + points.max(axis=0)) / 2
    radius = float(np.linalg.norm(points - target, axis=1).max())
    away = np.subtract(camera.eye, camera.target)
    distance = DISTANCE_OF_COVER * radius / tan(radians(camera.fov) / 2)
    eye = target + away * max(distance, 2 * NEAR) / np.linalg.norm(away)
    return replace(camera, eye=tuple(eye.tolist()), target=tuple(target.tolist()))


def _with_colliders(points: Floats, scene: Scene) -> Floats:
    """Return points, with those around the spheres, capsules, boxes and meshes no larger than the cloth and near it.

    Colliders are taken where they stand without oscillation and keyframes.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.linalg.norm(high - low))
    boxes = [(one.center, np.full(3, one.radius)) for one in scene.spheres]
    boxes += [(one.center, np.full(3, one.radius + one.length / 2)) for one in scene.capsules]
    boxes += [(one.center, np.linalg.norm(one.size) * np.full(3, 0.5)) for one in scene.boxes]
    boxes += [(one.center, np.full(3, np.linalg.norm(collider_surface(one).half))) for one in scene.meshes]
    ends = [(center - half, center + half) for center, half in boxes if np.linalg.norm(half) <= size]
    near = [pair for pair in ends if (pair[0] <= high + size / 2).all() and (pair[1] >= low - size / 2).all()]
    return np.concatenate([points, *near])


def floor_height(scene: Scene) -> float:
    """Return the height of a scene's ground [m], -inf without one."""
    return -inf if scene.ground is None else scene.ground.height


def _clamp_elevation(elevation: float) -> float:
    """Return an elevation limited to ±`MAX_ELEVATION` [rad]."""
    return min(max(elevation, -MAX_ELEVATION), MAX_ELEVATION)
