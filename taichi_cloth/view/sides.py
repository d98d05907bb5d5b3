"""Two running scenes in one picture, side by side, seen by one camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import WrongUse
from ..interact.camera import OrbitCamera
from ..scene import Scene
from ..simulation import Simulation
from .draw_list import DrawList
from .png import Pixels
from .portrait import portrait
from .raster import Raster

SEAM = 2  # [pixels] between the halves
WIDE = 1.15  # width over height of a picture that shows what a scene's camera is meant to


def camera_for(scene: Scene, aspect: float) -> OrbitCamera:
    """The scene's camera, as much farther off as it takes to show as much in a picture that is narrower than usual."""
    eye, target = np.array(scene.camera.eye), np.array(scene.camera.target)
    return OrbitCamera(target + max(1.0, WIDE / aspect) * (eye - target), target.tolist(), scene.camera.fov)


def half_of(width: int) -> int:
    """Width of a half [pixels]. Raises WrongUse where none is left."""
    if width <= SEAM + 1:
        raise WrongUse(f"two pictures do not fit into {width} pixels")
    return (width - SEAM) // 2


class TwoPictures:
    """Draws the left side, a seam and the right side, each with half of the width."""

    def __init__(self, width: int, height: int, samples: int) -> None:
        """Size in pixels. Raises WrongUse as `half_of` does."""
        self._half = Raster(half_of(width), height, samples)
        self._picture = np.full((height, width, 3), 255, np.uint8)

    @property
    def aspect(self) -> float:
        """Width over height of a half."""
        return self._half.width / self._half.height

    def draw(self, sides: tuple[DrawList, DrawList], view: str, camera: OrbitCamera) -> Pixels:
        """The picture as uint8 of shape (height, width, 3); a new array each time."""
        picture = self._picture.copy()
        width = self._half.width
        for side, left in zip(sides, (0, picture.shape[1] - width), strict=True):
            picture[:, left : left + width] = portrait(self._half, side, camera, view)
        return picture


def apart(a: Simulation, b: Simulation, partner: NDArray[np.int64]) -> float:
    """Root mean square distance of the particles of a from their partners in b, as a share of the longer side."""
    away = a.positions() - b.positions()[partner]
    return float(np.sqrt((away**2).sum(axis=1).mean())) / a.topology.side


def partners(a: Simulation, b: Simulation) -> NDArray[np.int64]:
    """For every particle of a the one of b that lies nearest to the same place of the sheet, (N,).

    Grids of other sizes are so compared, and pulled at, to half a cell.
    """
    theirs = b.topology.flat
    found = [((theirs - place) ** 2).sum(axis=1).argmin() for place in a.topology.flat]
    return np.array(found, np.int64)
