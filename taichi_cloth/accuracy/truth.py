"""The swinging curtain in float64: what the solvers are held against.

Pinned along its top edge and let go flat, with springs along its threads only, every column moves as one plane chain of
equal masses. So a chain gives the whole sheet, for any number of rows, angle and stiffness.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import ceil, cos, radians, sin, sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..scene.model import FRAME_SECONDS
from .kept import kept

Floats = NDArray[np.float64]

GRAVITY = 9.81  # [m/s²]
FINER = 8  # steps of a half of the longest stable one


@dataclass(frozen=True)
class Curtain:
    """One square metre that swings about its top edge."""

    cells: int = 64  # a side
    constant: float = 1000.0  # [N/m] of every spring
    area_density: float = 0.2  # [kg/m²]
    degrees: float = 45.0  # from hanging, forwards

    @property
    def mass(self) -> float:
        """Of a particle [kg]."""
        return self.area_density / self.cells**2

    @property
    def rest(self) -> float:
        """Length of a spring [m]."""
        return 1.0 / self.cells

    @property
    def start(self) -> Floats:
        """(cells + 1, 2): forward and up [m] from the top edge, row by row."""
        along = np.arange(self.cells + 1)[:, None] * self.rest
        angle = radians(self.degrees)
        places: Floats = along * np.array([sin(angle), -cos(angle)])
        return places

    @property
    def fastest(self) -> float:
        """Bound of the chain's frequencies [rad/s]."""
        return 2 * sqrt(self.constant / self.mass)

    def acceleration(self, x: Floats) -> Floats:
        """[m/s²] of every particle; the pinned one has none."""
        gap = np.diff(x, axis=0)
        long = np.sqrt((gap * gap).sum(axis=1, keepdims=True))
        pull = gap * (self.constant / self.mass * (1 - self.rest / long))
        a = np.zeros_like(x)
        a[1:] = -pull
        a[1:-1] += pull[1:]
        a[1:, 1] -= GRAVITY
        return a


def verlet(curtain: Curtain, frames: int, steps: int) -> Floats:
    """Places after each frame, (frames, cells + 1, 2), by velocity Verlet with so many steps a frame."""
    h = FRAME_SECONDS / steps
    x, v, a = curtain.start, np.zeros((curtain.cells + 1, 2)), curtain.acceleration(curtain.start)
    seen = []
    for _ in range(frames):
        for _ in range(steps):
            v += h / 2 * a
            x = x + h * v
            a = curtain.acceleration(x)
            v += h / 2 * a
        seen.append(x)
    return np.array(seen)


def extrapolated(curtain: Curtain, frames: int) -> Floats:
    """The same without its error of second order: (4·fine − coarse)/3 of two step lengths (Richardson).

    Another way to the truth, to be held against it.
    """
    steps = FINER * ceil(curtain.fastest * FRAME_SECONDS)
    return (4 * verlet(curtain, frames, 2 * steps) - verlet(curtain, frames, steps)) / 3


@cache
def truth(curtain: Curtain, frames: int = 60) -> Floats:
    """Where every row is after each frame, (frames, cells + 1, 2) [m], to 1e-9. Kept on disk."""
    return kept(f"{curtain} {frames}", Path(__file__), lambda: runge_kutta(curtain, frames))


def runge_kutta(curtain: Curtain, frames: int) -> Floats:
    """The same, by the classical method of order 4."""
    steps = FINER * ceil(curtain.fastest * FRAME_SECONDS)
    h = FRAME_SECONDS / steps
    x, v = curtain.start, np.zeros((curtain.cells + 1, 2))
    seen = []
    for _ in range(frames):
        for _ in range(steps):
            a1 = curtain.acceleration(x)
            v2 = v + h / 2 * a1
            a2 = curtain.acceleration(x + h / 2 * v)
            v3 = v + h / 2 * a2
            a3 = curtain.acceleration(x + h / 2 * v2)
            v4 = v + h * a3
            a4 = curtain.acceleration(x + h * v3)
            x = x + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
            v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        seen.append(x)
    return np.array(seen)
