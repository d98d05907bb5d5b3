"""The frame in which something failed, as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..view.picture import picture
from .trial import Trial

WIDTH, HEIGHT = 640, 480


def draw(trial: Trial, path: Path) -> bool:
    """Draws the strains of the cloth as it is. False where there is nothing to see: a place is not finite."""
    simulation = trial.simulation
    if not np.isfinite(simulation.positions()).all() or not len(simulation.topology.family("structural")):
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    picture(simulation, WIDTH, HEIGHT, "strain").save(path)
    return True
