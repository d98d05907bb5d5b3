"""Cases 9 to 13: a cloth that starts as none should, and must find its shape."""

from __future__ import annotations

import numpy as np

from .scenes import sheet
from .setting import CELLS
from .trial import Trial
from .watch import Floats

RANDOM_STRAIN = 0.05  # what a sheet from a random start may end with, as the list has it


def grid_of(trial: Trial, places: Floats) -> Floats:
    """The same places by rows and columns: (rows, columns, 3), a view."""
    return places.reshape(*trial.simulation.topology.shape, 3)


def loose(trial: Trial, places: Floats, before: Floats) -> Floats:
    """Changed places of all but the pins."""
    pinned = trial.simulation.topology.pinned
    return np.where(pinned[:, None], before, places)


def collapsed(trial: Trial, spread: float) -> None:
    """All but the pins at one point, or within so many metres of it [standard deviation]. Twice: the same bits."""
    ends = []
    shape = trial.open(sheet(CELLS)).shape
    point = trial.random.uniform(-0.3, 0.3, 3) + trial.random.normal(0.0, spread, shape)
    for again in range(2):
        if again:
            trial.open(sheet(CELLS))
        trial.start(loose(trial, point, trial.simulation.topology.start), shake=0.0)
        trial.settle()
        ends.append(trial.simulation.positions())
    trial.tell("numbers that are others the second time", int((ends[0] != ends[1]).sum()), 0)


def in_line(x: Floats) -> Floats:
    """All on one line: y = z = 0."""
    return x * [1.0, 0.0, 0.0]


def mirrored(x: Floats) -> Floats:
    """The left half lies on the right one."""
    return np.where(x[:, :1] < 0, x * [-1.0, 1.0, 1.0], x)


def flattened(trial: Trial, lie: str) -> None:
    x = trial.open(sheet(CELLS))
    trial.start(loose(trial, {"in line": in_line, "mirrored": mirrored}[lie](x), x))
    trial.settle()


def random_start(trial: Trial) -> None:
    x = trial.open(sheet(CELLS, pins=("top",)), rest_strain=RANDOM_STRAIN)
    trial.start(loose(trial, trial.random.uniform(-0.5, 0.5, x.shape), x))
    trial.settle()


def noise(trial: Trial, size: float) -> None:
    """Every particle off its place [m, standard deviation]."""
    x = trial.open(sheet(CELLS))
    trial.start(loose(trial, x + trial.random.normal(0.0, size, x.shape), x))
    trial.settle()


def swapped(x: Floats) -> Floats:
    """Every second column in the place of the next: (rows, columns, 3)."""
    order = np.arange(x.shape[1])
    pairs = order[: len(order) // 2 * 2].reshape(-1, 2)
    order[: pairs.size] = pairs[:, ::-1].ravel()
    return x[:, order]


def inverted(trial: Trial) -> None:
    x = trial.open(sheet(CELLS))
    trial.start(loose(trial, swapped(grid_of(trial, x)).reshape(-1, 3), x))
    trial.settle()
