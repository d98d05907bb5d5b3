"""One picture of a running simulation, for Python and for notebooks."""

from __future__ import annotations

import os
from dataclasses import dataclass

from ..interact.camera import OrbitCamera
from ..simulation import Simulation
from .draw_list import VIEWS, DrawList
from .png import Pixels, encode_png, write_png
from .portrait import portrait
from .raster import Raster


@dataclass(frozen=True, eq=False)
class Picture:
    """`pixels`, uint8 of shape (height, width, 3), row 0 on top. A notebook shows it by itself."""

    pixels: Pixels

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a PNG file, whole or not at all. Raises OSError."""
        write_png(path, self.pixels)

    def _repr_png_(self) -> bytes:
        return encode_png(self.pixels)


def picture(simulation: Simulation, width: int = 640, height: int = 360, view: str = "shaded") -> Picture:
    """The cloth as it is now, from the scene's camera, in one of `VIEWS`; `width` and `height` in pixels.

    Needs neither a screen nor a window. Raises ValueError for a size below 1 × 1 and for an unknown view.
    """
    if view not in VIEWS:
        raise ValueError(f"no view {view!r}: {', '.join(VIEWS)}")
    camera = OrbitCamera.from_scene(simulation.scene.camera)
    raster = Raster(width, height)
    draw_list = DrawList(simulation)
    try:
        return Picture(portrait(raster, draw_list, camera, view))
    finally:
        draw_list.close()
