"""Copies of a running cloth, which does not change: what each feature costs, and the error of a frame.

Cost of a feature: all features of a frame run in one kernel, so no timer can separate them. A scene without a feature
is another kernel, which is compiled first. Both scenes run on copies of the cloth, from the current frame.
`taichi-cloth ablate` measures costs with the same function, `feature_cost`, from the end of a motion.
`bench --features` times more than two scenes at once.

Error of a frame (docs/frame_error.md): copies take over the state before the frame, with grabs, wind and colliders, and
run the same frame

- with `explicit`, which converges to the motion of the fabric's springs as the substeps get shorter, with the damping
  that the solver applies (`Simulation.warnings` says what it leaves out). It runs twice, the second time with twice the
  substeps. The error is the distance between the cloth after its own frame and after the second run; the distance
  between the two runs estimates the error of the reference;
- with the solver of the cloth and many more iterations. The distance of the cloth from this frame is what the
  iterations lack, the residual; the distance of this frame from the reference is the error of substeps and model. The
  solver `verlet` has stiffnesses without unit, so it has an error of its model.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil
from statistics import median

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..geometry.tearing import TearState
from ..scene import Scene
from ..scene.overrides import removable_sections, scene_without
from ..solvers import FrameInput
from ..system.errors import UsageError
from .frame_contact import Displacement
from .grabbing import Grab
from .parameter_values import check_vectors
from .running_cloth import RunningCloth
from .simulation import Simulation

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class FrameStart:
    """All that determines a frame of a scene. Copies of arrays: it can be sent to another process."""

    frame: int
    positions: Floats
    velocities: Floats
    params: dict[str, float]
    wind_on: bool
    pinned: Flags
    torn: NDArray[np.int32]
    """Ends of the torn springs, (K, 2): a copy with another solver may have other springs."""
    grabs: dict[int, Grab]
    displacements: dict[int, Displacement]
    depenetration: Floats
    """Depths from which colliders let the cloth out slowly (`Depenetration.reduction`)."""

    @classmethod
    def of(cls, running: RunningCloth) -> FrameStart:
        """Return the start of the next frame of a running cloth."""
        grabs = {k: Grab(g.particles, g.rest_positions, g.start, g.target, g.history) for k, g in running.grabs.items()}
        torn = np.flatnonzero(running.torn)
        return cls(
            frame=running.frame,
            positions=running.positions(),
            velocities=running.velocities(),
            params={name: float(running.params[name]) for name in running.params.known()},
            wind_on=running.params.wind_on,
            pinned=running.topology.pinned.copy(),
            torn=running.built.topology.ends[torn],
            grabs=grabs,
            displacements=dict(running.displacements),
            depenetration=running.depenetration.reduction.copy(),
        )


class Copy(Simulation):
    """A copy of a running cloth, which may have another solver."""

    refinement = 1
    """Factor by which its substeps are more than its scene has."""
    iteration_factor = 1
    """Factor by which its iterations are more than its scene has."""

    @property
    def substeps(self) -> int:
        return self.refinement * super().substeps

    def _frame_input(self) -> FrameInput:
        frame = super()._frame_input()
        return replace(frame, iterations=self.iteration_factor * frame.iterations)

    def start_from(self, start: FrameStart, but: frozenset[str] = frozenset()) -> None:
        """Take over a state with its parameters, those that this scene has, `but` some."""
        self.set_pins(start.pinned)  # all at once: each change builds the cloth again
        known = self.params.known()
        for name in start.params.keys() & known.keys() - but:
            self.params[name] = int(start.params[name]) if known[name].is_int else start.params[name]
        if self.scene.wind is not None:
            self.params["wind"] = start.wind_on
        self.set_torn(TearState(self.built.topology, start.torn).torn if len(start.torn) else False)
        self.set_frame(start.frame)
        self._move_to(start.positions, start.velocities)
        self.set_grabs(
            {k: Grab(g.particles, g.rest_positions, g.start, g.target, g.history) for k, g in start.grabs.items()}
        )
        if len(start.depenetration) == len(self.depenetration.reduction):  # else a collider was removed
            self.depenetration.reduction = start.depenetration.copy()
            self.displacements = dict(start.displacements)

    def _move_to(self, positions: Floats, velocities: Floats) -> None:
        """Set all positions and velocities, also if the cloth intersects itself, which `set_state` may refuse."""
        shape = self.topology.start.shape
        x, v = check_vectors(positions, "positions", shape), check_vectors(velocities, "velocities", shape)
        v[self.topology.pinned] = 0.0
        self.grabs = {}
        self.place(x)
        self.solver.set_velocities(v, self.h)
        self.depenetration.invalidate()

    def end_of_frame(self, start: FrameStart, but: frozenset[str] = frozenset()) -> Floats:
        """Run one frame, and return the positions after it, (N, 3) [m]. Arguments as for `start_from`."""
        self.start_from(start, but)
        self.step()
        return self.positions()


class Reference(Copy):
    """A copy with the whole damping of its springs, however many substeps it takes."""

    reduces_damping = False


# -- cost of features --------------------------------------------------------------------------------------------------

FRAMES, SECONDS = 60, 0.5  # limits for one feature: frames of each copy, and wall time [s]


@dataclass(frozen=True)
class FeatureTimes:
    """Median frame times [ms]."""

    frame: int
    """Number of the first frame that was timed."""
    ms: float
    """A frame with all features [ms]."""
    cost_ms: dict[str, float]
    """The time that a frame saves without a feature [ms], by feature; negative if it takes longer."""


def feature_times(running: Simulation, layout: str | None = None) -> FeatureTimes:
    """Time every feature that the running scene can do without. The running simulation does not change.

    `layout`: the layout, as for `Simulation`. Raises UsageError if the scene cannot run without one of them.
    """
    cost_ms, all_ms = {}, []
    start = replace(FrameStart.of(running), grabs={})
    with Copy(running.scene, layout) as full:
        full.step()  # compiles
        for feature in removable_sections(running.scene):
            with Copy(scene_without(running.scene, [feature]), layout) as reduced:
                reduced.step()
                full.start_from(start)
                reduced.start_from(start)
                ms, cost_ms[feature] = feature_cost(full, reduced, FRAMES, SECONDS)
            all_ms.append(ms)
    return FeatureTimes(running.frame, median(all_ms) if all_ms else 0.0, cost_ms)


def feature_cost(full: Simulation, reduced: Simulation, frames: int, seconds: float) -> tuple[float, float]:
    """Return the median frame time of `full` [ms], and how much of it `reduced`, without a feature, saves [ms].

    Both run up to `frames` frames for about `seconds` [s] in all. They take turns, so that a busy period of the machine
    affects both equally.
    """
    with_feature, without = (median(times) for times in time_frames([full, reduced], frames, seconds))
    return with_feature, with_feature - without


def timed_frame(simulation: RunningCloth) -> float:
    """Run one frame and return its time [ms]."""
    start = time.perf_counter()
    simulation.step()
    ti.sync()
    return 1e3 * (time.perf_counter() - start)


def time_frames(simulations: Sequence[RunningCloth], count: int, seconds: float) -> list[list[float]]:
    """Run up to `count` frames of each, at least one, in turns, for about `seconds` [s]. Return their times [ms]."""
    ms: list[list[float]] = [[] for _ in simulations]
    end = time.perf_counter() + seconds
    while len(ms[0]) < count and (not ms[0] or time.perf_counter() < end):
        for simulation, times in zip(simulations, ms, strict=True):
            times.append(timed_frame(simulation))
    return ms


# -- error of a frame --------------------------------------------------------------------------------------------------

MAX_REFINEMENT = 16  # of the reference: most substeps, in multiples of the fewest stable ones
GOAL_SECONDS = 0.05  # time of a reference frame up to which it is refined
MANY_ITERATIONS = 16  # factor of the iterations that count as converged
MAX_SUBSTEPS = 5000  # that the reference may need to be stable
MAX_SECONDS = 1.0  # time of a measurement above which errors are not measured
HORIZON = 60  # frames of `FrameErrorMeter.growth`
COARSE = 0.1, 1e-4  # error of a reference that has not converged: share of the motion in the frame, and at least [m]
OF_SOLVER = frozenset({"substeps", "iterations"})  # parameters that the reference has of its own


@dataclass(frozen=True)
class FrameError:
    """The error of one frame. Distances are root mean squares over all particles."""

    frame: int
    """Number of the frame."""
    error: float
    """Distance from the reference [m], root mean square over all particles, as all distances here."""
    motion: float
    """Distance that the cloth moved in the frame [m]."""
    reference_error: float
    """Distance between the reference and one with half its substeps [m]."""
    residual: float | None
    """Distance from the same frame with converged iterations [m]; None for a solver that does not iterate."""
    step_error: float
    """Distance of the frame with converged iterations from the reference [m]: of substeps and model."""
    by_particle: Floats = field(repr=False)
    """Distance of each particle from the reference [m], (N,)."""
    seconds: float
    """Processor time of the measurement [s]. What else runs on the machine does not count."""

    @property
    def reference_has_converged(self) -> bool:
        """Whether the reference tells the error: its own is less than half of it, or small against the motion."""
        share, least = COARSE
        return 2 * self.reference_error < max(self.error, share * self.motion, least)

    @property
    def is_resolved(self) -> bool:
        """Whether the error is more than what the reference can tell."""
        return self.error >= 2 * self.reference_error

    @property
    def parts(self) -> dict[str, float | None]:
        """Its distances [m] by name, and whether the reference has converged."""
        names = ("error", "motion", "reference_error", "residual", "step_error", "reference_has_converged")
        return {name: getattr(self, name) for name in names}


def median_parts(found: Iterable[Mapping[str, float | None]]) -> dict[str, float | None]:
    """Return the medians of `FrameError.parts` [m] over frames whose reference has converged; None without any."""
    converged = [parts for parts in found if parts["reference_has_converged"]]
    medians: dict[str, float | None] = {}
    for name in ("error", "motion", "residual", "step_error"):
        values = [value for parts in converged if (value := parts[name]) is not None]
        medians[name] = float(np.median(values)) if values else None
    return medians


def share_text(error: float, motion: float) -> str:
    """Return an error [m] as a share of what the cloth moved [m], as the rest of a line."""
    if error > motion:
        return ", more than the cloth moved"  # it rests
    share = f"{100 * error / motion:.2g}" if error < 0.995 * motion else "100"
    return f", {share} % of its motion" if motion > 0 else ""


def parts_text(error: float, residual: float | None, step_error: float) -> str:
    """Return the parts of an error [m] as text."""
    steps = f"by substeps and model {millimeters(step_error)}"
    parts = steps if residual is None else f"by iterations {millimeters(residual)}, {steps}"
    return parts + (", which partly cancel" if max(step_error, residual or 0.0) > 1.5 * error else "")


def millimeters(distance: float) -> str:
    """Return a distance [m] as text, with two significant digits up to 100 mm."""
    return f"{1e3 * distance:.2g} mm" if distance < 0.0995 else f"{1e3 * distance:.0f} mm"


class FrameErrorMeter:
    """Measures the error of single frames of a scene on two copies, one with the reference and one with its solver."""

    def __init__(self, scene: Scene, layout: str | None = None) -> None:
        """Compile both. Raises UsageError if the fabric is too stiff, or too much damped, for the reference."""
        self._same = Copy(scene, layout)
        try:
            self._reference = self._open_reference(scene, layout)
        except BaseException:
            self._same.close()
            raise
        for copy in (self._reference, self._same):
            copy.end_of_frame(FrameStart.of(copy))

    def _open_reference(self, scene: Scene, layout: str | None) -> Reference:
        """Return the reference, with as much damping of springs as the solver of the scene has."""
        solver = replace(scene.solver, name="explicit", substeps=1, iterations=1)
        damping = self._same.built.damping_time if self._same.solver.info.uses_si_constants else 0.0
        reference = Reference(replace(scene, solver=solver, fabric=replace(scene.fabric, damping_time=damping)), layout)
        if (substeps := reference.min_stable_substeps) > MAX_SUBSTEPS:
            reference.close()
            raise UsageError(
                f"its reference would need {substeps:,} substeps, more than {MAX_SUBSTEPS:,};"
                " softer springs, less damping of them or larger cells need fewer"
            )
        return reference

    def measure(self, start: FrameStart, after: Floats) -> FrameError:
        """Return the error of the frame that led from `start` to the positions `after`, (N, 3) [m]."""
        began, same, reference = time.process_time(), self._same, self._reference
        converged = after
        if iterates := not same.solver.info.is_explicit:
            same.iteration_factor = MANY_ITERATIONS
            converged = same.end_of_frame(start)
        runs, refinement = [], self._refinement(start)
        began_reference = time.process_time()
        for reference.refinement in (refinement, 2 * refinement):
            runs.append(reference.end_of_frame(start, OF_SOLVER))
        if 2 * (time.process_time() - began_reference) < GOAL_SECONDS and 4 * refinement <= MAX_REFINEMENT:
            self._least_refinement = 2 * refinement
        distances = np.linalg.norm(after - runs[1], axis=1)
        return FrameError(
            frame=start.frame + 1,
            error=rms(distances),
            motion=rms_distance(after, start.positions),
            reference_error=rms_distance(*runs),
            residual=rms_distance(after, converged) if iterates else None,
            step_error=rms_distance(converged, runs[1]),
            by_particle=distances,
            seconds=time.process_time() - began,
        )

    _least_refinement = 1

    def _refinement(self, start: FrameStart) -> int:
        """Return the refinement of the coarser reference.

        The finer one has at least four times the substeps of the cloth.
        """
        substeps = max(int(start.params["substeps"]), self._same.min_stable_substeps)
        return max(self._least_refinement, ceil(2 * substeps / self._reference.min_stable_substeps))

    def measure_frame(self, running: Simulation, step: Callable[[], object] | None = None) -> FrameError:
        """Run one frame of a simulation of the scene, by calling `step` if there is one, and return its error."""
        start = FrameStart.of(running)
        (step or running.step)()
        return self.measure(start, running.positions())

    def growth(self, start: FrameStart) -> float:
        """Return the distance of the cloth from the reference after `HORIZON` frames, root mean square [m].

        Grabs stay where they are. An estimate of what the errors of frames become: the cloth may do something else.
        """
        self._same.iteration_factor, self._reference.refinement = 1, 2 * self._refinement(start)
        held = {k: Grab(g.particles, g.rest_positions, g.start, g.start, [g.start]) for k, g in start.grabs.items()}
        ends = []
        for copy, but in ((self._same, frozenset[str]()), (self._reference, OF_SOLVER)):
            copy.start_from(replace(start, grabs=held), but)
            copy.step(HORIZON)
            ends.append(copy.positions())
        return rms_distance(*ends)

    def close(self) -> None:
        """Release the copies."""
        self._reference.close()
        self._same.close()


def rms_distance(a: Floats, b: Floats) -> float:
    """Return the root mean square of the distances between two sets of positions, (N, 3) each."""
    return rms(np.linalg.norm(a - b, axis=1))


def rms(distances: Floats) -> float:
    """Return the root mean square of distances."""
    return float(np.sqrt(np.mean(distances**2)))
