"""Cases 24, 25, 33, 40: cells of no area, grids of next to nothing and of a million, and places far away."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from math import inf

import numpy as np

from ..errors import WrongUse
from ..scene import load_scene
from .scenes import CORNERS, sheet
from .starts import grid_of
from .trial import Trial

CELL = 1 / 32  # [m]
TINY = ((1, 1), (1, 2), (1, 8), (8, 1), (2, 2), (2, 3), (3, 2), (3, 3), (2, 1000), (1000, 2))  # rows, columns


def degenerate(trial: Trial) -> None:
    """Particles on one another, rows without area, cells of 1:10,000, and sides of no length, which are refused."""
    kind = trial.one_of(("points", "rows", "slivers"))
    for key in ("width", "height"):
        trial.refuses(key, partial(load_scene, "curtain", **{key: 0.0}))
    if kind == "slivers":
        narrow = sheet(trial.cells, pins=("top",), size=(1e4 / 1000, 1e-3))
        try:
            trial.open(narrow, rest=inf)
        except WrongUse as error:
            trial.demand("refusals that do not name the substeps", "substeps" not in str(error), 0)
            return
        trial.start()
        trial.run(1.0)
        return
    x = trial.open(sheet(trial.cells))
    places, middle = grid_of(trial, x.copy()), trial.cells // 2
    if kind == "points":
        places[middle, middle] = places[middle, middle + 1]
        places[middle - 2, middle] = places[middle - 1, middle + 1]
    else:
        places[middle : middle + 3] = places[middle]
    trial.start(places.reshape(-1, 3))
    trial.settle()


def tiny(trial: Trial) -> None:
    """Less than two particles a side are refused."""
    rows, columns = trial.one_of(TINY)
    if min(rows, columns) < 2:
        short = "rows" if rows < 2 else "columns"
        trial.refuses(short, lambda: load_scene("curtain", rows=rows, columns=columns))
        return
    size = (CELL * (columns - 1), CELL * (rows - 1))
    trial.open(sheet((rows - 1, columns - 1), pins=("top",), size=size), far=2.0)
    trial.start()
    trial.settle()


def far_away(trial: Trial) -> None:
    """As near the origin, or refused."""
    away = trial.one_of((100.0, 1000.0, 10_000.0))
    scene = sheet(trial.cells)
    trial.open(scene)
    trial.start()
    trial.settle()
    sag = 0.5 - trial.simulation.positions()[:, 1].min()
    trial.open(replace(scene, cloth=replace(scene.cloth, center=(away, 0.0, 0.0))))
    trial.start()
    trial.settle()
    there = 0.5 - trial.simulation.positions()[:, 1].min()
    trial.tell("sag beside that near the origin, share", abs(there / sag - 1), 0.01)


def large(trial: Trial) -> None:
    """A million particles, one frame; a quarter of them where a frame takes minutes."""
    side = 1024 * trial.cells // 32
    size = CELL * (side - 1)
    trial.open(sheet(side - 1, pins=CORNERS, size=(size, size)), rest=inf)
    trial.start()
    trial.one_frame()
    trial.tell("stretch in the first frame", trial.watch.strain)
    trial.demand("places that are not finite", int((~np.isfinite(trial.simulation.positions())).sum()), 0)
