"""Images of a running simulation, rendered without a window: for Python scripts and for notebooks."""

from __future__ import annotations

import os
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

from ..scene.reader import check_keys
from ..simulation.simulation import Simulation
from .camera import OrbitCamera
from .draw_list import VIEWS, DrawList
from .image_files import Pixels, encode_png, write_png
from .legend import draw_legend
from .rasterizer import Rasterizer


def render_pixels(raster: Rasterizer, draw_list: DrawList, camera: OrbitCamera, view: str) -> Pixels:
    """Return an image of the current frame, uint8 (height, width, 3); in the view `strain` with its color scale.

    The target is in the center: `camera.view_shift`, which makes room for a panel, is ignored.
    """
    camera = copy(camera)
    camera.view_shift = 0.0
    mesh = draw_list.update(view, camera.eye)
    pixels = raster.draw(mesh, camera.view_projection(raster.width / raster.height))
    return draw_legend(pixels) if view == "strain" else pixels


@dataclass(frozen=True, eq=False)
class Image:
    """An image. Notebooks display it."""

    pixels: Pixels
    """Red, green and blue, uint8 (height, width, 3), top row first."""

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a PNG file. Raises OSError; a partial file never remains."""
        write_png(path, self.pixels)

    def _repr_png_(self) -> bytes:
        return encode_png(self.pixels)


def render_image(
    simulation: Simulation,
    size: tuple[int, int] = (640, 360),
    view: str = "shaded",
    *,
    eye: Sequence[float] | None = None,
    target: Sequence[float] | None = None,
) -> Image:
    """Return an image of the current frame. `size`: width and height [pixels].

    `view`: "shaded", "strain", "wireframe" or "particles". `eye` and `target`: positions of the camera, and of what it
    looks at [m]; without one, that of the scene's camera.

    Needs neither a display nor a window. Raises ValueError for a size below 1 × 1, an unknown view and a position that
    a scene does not allow.
    """
    if view not in VIEWS:
        raise ValueError(f"unknown view {view!r}: {', '.join(VIEWS)}")
    scene = simulation.scene
    places: dict[str, Any] = {"eye": eye, "target": target}
    places = {name: place for name, place in places.items() if place is not None}
    camera = OrbitCamera.from_scene(check_keys(replace(scene, camera=replace(scene.camera, **places))))
    raster = Rasterizer(*size)
    draw_list = DrawList(simulation)
    try:
        return Image(render_pixels(raster, draw_list, camera, view))
    finally:
        draw_list.close()
