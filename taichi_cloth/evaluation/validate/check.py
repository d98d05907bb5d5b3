"""Rows of the report: a known number, its measured value, and the verdict on the difference.

Also the scenes of references, functions that run and measure them, and laws that explain why rows fall short.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import isfinite, isqrt, log, log2, nan, pi, sqrt
from time import process_time
from typing import Any, NamedTuple, SupportsIndex

import numpy as np

from ...geometry.cloth_builder import spring_stiffness
from ...scene.fabric_schema import Fabric
from ...scene.schema import FRAME_SECONDS, Cloth, Scene, Solver
from ...scene.solver_catalog import SOLVER_CATALOG
from ...simulation.convergence import unconverged_fraction
from ...simulation.simulation import Simulation
from .exact import Floats, drum_sag

EXCELLENT, PASS, FAIL, TOO_SLOW = "excellent", "pass", "falls short", "too slow"


class KnownLimit(NamedTuple):
    """The error that a method cannot avoid at a setting, according to theory."""

    law: str  # the formula
    max_error: float
    """Largest error that the law explains in this row's setup."""


@dataclass(frozen=True)
class Check:
    """A measured number and the exact one. `error` has the unit of `tolerance` and `tight_tolerance`."""

    what: str
    """Setup and quantity with its unit, as in "free fall from rest, 1 s: drop [m]"."""
    exact: float
    measured: float
    error: float
    """Relative error, or what `what` says."""
    tolerance: float
    """Largest error that passes."""
    tight_tolerance: float
    """Largest error that is excellent."""
    limit: KnownLimit | None = None
    seconds: float = 0.0
    """Processor time of a setup that was stopped for taking too long [s], otherwise 0."""

    @property
    def verdict(self) -> str:
        """One of EXCELLENT, PASS, FAIL and TOO_SLOW."""
        if self.seconds:
            return TOO_SLOW
        if not isfinite(self.error) or self.error > self.tolerance:
            return FAIL
        return EXCELLENT if self.error <= self.tight_tolerance else PASS

    @property
    def explained(self) -> bool:
        """Whether the row falls short by no more than theory predicts."""
        return self.verdict == FAIL and self.limit is not None and self.error <= self.limit.max_error

    @property
    def unexplained(self) -> bool:
        """Whether the row falls short without a theory, or by more than theory predicts."""
        return self.verdict == FAIL and not self.explained

    @property
    def broken(self) -> bool:
        """Whether the row falls short by more than theory predicts."""
        return self.verdict == FAIL and self.limit is not None and not self.explained

    def by_law(self, law: str, error: float | Callable[[], float], deviation: float | None = None) -> Check:
        """Return the row for a method whose law predicts this error.

        The row may have that error, and deviate from it by `deviation` (default: `tolerance`). A law that predicts an
        error within the tolerance explains nothing and is left out. If `error` is a function, which may take seconds,
        it is called only for a row that falls short.
        """
        if callable(error):
            return self.by_law(law, error(), deviation) if self.verdict == FAIL else self
        if error + (deviation or 0.0) <= self.tolerance:
            return self
        return replace(self, limit=KnownLimit(law, error + (self.tolerance if deviation is None else deviation)))


def relative(what: str, exact: float, measured: float, good: float, best: float) -> Check:
    """Return a row whose error is relative to the exact number."""
    return Check(what, exact, measured, abs(measured - exact) / abs(exact), good, best)


def at_most(what: str, measured: float, good: float, best: float) -> Check:
    """Return a row of a quantity that should be 0."""
    return Check(what, 0.0, measured, abs(measured), good, best)


class TooSlow(Exception):
    """A setup took more processor time [s] than it may."""

    def __init__(self, seconds: float) -> None:
        super().__init__(f"the setup took {seconds:.0f} s of processor time, which is too long")
        self.seconds = seconds


def run_with_limit(what: str, good: float, best: float, measured: Callable[[], Check]) -> Check:
    """Return the row of `measured`, or a row that says that its setup takes too long."""
    return rows_with_limit([what], good, best, lambda: [measured()])[0]


