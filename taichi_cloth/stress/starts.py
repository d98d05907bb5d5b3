"""Cases 9 to 14: a cloth that starts as none should, and must find its shape."""

from __future__ import annotations

from math import inf

import numpy as np

from .scenes import sheet
from .trial import Trial
from .watch import Floats

FLOOR = 1.2  # [m] below the middle of the sheet


def grid_of(trial: Trial, places: Floats) -> Floats:
    """The same places by rows and columns: (rows, columns, 3), a view."""
    return places.reshape(*trial.simulation.topology.shape, 3)


def loose(trial: Trial, places: Floats, before: Floats) -> Floats:
    """Changed places of all but the pins."""
    pinned = trial.simulation.topology.pinned
    return np.where(pinned[:, None], before, places)


def collapsed(trial: Trial) -> None:
    """All at one point but the pins, or within a micrometre. It need not unfold, but must do the same twice."""
    ends = []
    for _ in range(2):
        x = trial.open(sheet(trial.cells), rest=inf)
        point = np.random.default_rng(trial.number).normal(0.0, trial.one_of((0.0, 1e-6)), x.shape)
        trial.start(loose(trial, point, x), shake=0.0)
        trial.run(5.0)
        ends.append(trial.simulation.positions())
    trial.tell("numbers that are others the second time", int((ends[0] != ends[1]).sum()), 0)
    trial.tell("strain 5 s after", trial.watch.strain)


def flattened(trial: Trial) -> None:
    x = trial.open(sheet(trial.cells))
    in_line, halved = x * [1, 0, 0], np.where(x[:, :1] < 0, x * [-1, 1, 1], x)  # one half lies on the other
    trial.start(loose(trial, trial.one_of((in_line, halved)), x))
    trial.settle()


def random_start(trial: Trial) -> None:
    x = trial.open(sheet(trial.cells, pins=("top",)), rest=0.05)
    trial.start(loose(trial, trial.random.uniform(-0.5, 0.5, x.shape), x))
    trial.settle()


def noise(trial: Trial) -> None:
    x = trial.open(sheet(trial.cells))
    trial.start(loose(trial, x + trial.random.normal(0.0, trial.one_of((1e-3, 0.1)), x.shape), x))
    trial.settle()


def inverted(trial: Trial) -> None:
    """Every second column has changed its place with the next one."""
    x = trial.open(sheet(trial.cells))
    columns = grid_of(trial, x).shape[1]
    order = np.arange(columns)
    order[: columns // 2 * 2] = order[: columns // 2 * 2].reshape(-1, 2)[:, ::-1].ravel()
    swapped = grid_of(trial, x)[:, order].reshape(-1, 3)
    trial.start(loose(trial, swapped, x))
    trial.settle()
