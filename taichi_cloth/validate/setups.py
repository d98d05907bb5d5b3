"""Scenes for references, and short ways to run them."""

from __future__ import annotations

from dataclasses import replace
from math import isqrt, pi
from time import process_time
from typing import Any

import numpy as np

from ..mesh.from_scene import stiffness_of
from ..scene.model import FRAME_SECONDS, USUAL, Cloth, Fabric, Scene, Solver
from ..simulation import Simulation
from .exact import Floats
from .row import TooSlow

EULER = ("verlet", "xpbd", "projective")  # their free particles move by symplectic Euler
ELASTIC = ("xpbd", "spring", "lines", "rk4", "projective")  # springs with a constant
ALL = ("verlet", *ELASTIC)


LONGEST = 20.0  # [s] of processor time that the frames of one set-up may take
SETTLING = 3.0  # [1/s] damping that brings a sheet to rest


class Timed(Simulation):
    """A simulation whose frames may not take for ever; the first one, which compiles, is not counted."""

    spent = -1.0  # [s] of processor time, from the second frame on

    def advance_frame(self) -> None:
        """Raises TooSlow."""
        begin = process_time()
        super().advance_frame()
        self.spent = 0.0 if self.spent < 0 else self.spent + process_time() - begin
        if self.spent > LONGEST:
            raise TooSlow(self.spent)


def usual(solver: str) -> Solver:
    """A method at its usual substeps and iterations, without damping."""
    return Solver(solver, *USUAL[solver], damping=0.0)


def base(solver: str, rows: int = 9, columns: int = 9, **keys: Any) -> Scene:
    """One square metre of 0.2 kg/m² around the origin, hanging from nothing; `keys` are those of the cloth."""
    cloth = Cloth(rows=rows, columns=columns, width=1.0, height=1.0, center=(0.0, 0.0, 0.0), pins=())
    return Scene(cloth=replace(cloth, **keys), solver=usual(solver))


def structural(scene: Scene, constant: float) -> Scene:
    """The same cloth with springs along rows and columns only [N/m]."""
    springs = replace(scene.springs, shear=0.0, bend=0.0)
    return replace(scene, springs=springs, fabric=Fabric(warp=constant, weft=constant, shear=0.0, bend=0.0))


def strip(solver: str, links: int, *, constant: float, pins: tuple[str | int, ...] = ("top",)) -> Scene:
    """A chain of equal masses and springs, one metre long, as three narrow columns of a sheet that does not bend."""
    scene = base(solver, links + 1, 3, width=0.1, lumping="equal", pins=pins)
    return structural(scene, constant)


def strip_constant(simulation: Simulation) -> float:
    """Constant of the three springs side by side down a strip [N/m]."""
    stiffness = stiffness_of(simulation.scene, simulation.solver.springs, simulation.topology)
    a, b = simulation.topology.ends.T
    return float(stiffness[(a < 3) & (b - a == 3)].sum())


def advance(simulation: Simulation, seconds: float) -> None:
    for _ in range(round(seconds / FRAME_SECONDS)):
        simulation.advance_frame()


def damped(scene: Scene) -> Scene:
    """The same scene with the damping that brings it to rest."""
    return replace(scene, solver=replace(scene.solver, damping=SETTLING))


def center(simulation: Simulation) -> Floats:
    """Centre of mass [m]."""
    mean: Floats = np.average(simulation.positions(), axis=0, weights=simulation.topology.mass)
    return mean


def bottom_middle(x: Floats) -> Floats:
    """The particle in the middle of the last row of a square sheet (N, 3)."""
    side = isqrt(len(x))
    place: Floats = x[-1 - side // 2]
    return place


def substep(simulation: Simulation) -> float:
    """[s]"""
    return FRAME_SECONDS / simulation.substeps


def crossings(values: Floats) -> Floats:
    """Times [frames] at which values, one a frame, change their sign, by straight lines in between."""
    k = np.flatnonzero(values[:-1] * values[1:] < 0)
    times: Floats = k + values[k] / (values[k] - values[k + 1])
    return times


def swing_frames(omega: float) -> int:
    """Frames of two and a half periods, enough for `frequency`."""
    return round(2.5 * 2 * pi / omega / FRAME_SECONDS)


def frequency(seen: list[float], about: float) -> float:
    """ω [rad/s] of A·r^k·cos(ωk/60 + φ), seen once a frame, or not a number where nothing swings.

    x_k+m = 2r^m·cos(ωm/60)·x_k − r^2m·x_k−m by least squares (Prony), with m near a quarter of the period of `about`.
    """
    m = max(1, round(pi / 2 / (about * FRAME_SECONDS)))
    x = np.array(seen)
    (a, b), *_ = np.linalg.lstsq(np.stack([x[m:-m], -x[: -2 * m]], axis=1), x[2 * m :], rcond=None)
    return float(np.arccos(a / (2 * np.sqrt(b))) / (m * FRAME_SECONDS)) if a * a < 4 * b else float("nan")