def rows_with_limit(
    whats: Sequence[str], good: float, best: float, measured: Callable[[], Iterable[Check]]
) -> list[Check]:
    """Return the rows of `measured`, one for each of `whats`; all of them are too slow if the setup takes too long."""
    try:
        return list(measured())
    except TooSlow as slow:
        return [Check(what, nan, nan, nan, good, best, seconds=slow.seconds) for what in whats]


@dataclass(frozen=True)
class Reference:
    """A setup with known answers. `run` measures it with a solver and yields a row for each answer."""

    number: str
    """Number in the list of references, such as "A1.1"."""
    name: str
    source: str
    run: Callable[[str], Iterator[Check]]
    solvers: tuple[str, ...]
    """Solvers that have what the setup needs."""


@dataclass(frozen=True)
class Result:
    """A row with its reference and solver, and when it was measured with which program if the others were earlier."""

    number: str
    name: str
    source: str
    solver: str
    row: Check
    later: tuple[str, str] | None = None
    """Date (UTC) and commit."""
    origin: str = ""
    """Digest of the sources that it was measured with; empty if they are not known."""

    @property
    def verdict(self) -> str:
        return self.row.verdict

    @property
    def reference(self) -> str:
        return f"{self.number} {self.name}"


def measure(reference: Reference, solver: str) -> list[Result]:
    """Return all rows of a reference with a solver.

    If a setup takes too long, one row stands for this and all following ones.
    """
    rows = []
    try:
        for row in reference.run(solver):
            rows.append(row)
    except TooSlow as slow:
        rows.append(Check("this row and what comes after it", nan, nan, nan, nan, nan, seconds=slow.seconds))
    return [Result(reference.number, reference.name, reference.source, solver, row) for row in rows]


EULER = tuple(name for name, info in SOLVER_CATALOG.items() if info.euler_steps)  # of free particles too
ELASTIC = ("xpbd", "explicit", "lines", "rk4", "implicit")  # springs have a constant in N/m
ALL = ("verlet", *ELASTIC)


MAX_SECONDS = 90.0  # [s] of processor time that the frames of one setup may take
REST_DAMPING = 3.0  # [1/s] damping that brings a sheet to rest


class Timed(Simulation):
    """A simulation with a limit on the processor time of its frames. The first frame compiles and is not counted."""

    spent = -1.0  # [s] of processor time, from the second frame on; −1 before the first

    def step(self, frames: SupportsIndex = 1) -> None:
        """Advance by some frames. Raises TooSlow if they have taken more than `MAX_SECONDS` in all."""
        begin = process_time()
        super().step(frames)
        self.spent = 0.0 if self.spent < 0 else self.spent + process_time() - begin
        if self.spent > MAX_SECONDS:
            raise TooSlow(self.spent)


def default_solver(solver: str) -> Solver:
    """Return a solver at its default substeps and iterations, without damping."""
    return Solver(solver, *SOLVER_CATALOG[solver].defaults, damping=0.0)


def base(solver: str, rows: int = 9, columns: int = 9, **keys: Any) -> Scene:
    """Return one square meter of cloth of 0.2 kg/m² around the origin, without pins. `keys` are keys of the cloth."""
    cloth = Cloth(rows=rows, columns=columns, width=1.0, height=1.0, center=(0.0, 0.0, 0.0), pins=())
    return Scene(cloth=replace(cloth, **keys), solver=default_solver(solver))


def structural(scene: Scene, constant: float) -> Scene:
    """Return the scene with springs along rows and columns only [N/m]."""
    springs = replace(scene.verlet, shear=0.0, bend=0.0)
    return replace(scene, verlet=springs, fabric=Fabric(warp=constant, weft=constant, shear=0.0, bend_spring=0.0))


