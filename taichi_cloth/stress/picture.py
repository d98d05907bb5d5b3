"""The frame in which something failed, as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..interact.camera import OrbitCamera
from ..view.draw_list import DrawList
from ..view.legend import stamp
from ..view.png import write_png
from ..view.raster import Raster
from .trial import Trial

WIDTH, HEIGHT = 640, 480


def picture(trial: Trial, path: Path) -> bool:
    """Draws the strains of the cloth as it is. False where there is nothing to see: a place is not finite."""
    simulation = trial.simulation
    if not np.isfinite(simulation.positions()).all() or not len(simulation.topology.family("structural")):
        return False
    camera = OrbitCamera.from_scene(simulation.scene.camera)
    draw_list = DrawList(simulation)
    try:
        mesh = draw_list.update("strain", camera.eye)
        pixels = Raster(WIDTH, HEIGHT).draw(mesh, camera.view_projection(WIDTH / HEIGHT))
    finally:
        draw_list.close()
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, stamp(pixels))
    return True
