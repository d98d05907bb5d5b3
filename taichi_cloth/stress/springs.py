"""Cases 1 to 3: constants and masses that differ by orders of magnitude."""

from __future__ import annotations

from dataclasses import replace
from math import log10

from ..scene.model import Maps
from .files import folder, half_map
from .scenes import CONSTANT, DENSITY, sheet
from .setting import CELLS
from .trial import Trial

GRAVITY = 9.81  # [m/s²]
WEIGHT = DENSITY * GRAVITY  # [N] of the sheet
PARTICLE = DENSITY / CELLS**2  # [kg] of a particle inside the sheet
MOST_SPEED = 20.0  # [m/s] Newton's bound on a stiff sheet


def stiffness_sweep(trial: Trial, constant: float) -> None:
    """One constant [N/m] for all springs, hung by two corners; nothing else is tuned.

    Where springs have no constant their shares go from 0.1 to 1 with the decades.
    """
    share = (round(log10(constant)) + 1) / 10
    trial.open(sheet(CELLS, constant=constant, share=share), far=8 * WEIGHT / constant)
    trial.start()
    for _ in range(300):
        trial.one_frame()
        trial.tell("speed [m/s]", trial.watch.speed, MOST_SPEED)
    trial.settle()


def stiffness_ratio(trial: Trial, ratio: float) -> None:
    """The springs of the left half of the sheet are so many times as stiff as the others, which have 1000 N/m.

    Springs across the line between have the mean of both. Shares, where springs have no constant, have this ratio, too.
    """
    maps = Maps(stiffness=half_map(CELLS), stiffness_lo=1 / ratio, stiffness_hi=1.0, folder=str(folder()))
    trial.open(replace(sheet(CELLS, constant=CONSTANT * ratio), maps=maps))
    trial.start()
    trial.settle()


def mass_ratio(trial: Trial, times: float) -> None:
    """A weight on one free corner, in masses of a particle inside the sheet."""
    load = times * PARTICLE * GRAVITY  # [N]
    trial.open(sheet(CELLS, weight=times * PARTICLE, weight_at="bottom-right"), far=4 * load / CONSTANT)
    trial.start()
    trial.settle()
    trial.tell("strain", trial.watch.strain)
