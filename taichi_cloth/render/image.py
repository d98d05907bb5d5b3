"""Images of a running simulation, rendered without a window: for Python scripts and for notebooks."""

from __future__ import annotations

import os
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from ..scene import Camera
from ..scene.reader import check_keys
from ..simulation.parameter_values import check_image_size
from ..simulation.running_cloth import check_simulation
from ..simulation.simulation import Simulation
from ..system.errors import UsageError, choose_from
from ..system.taichi_runtime import check_thread
from .camera import OrbitCamera, camera_of
from .colors import draw_legend
from .draw_list import VIEWS, DrawList
from .image_files import Pixels, encode_png, write_png
from .rasterizer import Rasterizer


def render_pixels(raster: Rasterizer, draw_list: DrawList, camera: OrbitCamera, view: str) -> Pixels:
    """Return an image of the current frame, uint8 (height, width, 3); with the color scale of the view if it has one.

    The target is in the center: `camera.view_shift`, which makes room for a panel, is ignored.
    """
    pixels = render_without_scale(raster, draw_list, camera, view)
    scale = draw_list.scale(view)
    return draw_legend(pixels, scale) if scale else pixels


def render_without_scale(raster: Rasterizer, draw_list: DrawList, camera: OrbitCamera, view: str) -> Pixels:
    """Return the same image without a color scale."""
    camera = copy(camera)
    camera.view_shift = 0.0
    mesh = draw_list.update(view, camera.eye)
    return raster.draw(mesh, camera.view_projection(raster.width / raster.height))


@dataclass(frozen=True, eq=False)
class Image:
    """An image. Notebooks display it."""

    pixels: Pixels
    """Red, green and blue, uint8 (height, width, 3), top row first."""

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a PNG file. Raises UsageError for a name that does not end in .png, and OSError.

        A partial file never remains.
        """
        if Path(path).suffix.lower() != ".png":
            raise UsageError(f"{os.fspath(path)}: images are saved as PNG files: the name must end in .png")
        write_png(path, self.pixels)

    def __repr__(self) -> str:
        height, width, _ = self.pixels.shape
        return f"<Image {width}×{height}>"

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.pixels, dtype, copy=copy)

    def _repr_png_(self) -> bytes:
        return encode_png(self.pixels)


def render_image(
    simulation: Simulation,
    size: tuple[int, int] = (640, 360),
    view: str = "shaded",
    *,
    eye: ArrayLike | None = None,
    target: ArrayLike | None = None,
) -> Image:
    """Return an image of the current frame. `size`: width and height [pixels].

    `view`: "shaded", "strain", "error" (if it was measured), "wireframe" or "particles". `eye` and `target`: positions
    of the camera, and of what it looks at [m]; without one, that of the scene's camera. If the scene has none, the
    camera frames the cloth at its start, and again where it has left the picture.

    Needs neither a display nor a window. Raises ValueError for a size that is not two integers from 1 to 8192, an
    unknown view, and a position that a scene does not allow: one not of three numbers, or a camera that looks straight
    up or down. Raises UsageError for the view "error" of a frame without a measured error.
    """
    check_thread()
    check_simulation(simulation)
    if view not in VIEWS:
        raise ValueError(f"unknown view {view!r}{choose_from(view, VIEWS)}")
    size = check_image_size(size)
    places: dict[str, Any] = {"eye": eye, "target": target}
    scene = simulation.scene
    places = {name: place for name, place in places.items() if place is not None}
    seen = replace(scene, camera=replace(camera_of(scene), **places))
    check_keys(seen)
    camera = OrbitCamera.from_scene(seen)
    if scene.camera == Camera() and not places:
        camera.include(simulation.positions(), size[0] / size[1])
    error = getattr(simulation, "frame_error", None)  # of `tc.Simulation` only
    if view == "error" and error is None:
        raise UsageError("the view 'error' needs the error of the last frame: call step(measure_error=True) before")
    raster = Rasterizer(*size)
    draw_list = DrawList(simulation)
    if error:
        draw_list.errors = error.by_particle
    try:
        return Image(render_pixels(raster, draw_list, camera, view))
    finally:
        draw_list.close()
