"""Causes of failures, found by experiments on the start that failed. Each experiment tests one possible cause.

A failure that no experiment explains is reported as unexplained.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from time import process_time
from typing import Any

import numpy as np

from ...geometry.spring_model import spring_model
from ...scene import Scene
from ...scene.schema import COLLIDERS, FRAME_SECONDS, Solver
from ...simulation.parameter_values import with_values
from ...solvers import SOLVERS
from ...solvers.base import ExplicitSolver
from ..reference.solution import Motion, steps_per_frame
from ..reference.static_solution import rest_positions
from .invariants import Floats, Violation
from .setup import Setting
from .trial import CALM_FRAMES, CALM_SECONDS, REST_SPEED, REST_STRAIN, STILL_SECONDS, Trial, UntimedTrial, close
from .unit import Failure, Result, Unit

FINER = 4  # factor on the number of iterations or substeps; 8 takes four times as long for both together
SLACK = 0.01  # relative margin: a failure of another run that is worse by no more has the same cause
DRIFTS = "drift"  # the bound on the displacement of cloth at rest, of case 32
EXPERIMENT_SECONDS = 120.0  # limit on all frames of one start: with 16 times as many iterations it can take an hour
STARTS = 3  # number of starts that must survive with the change
STARTS_IF_SOME_SURVIVE = 10  # the same if the first start survived without it: others may too, and would prove nothing
STAYS = 0.05  # relative change of the largest strain in float64 up to which the cloth was in equilibrium
# Sections of a scene that act on its cloth besides springs, bending and gravity.
OUTSIDE = (*COLLIDERS, "ground", "wind", "strain_limit", "self_collision", "attachments", "tearing")


@dataclass(frozen=True)
class Cause:
    """The result of the experiments on one failure."""

    what: str
    """The violated bound."""
    most: float
    """The largest value that this cause explains."""
    shown: str
    """The cause in words; empty if no experiment found one."""
    experiments: int = 0
    """Number of experiments that there were."""
    origin: str = ""
    """Fingerprint of the failed result: another version of the program may fail for another reason."""
    seconds: float = 0.0
    """CPU time of the experiments [s]; 0 if it was not measured."""

    @property
    def is_final(self) -> bool:
        """Whether no experiment is left: one found the cause, or all have run."""
        return bool(self.shown) or self.experiments >= len(EXPERIMENTS)

    def is_of(self, result: Result) -> bool:
        """Return whether this cause explains the failure of a result."""
        failure = result.failure
        alike = failure is not None and failure.what == self.what and failure.value <= self.most
        return alike and result.origin == self.origin


@dataclass(frozen=True)
class FailedState:
    """The state of the cloth in which a start failed."""

    unit: Unit
    failure: Failure
    scene: Scene
    positions: Floats
    """Positions [m], (N, 3)."""
    velocities: Floats
    """Velocities [m/s], (N, 3)."""
    substeps: int
    """Substeps per frame that were run: the solver may need more than were requested."""
    later: float
    """Speed of the fastest particle after five more seconds [m/s]. Infinite unless it was too fast at rest."""
    disturbed: tuple[Floats, Floats, int] | None = None
    """Positions [m], velocities [m/s] and frame of the last disturbance, after which the cloth had to come to rest."""


@dataclass
class RepeatedTrial(UntimedTrial):
    """A trial that keeps the state after the last disturbance: from there the cloth has to come to rest."""

    disturbed: tuple[Floats, Floats, int] | None = None

    def settle(self, **how: Any) -> None:
        self.disturbed = self.simulation.positions(), self.simulation.velocities(), self.frame
        super().settle(**how)


def cause_of(unit: Unit, failure: Failure, tried: int = 0) -> Cause:
    """Run the experiments in order, but the first `tried`, and return the first cause that one finds."""
    begin = process_time()
    end = end_of(unit, failure)
    found = (experiment(end) for experiment in EXPERIMENTS[tried:]) if end else iter(())
    most, shown = failure.value + SLACK * abs(failure.value), next(filter(None, found), "")
    return Cause(failure.what, most, shown, len(EXPERIMENTS), seconds=process_time() - begin)


def end_of(unit: Unit, failure: Failure) -> FailedState | None:
    """Repeat the failed start up to its failure, and return the state of the cloth there.

    Returns None if it does not fail at the same bound, or fails before a scene is open.
    """
    trial = RepeatedTrial(unit.setting, failure.seed)
    try:
        unit.variant.run(trial)
        trial.finish()
    except Violation as broken:
        if broken.what != failure.what or not hasattr(trial, "simulation"):
            return None
        simulation = trial.simulation
        x, v = simulation.positions(), simulation.velocities()
        scene = with_values(simulation.scene, simulation.params, simulation.built.damping_time)
        later = speed_later(trial) if failure.what == REST_SPEED else inf
        return FailedState(unit, failure, scene, x, v, simulation.substeps, later, trial.disturbed)
    except Exception:  # an error of the program: no experiment explains it
        return None
    finally:
        close()
    return None


def speed_later(trial: Trial) -> float:
    """Advance the cloth by five more seconds, and return the speed of its fastest free particle [m/s]."""
    for _ in range(round(CALM_SECONDS / FRAME_SECONDS)):
        trial.simulation.step()
    v = trial.simulation.velocities()[~trial.simulation.topology.pinned]
    return float(np.linalg.norm(v, axis=1).max(initial=0.0))


# -- experiments: each returns the cause in words, or an empty string --------------------------------------------------


def another_rest(end: FailedState) -> str:
    """Test whether the cloth is in another equilibrium: springs that resist compression have more than one.

    Newton's method in float64 relaxes the cloth from the failed state. In an equilibrium its largest strain changes by
    no more than `STAYS`.
    """
    if "strain" not in end.failure.what or outside(end.scene):
        return ""
    model = spring_model(end.scene)
    model = replace(model, topology=replace(model.topology, start=end.positions))
    structural = model.topology.family("structural")
    try:
        here, there = (float(model.strains(x)[structural].max()) for x in (model.start, rest_positions(model)))
    except ArithmeticError:
        return ""
    stays = there > end.failure.bound and np.isclose(here, there, rtol=STAYS)
    return (
        f"another equilibrium of the same springs: relaxed in float64 from there, strain {there:.3g}" if stays else ""
    )


def rests_later(end: FailedState) -> str:
    """Test whether the cloth is at rest after five more seconds: light damping may need the time."""
    return "" if end.later > end.failure.bound / 2 else f"at rest later: {end.later:.2g} m/s after five more seconds"


def in_float64(end: FailedState) -> str:
    """Continue in float64 from the failed state."""
    if outside(end.scene):
        return ""
    return float32_rounding(end) or exact_motion_drifts(end)


def float32_rounding(end: FailedState) -> str:
    """Test for rounding: explicit solvers need short substeps for stiff springs, and each rounds positions to float32.

    The same substeps in float64 must bring the cloth to rest.
    """
    solver = SOLVERS[end.unit.setting.solver.name]
    if end.failure.what != REST_SPEED or not issubclass(solver, ExplicitSolver):
        return ""
    motion = Motion(end.scene, end.substeps)
    motion.x, motion.v = end.positions.T.copy(), end.velocities.T.copy()
    for _ in range(round(CALM_SECONDS / FRAME_SECONDS)):
        motion.step_frame()
        speed = float(np.sqrt((motion.v**2).sum(axis=0).max()))
        if speed <= end.failure.bound / 2:
            return f"rounding to float32: the same substeps in float64 come to rest, {speed:.2g} m/s"
    return ""


def exact_motion_drifts(end: FailedState) -> str:
    """Test whether converged steps drift as far in as much time: the cloth is not in equilibrium yet, or not stably."""
    if DRIFTS not in end.failure.what or end.unit.setting.solver.name == "verlet":  # which has other springs
        return ""
    motion, begin = Motion(end.scene, steps_per_frame(end.scene)), process_time()
    motion.x, motion.v = end.positions.T.copy(), end.velocities.T.copy()
    for frame in range(1, end.failure.frame - round(STILL_SECONDS / FRAME_SECONDS) + 1):
        drift = float(np.abs(motion.step_frame() - end.positions).max())
        if drift > end.failure.bound:
            return f"the exact motion drifts too: {drift:.2g} m in {frame * FRAME_SECONDS:.3g} s more, in float64"
        if process_time() - begin > EXPERIMENT_SECONDS:
            break
    return ""


def exact_motion_is_not_at_rest(end: FailedState) -> str:
    """Test whether converged steps from the last disturbance are not at rest either, by as much.

    Damping leaves a part of a large swing, whatever the solver.
    """
    of_springs = not outside(end.scene) and end.unit.setting.solver.name != "verlet"
    if not of_springs or end.disturbed is None or end.failure.what not in (REST_STRAIN, REST_SPEED):
        return ""
    motion, begin = Motion(end.scene, steps_per_frame(end.scene)), process_time()
    x, v, begun = end.disturbed
    motion.x, motion.v = x.T.copy(), v.T.copy()
    model, judged, largest = spring_model(end.scene), round(CALM_SECONDS / FRAME_SECONDS) - CALM_FRAMES, 0.0
    structural = model.topology.family("structural")
    for k in range(max(end.failure.frame - begun, judged + CALM_FRAMES)):
        motion.step_frame()
        if k >= judged:
            strain = float(model.strains(motion.x)[structural].max())
            speed = float(np.sqrt((motion.v**2).sum(axis=0).max()))
            largest = max(largest, strain if end.failure.what == REST_STRAIN else speed)
        if process_time() - begin > EXPERIMENT_SECONDS:
            return ""
    if largest <= end.failure.bound or end.failure.value > largest * (1 + SLACK):
        return ""
    return f"the exact motion is not at rest either: {end.failure.what} {largest:.4g}, in float64"


def too_few_iterations(end: FailedState) -> str:
    """Test with `FINER` times the iterations."""
    solver = end.unit.setting.solver
    if SOLVERS[solver.name].info.is_explicit:
        return ""
    more = replace(solver, iterations=FINER * solver.iterations)
    return alive_with(end, more, "too few iterations")


def too_few_substeps(end: FailedState) -> str:
    """Test with `FINER` times the substeps."""
    more = replace(end.unit.setting.solver, substeps=FINER * end.substeps)
    return alive_with(end, more, "too few substeps")


def too_few_of_both(end: FailedState) -> str:
    """Test with `FINER` times the substeps and `FINER` times the iterations."""
    solver = end.unit.setting.solver
    if SOLVERS[solver.name].info.is_explicit:
        return ""
    more = replace(solver, substeps=FINER * end.substeps, iterations=FINER * solver.iterations)
    return alive_with(end, more, "too few substeps and iterations")


def not_continuous(end: FailedState) -> str:
    """Test with continuous collision detection: a fast collider may pass particles within one substep.

    It explains particles that went through, and energy of those that are pushed out. Strain at rest has other causes.
    """
    setting = end.unit.setting
    fits = any(word in end.failure.what for word in ("through", "energy"))
    if not fits or setting.continuous or not any(getattr(end.scene, kind) for kind in COLLIDERS):
        return ""
    return (
        "no continuous collision detection: alive with `continuous`"
        if alive(end, replace(setting, continuous=True))
        else ""
    )


# New ones are added at the end: failures that the earlier ones did not explain are then examined by the new ones only.
EXPERIMENTS = (
    another_rest,
    rests_later,
    in_float64,
    not_continuous,
    too_few_iterations,
    too_few_substeps,
    too_few_of_both,
    exact_motion_is_not_at_rest,
)


def outside(scene: Scene) -> bool:
    """Return whether more than springs, bending and gravity act on the cloth of a scene."""
    return any(getattr(scene, kind) for kind in OUTSIDE)


def alive_with(end: FailedState, solver: Solver, why: str) -> str:
    """Return the cause `why` if the failed start survives with these solver settings, else an empty string."""
    explanation = f"{why}: alive with {solver.substeps}×{solver.iterations}"
    return explanation if alive(end, replace(end.unit.setting, solver=solver)) else ""


def alive(end: FailedState, setting: Setting) -> bool:
    """Return whether the failed start survives with another setting, and enough other starts do.

    One start alone may survive by chance.
    """
    count = STARTS_IF_SOME_SURVIVE if end.failure.start else STARTS
    others = [seed for _, seed in end.unit.starts(count) if seed != end.failure.seed]
    frames = end.failure.frame
    return all(survives(end.unit, setting, seed, frames) for seed in (end.failure.seed, *others[: count - 1]))


def survives(unit: Unit, setting: Setting, seed: int, least_frames: int) -> bool:
    """Return whether the start of a seed survives with a setting. It has at least `least_frames` frames."""
    trial = UntimedTrial(setting, seed, seconds=EXPERIMENT_SECONDS, least_frames=least_frames)
    try:
        unit.variant.run(trial)
        trial.finish()
    except Exception:  # it violates a bound too, takes too long, or cannot run with this setting
        return False
    finally:
        close()
    return True
