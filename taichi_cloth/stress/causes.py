"""Why a variant fails: experiments on the start that failed. Each changes one thing, and finds a cause or does not.

A failure that stays whatever is changed is unexplained.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from ..reference.dynamics import Motion
from ..reference.rest import rest_positions
from ..reference.springs import spring_model
from ..scene import Scene
from ..scene.model import COLLIDERS, FRAME_SECONDS, Solver
from ..solvers import SOLVERS
from ..solvers.base import ExplicitSolver
from .setting import Setting
from .trial import CALM_SECONDS, TooSlow, Trial, close
from .unit import Failure, Result, Unit
from .watch import Broken, Floats

FINER = 8  # times as many iterations, or substeps
SLACK = 0.01  # by how much another run may be worse and have the same cause, as a share
AT_REST = "speed 5 s after"  # the bound of `Trial.settle`
# Limit on the time of all frames of one start of an experiment: ten sheets with 64 times the iterations take hours.
EXPERIMENT_SECONDS = 300.0
STARTS = 3  # from which a mended variant must be alive
STAYS = 0.05  # by how much the largest strain may change where float64 takes a cloth to be at rest, as a share
OUTSIDE = (*COLLIDERS, "ground", "wind", "limit", "self_collision")


@dataclass(frozen=True)
class Cause:
    """What experiments showed about a failure."""

    what: str  # the bound that broke
    most: float  # the value that breaks it, at most
    shown: str  # empty where no experiment found anything
    experiments: int = 0  # how many there were
    origin: str = ""  # of the result that failed: another program may fail for another reason

    def is_of(self, result: Result) -> bool:
        failure = result.failure
        alike = failure is not None and failure.what == self.what and failure.value <= self.most
        return alike and result.origin == self.origin


@dataclass
class Patient(Trial):
    """A trial without a limit on the time of a frame, and with one on that of all frames together."""

    seconds: float = inf  # [s] of all frames

    def _check_time(self) -> None:
        if sum(self.times) > 1e3 * self.seconds:
            raise TooSlow(self.times[-1], self.limit_ms)


@dataclass(frozen=True)
class End:
    """Where a start failed."""

    unit: Unit
    failure: Failure
    scene: Scene
    places: Floats  # [m] (N, 3)
    velocities: Floats  # [m/s] (N, 3)
    substeps: int  # that were taken, which may be more than were asked for
    later: float  # [m/s] fastest particle, five seconds after, where it was too fast at rest


def cause_of(unit: Unit, failure: Failure) -> Cause:
    """The first cause that an experiment finds."""
    end = end_of(unit, failure)
    found = (experiment(end) for experiment in EXPERIMENTS) if end else iter(())
    most = failure.value + SLACK * abs(failure.value)
    return Cause(failure.what, most, next(filter(None, found), ""), len(EXPERIMENTS))


def end_of(unit: Unit, failure: Failure) -> End | None:
    """Runs the start that failed once more, up to there. None where it does not fail alike, or has no cloth."""
    trial = Patient(unit.setting, failure.seed)
    try:
        unit.variant.run(trial)
    except Broken as broken:
        if broken.what != failure.what or not hasattr(trial, "simulation"):
            return None
        simulation = trial.simulation
        x, v = simulation.positions(), simulation.velocities()
        later = speed_later(trial) if AT_REST in failure.what else inf
        return End(unit, failure, simulation.scene, x, v, simulation.substeps, later)
    except Exception:  # of the program: no experiment is about that
        return None
    finally:
        close()
    return None


def speed_later(trial: Trial) -> float:
    """Of the fastest particle [m/s], as the same cloth goes on by itself."""
    for _ in range(round(CALM_SECONDS / FRAME_SECONDS)):
        trial.simulation.advance_frame()
    v = trial.simulation.velocities()[~trial.simulation.topology.pinned]
    return float(np.linalg.norm(v, axis=1).max(initial=0.0))


# -- experiments: what each shows, or nothing ----------------------------------------------------------------------


def another_rest(end: End) -> str:
    """Springs that resist compression have more than one equilibrium. Was the cloth in one of them?

    Newton's method in float64 relaxes it from there: its strain must stay.
    """
    if "strain" not in end.failure.what or outside(end.scene):
        return ""
    model = spring_model(end.scene)
    model = replace(model, topology=replace(model.topology, start=end.places))
    threads = model.topology.family("structural")
    try:
        here, there = (float(model.strains(x)[threads].max()) for x in (model.start, rest_positions(model)))
    except ArithmeticError:
        return ""
    stays = there > end.failure.bound and np.isclose(here, there, rtol=STAYS)
    return (
        f"another equilibrium of the same springs: relaxed in float64 from there, strain {there:.3g}" if stays else ""
    )


def rests_later(end: End) -> str:
    """Light damping may need more time than five seconds."""
    return "" if end.later > end.failure.bound / 2 else f"at rest later: {end.later:.2g} m/s after five more seconds"


def rounded(end: End) -> str:
    """Stiff springs make explicit methods take short substeps, and every substep rounds positions to float32.

    The same substeps in float64 must come to rest from there.
    """
    solver = SOLVERS[end.unit.setting.solver.name]
    if AT_REST not in end.failure.what or not issubclass(solver, ExplicitSolver) or outside(end.scene):
        return ""
    motion = Motion(end.scene, end.substeps)
    motion.x, motion.v = end.places.T.copy(), end.velocities.T.copy()
    for _ in range(round(CALM_SECONDS / FRAME_SECONDS)):
        motion.frame()
        speed = float(np.sqrt((motion.v**2).sum(axis=0).max()))
        if speed <= end.failure.bound / 2:
            return f"rounding to float32: the same substeps in float64 come to rest, {speed:.2g} m/s"
    return ""


def too_few_iterations(end: End) -> str:
    solver = end.unit.setting.solver
    if not SOLVERS[solver.name].iterates:
        return ""
    more = replace(solver, iterations=FINER * solver.iterations)
    return alive_with(end, more, "too few iterations")


def too_few_substeps(end: End) -> str:
    more = replace(end.unit.setting.solver, substeps=FINER * end.substeps)
    return alive_with(end, more, "too few substeps")


def too_few_of_both(end: End) -> str:
    solver = end.unit.setting.solver
    if not SOLVERS[solver.name].iterates:
        return ""
    more = replace(solver, substeps=FINER * end.substeps, iterations=FINER * solver.iterations)
    return alive_with(end, more, "too few substeps and iterations")


def not_swept(end: End) -> str:
    """A fast collider may pass particles within one substep."""
    setting = end.unit.setting
    if setting.swept or not any(getattr(end.scene, kind) for kind in COLLIDERS):
        return ""
    return "colliders are not swept: alive with `swept`" if alive(end, replace(setting, swept=True)) else ""


EXPERIMENTS = (another_rest, rests_later, rounded, not_swept, too_few_iterations, too_few_substeps, too_few_of_both)


def outside(scene: Scene) -> bool:
    """Whether more than springs, bending and weight act on its cloth."""
    return any(getattr(scene, kind) for kind in OUTSIDE)


def alive_with(end: End, solver: Solver, why: str) -> str:
    shown = f"{why}: alive with {solver.substeps}×{solver.iterations}"
    return shown if alive(end, replace(end.unit.setting, solver=solver)) else ""


def alive(end: End, setting: Setting) -> bool:
    """Whether the same start is, with another setting, and others are too: one alone may survive by chance."""
    others = [seed for _, seed in end.unit.starts(STARTS) if seed != end.failure.seed]
    return all(survives(end.unit, setting, seed) for seed in (end.failure.seed, *others[: STARTS - 1]))


def survives(unit: Unit, setting: Setting, seed: int) -> bool:
    trial = Patient(setting, seed, seconds=EXPERIMENT_SECONDS)
    try:
        unit.variant.run(trial)
        trial.check_judged()
    except Exception:  # it breaks a bound too, takes too long, or cannot be run so
        return False
    finally:
        close()
    return True
