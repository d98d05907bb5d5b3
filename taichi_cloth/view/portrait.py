"""One picture of a running scene, drawn without a window."""

from __future__ import annotations

from copy import copy

from ..interact.camera import OrbitCamera
from .draw_list import DrawList
from .legend import stamp
from .png import Pixels
from .raster import Raster


def portrait(raster: Raster, draw_list: DrawList, camera: OrbitCamera, view: str) -> Pixels:
    """The scene as it is now, its strains with their scale; the target is in the middle, as no panel is in the way."""
    camera = copy(camera)
    camera.shift = 0.0
    mesh = draw_list.update(view, camera.eye)
    picture = raster.draw(mesh, camera.view_projection(raster.width / raster.height))
    return stamp(picture) if view == "strain" else picture