def strip(solver: str, links: int, *, constant: float, pins: tuple[str | int, ...] = ("top",)) -> Scene:
    """Return a chain of equal masses and springs, one meter long.

    It consists of three narrow columns of a sheet without resistance to bending.
    """
    scene = base(solver, links + 1, 3, width=0.1, mass_lumping="uniform", pins=pins)
    return structural(scene, constant)


def strip_constant(simulation: Simulation) -> float:
    """Return the total constant of the three parallel springs of a link of a strip [N/m]."""
    stiffness = spring_stiffness(simulation.scene, simulation.solver.info.stiffness_section, simulation.topology)
    a, b = simulation.topology.ends.T
    return float(stiffness[(a < 3) & (b - a == 3)].sum())


def advance(simulation: Simulation, seconds: float) -> None:
    """Advance by a time [s], rounded to frames."""
    for _ in range(round(seconds / FRAME_SECONDS)):
        simulation.step()


def damped(scene: Scene) -> Scene:
    """Return the scene with the damping that brings it to rest."""
    return replace(scene, solver=replace(scene.solver, damping=REST_DAMPING))


def center(simulation: Simulation) -> Floats:
    """Return the center of mass [m], (3,)."""
    mean: Floats = np.average(simulation.positions(), axis=0, weights=simulation.topology.mass)
    return mean


