"""Which particle the cursor is on, and where a held one must go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .camera import OrbitCamera
from .rays import triangle_distances

TOLERANCE = 10.0  # [pixels] how far from a particle a press may be that hits no triangle: cloth seen edge-on

Floats = NDArray[np.float64]
Blocked = Callable[[Floats, Floats], float]  # distance [m] along a ray, origin and direction, to the first solid on it


@dataclass(frozen=True)
class Pick:
    """A particle under the cursor."""

    index: int
    point: tuple[float, float, float]  # [m] where the ray met the cloth; the particle itself if it met none
    depth: float  # [m] distance of the particle along the view axis


def pick(
    camera: OrbitCamera,
    cursor: tuple[float, float],
    size: tuple[int, int],
    positions: Floats,
    triangles: NDArray[np.integer],
    blocked: Blocked = lambda origin, direction: np.inf,
) -> Pick | None:
    """The particle at a screen point of a window of `size` pixels; a solid in front of it hides it.

    It is the nearest corner of the first triangle on the ray, or else the particle nearest on the screen
    within `TOLERANCE` pixels.
    """
    aspect = size[0] / size[1]
    origin, direction = camera.ray(*cursor, aspect)
    screen, depth = camera.to_screen(positions, aspect)
    free = blocked(origin, direction)

    distances = triangle_distances(origin, direction, *(positions[triangles[:, k]] for k in range(3)))
    first = int(distances.argmin()) if len(distances) else -1
    if first >= 0 and np.isfinite(distances[first]):
        if distances[first] > free:
            return None
        point = origin + distances[first] * direction
        corners = triangles[first]
        index = int(corners[np.linalg.norm(positions[corners] - point, axis=1).argmin()])
        return Pick(index, _vec3(point), float(depth[index]))

    away = np.linalg.norm((screen - cursor) * size, axis=1)  # [pixels], NaN behind the eye
    for index in (int(i) for i in np.argsort(away) if away[i] <= TOLERANCE):
        sight = positions[index] - origin
        distance = float(np.linalg.norm(sight))
        if distance < min(free, blocked(origin, sight / distance)):
            return Pick(index, _vec3(positions[index]), float(depth[index]))
    return None


class Handle:
    """A particle on the cursor: it stays in the plane parallel to the picture in which it was taken.

    What lay between cursor and particle at that moment is kept, so that nothing jumps.
    """

    def __init__(self, camera: OrbitCamera, cursor: tuple[float, float], aspect: float, particle: ArrayLike) -> None:
        """`particle` is its position [m]; it must lie in front of the eye."""
        self.target = np.asarray(particle, np.float64)
        self._normal = camera.view()[2, :3]
        self._level = float(self._normal @ self.target)
        self._offset = np.zeros(3)
        self._offset = self.target - self.move(camera, cursor, aspect)

    def move(self, camera: OrbitCamera, cursor: tuple[float, float], aspect: float) -> Floats:
        """Where the particle must go [m]. It stays where it is if the ray does not reach the plane."""
        origin, direction = camera.ray(*cursor, aspect)
        approach = float(self._normal @ direction)
        gap = self._level - float(self._normal @ origin)
        # Only a camera that was turned away during the drag can miss the plane.
        if gap * approach > 0:
            self.target = origin + (gap / approach) * direction + self._offset
        return self.target


def _vec3(point: Floats) -> tuple[float, float, float]:
    return float(point[0]), float(point[1]), float(point[2])