def bottom_middle(x: Floats) -> Floats:
    """Return the position of the middle particle in the last row of a square sheet, from positions (N, 3)."""
    side = isqrt(len(x))
    position: Floats = x[-1 - side // 2]
    return position


def substep(simulation: Simulation) -> float:
    """Return the length of a substep [s]."""
    return FRAME_SECONDS / simulation.substeps


def zero_crossings(values: Floats) -> Floats:
    """Return the times [frames] at which values, one per frame, change sign, by linear interpolation."""
    k = np.flatnonzero(values[:-1] * values[1:] < 0)
    times: Floats = k + values[k] / (values[k] - values[k + 1])
    return times


def swing_frames(omega: float) -> int:
    """Return the number of frames in two and a half periods, enough for `frequency`."""
    return round(2.5 * 2 * pi / omega / FRAME_SECONDS)


def frequency(samples: list[float], about: float) -> float:
    """Return ω [rad/s] of A·r^k·cos(ωk/60 + φ), sampled once per frame, or NaN if the samples do not oscillate.

    It solves x_k+m = 2r^m·cos(ωm/60)·x_k − r^2m·x_k−m by least squares (Prony), with m near a quarter of the period of
    `about` [rad/s].
    """
    m = max(1, round(pi / 2 / (about * FRAME_SECONDS)))
    x = np.array(samples)
    (a, b), *_ = np.linalg.lstsq(np.stack([x[m:-m], -x[: -2 * m]], axis=1), x[2 * m :], rcond=None)
    return float(np.arccos(a / (2 * np.sqrt(b))) / (m * FRAME_SECONDS)) if a * a < 4 * b else float("nan")


# -- laws of iterations that end too early, and of rounding ------------------------------------------------------------

# A substep of Gauss-Seidel (Müller et al. 2007; Macklin et al. 2016, Algorithm 1) solves A·λ = −C for multipliers λ,
# with the length errors C and A = J·M⁻¹·Jᵀ + α/h². It starts at λ = 0, and i iterations with the iteration matrix G
# reach (1 − Gⁱ)·λ∞. If the motion is slow compared to a substep, the λ they reach must carry the cloth: λ = h²·T with
# the tension T. So A·Gⁱ·(1 − Gⁱ)⁻¹·λ of the length errors remains, in addition to the elastic α·T. If T changes little
# from link to link, red-black iterations have G = ρ, and the remainder is the elastic strain times the share of
# `simulation/error_estimate.py`. The effect is that of softer springs: k/(1 + share). If lengths are fixed instead of
# forces, the tension is smaller by the factor 1 + share.
#
# Without compliance (`verlet`, α = 0) k/(1 + share) becomes m·i/h²: the constant of springs that stretch by ½·N²·g·h²/i
# in a hanging sheet. The steps are those of backward Euler: y = x + h·v + h²·g and v = (x' − x)/h.

SOFTER = (
    "iterations end too early, as if springs were softer: m·i/h² (½·N²·g·h²/i), or k over 1 + the unconverged share"
)
# A8: twice the cells change a result by less than 1 % past 32 cells, and by less than 0.1 % past 64.
FINER = {(32, 64): (1e-2, 1e-3), (64, 128): (1e-3, 1e-4)}
UNFINISHED_SOLVERS = ("verlet", "xpbd")  # whose iterations leave springs softer than their constants
GRIDS = "the exact solutions of the two grids differ, with the stiffness that the iterations leave"
SOFTER_EULER = f"{SOFTER}; in backward Euler steps of h"
ROUNDED = "rounding to float32, added up at random over n steps: ½u·√(n/3)·(|x| + |v|·t/√3), u = 2⁻²³"
POSITION_ROUNDED = "rounding to float32 of a position of a meter: ½u, u = 2⁻²³"
VELOCITY_ROUNDED = "rounding to float32 of the positions whose difference over h is the velocity: ⅙u·|x|·n√n, u = 2⁻²³"
ROUNDED_WEIGHT = "float32 rounds the g·h² that a step adds to a position: ½ulp(x)/(g·h²) of the weight below each link"
SAME_ITERATIONS = "the same iterations in float64"  # in laws that repeat the method: its error is none of rounding
FLOAT32_EPSILON = 2.0**-23  # distance from 1 to the next number of float32


def effective_stiffness(solver: str, constant: float, mass: float, h: float, iterations: int) -> float:
    """Return the stiffness [N/m] that springs appear to have if iterations end too early.

    `mass` [kg] is that of a particle. `verlet` does not use `constant` [N/m].
    """
    if solver == "verlet":
        return mass * iterations / h**2
    return constant / (1 + unconverged_fraction(constant, mass, h, iterations))


def unconverged_sag(cells: int, tension: float, constant: float, mass: float, h: float, iterations: int) -> float:
    """Return the excess sag of a taut square, as a share: its lengths are fixed, so its tension is smaller."""
    reduced = tension / (1 + unconverged_fraction(constant, mass, h, iterations))
    return drum_sag(cells, reduced, mass) / drum_sag(cells, tension, mass) - 1


def rounding_error(steps: int, seconds: float, position: float, speed: float) -> float:
    """Return the error [m] by rounding to float32 after some steps, for positions [m] and speeds [m/s] up to these.

    A sum of size |x| is rounded by up to ½u|x|, uniformly distributed: ½u|x|/√3 root mean square. n independent errors
    add up to √n times as much (Henrici 1962, ch. 5). At a constant speed they are not independent and add up to more.
    An error of the velocity acts for the remaining time, on average t/√3 root mean square.
    """
    return FLOAT32_EPSILON / 2 * sqrt(steps / 3) * (position + speed * seconds / sqrt(3))


def order_lost(order: float, coarse: float, floor: float) -> float:
    """Return how much the order of a halving of the step appears reduced if rounding adds `floor` to the smaller error.

    log₂(e/(e/2^p + δ)) is p − log₂(1 + 2^p·δ/e).
    """
    return log2(1 + 2**order * floor / coarse)


def velocity_rounding_error(steps: int, position: float) -> float:
    """Return the error [m] after n steps if the velocity is the difference of two rounded positions [m] over h.

    A position is rounded by ½u|x|/√3 root mean square, and the velocity is wrong by that over h from then on. It acts
    for the remaining time, on average n·h/√3 root mean square, and n independent errors add up to √n times as much.
    """
    return FLOAT32_EPSILON / 2 * position * steps * sqrt(steps) / 3


def largest_of(count: int) -> float:
    """Return about how large the largest of many normal numbers is, in standard deviations (Leadbetter 1983)."""
    return sqrt(2 * log(count))
