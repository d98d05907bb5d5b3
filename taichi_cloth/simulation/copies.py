"""Measurements on copies of a running cloth, which does not change: what each feature costs, and the error of a frame.

Cost of a feature: all features of a frame run in one kernel, so no timer can separate them. A scene without a feature
is another kernel, which is compiled first. Both scenes run on copies of the cloth, from the current frame.
`taichi-cloth ablate` measures costs with the same function, `feature_cost`, from the end of a motion.
`bench --features` times more than two scenes at once.

Error of a frame: a copy takes over the state before the frame, with grabs, wind and colliders, and runs the same frame
with `explicit`, which converges to the motion of the fabric's springs as the substeps get shorter. It runs it twice,
the second time with twice the substeps. The error is the distance between the cloth after its own frame and after the
second run; the distance between the two runs estimates the error of the reference. The solver `verlet` has stiffnesses
without unit, so its error includes that of its model.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import ceil, inf
from statistics import median

import numpy as np
from numpy.typing import NDArray

from ..scene import parameters_of
from ..scene.overrides import removable_sections, scene_without
from ..scene.schema import FRAME_SECONDS
from .grabbing import Grab
from .running_cloth import time_frames
from .simulation import Simulation

Floats = NDArray[np.float64]


def take_over(copy: Simulation, running: Simulation, but: frozenset[str] = frozenset()) -> None:
    """Copy the state of the running cloth with its parameters `but` some, pins and torn springs, but not its grabs."""
    for index in np.flatnonzero(copy.topology.pinned != running.topology.pinned):
        (copy.pin if running.topology.pinned[index] else copy.unpin)(int(index))
    for name in parameters_of(copy.scene).keys() & parameters_of(running.scene).keys() - but:
        copy.params[name] = running.params[name]
    copy.untear(running.torn)
    copy.params["wind"] = running.params["wind"]
    copy.frame = running.frame
    copy.set_state(running.positions(), running.velocities())


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
    with Simulation(running.scene, layout) as full:
        full.step()  # compiles
        for feature in removable_sections(running.scene):
            with Simulation(scene_without(running.scene, [feature]), layout) as reduced:
                reduced.step()
                for copy in (full, reduced):
                    take_over(copy, running)
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


# -- error of a frame --------------------------------------------------------------------------------------------------

MAX_REFINEMENT = 16  # of the reference: most substeps, in multiples of the fewest stable ones
GOAL_SECONDS = 0.02  # time of a reference frame up to which it is refined
MAX_SECONDS = 0.25  # time of a reference frame above which errors are not measured
SLOW_TRIES = 2  # reference frames that must take longer than that: another program may have delayed one
SHARE_OF_FRAME = 0.1  # of the time of a frame that measuring may take on average
OF_SOLVER = frozenset({"substeps", "iterations"})  # parameters that the reference has of its own
SLICE_SECONDS = 5e-4  # time of a slice of a reference frame, which is not interrupted


@dataclass(frozen=True)
class FrameError:
    """The error of one frame. Distances are root mean squares over all particles."""

    frame: int
    """Number of the frame."""
    error: float
    """Distance from the reference [m]."""
    motion: float
    """Distance that the cloth moved in the frame [m]."""
    reference_error: float
    """Distance between the reference and one with half its substeps [m]."""
    by_particle: Floats
    """Distance of each particle from the reference [m], (N,)."""


class Reference(Simulation):
    """A copy that runs single frames with `explicit`, with a multiple of the substeps that it needs to be stable."""

    def __init__(self, running: Simulation) -> None:
        self.refinement = 1
        solver = replace(running.scene.solver, name="explicit", substeps=1, iterations=1)
        super().__init__(replace(running.scene, solver=solver), running.requested_layout)
        self.step()  # compiles

    @property
    def substeps(self) -> int:
        return self.refinement * self.min_stable_substeps

    def start_from(self, running: Simulation) -> None:
        """Take over the state of the running cloth, with its grabs."""
        take_over(self, running, OF_SOLVER)
        grabs = running.grabs.items()
        self.set_grabs({k: Grab(g.particles, g.rest_positions, g.start, g.target, g.history) for k, g in grabs})
        self.depenetration.reduction = running.depenetration.reduction.copy()
        self._start = self.positions(), self.velocities(), self.depenetration.reduction.copy()

    def slices(self, refinement: int) -> Iterator[Floats]:
        """Run the frame from its start, and yield the positions after each slice, (N, 3) [m]."""
        self.refinement = refinement
        x, v, self.depenetration.reduction = self._start
        self.place(x)
        self.solver.set_velocities(v, self.h)
        frame, first, count = self._frame_input(), 0, 1
        while first < frame.substeps:
            began, last = time.perf_counter(), min(first + count, frame.substeps)
            self.solver.step(replace(frame, span=(first, last)))
            x = self.positions()
            seconds = (time.perf_counter() - began) / (last - first)
            first, count = last, max(int(SLICE_SECONDS / seconds), 1)
            yield x


class FrameErrorMeter:
    """Measures the error of single frames of a running cloth, which makes the same bits as without.

    `run_frame` measures as many frames as a tenth of the time allows, each in slices after the following frames.
    """

    def __init__(self, running: Simulation) -> None:
        """Compile the reference. Raises UsageError if the fabric is too stiff for it."""
        self._running = running
        self._reference = Reference(running)
        # At least four times the substeps of the running cloth, in the finer of the two runs.
        self._refinement = max(1, ceil(2 * running.substeps / self._reference.min_stable_substeps))
        self._work: Iterator[None] | None = None
        self._slow = 0
        self._credit = 0.0  # [s] that may be spent
        self.result: FrameError | None = None
        """The last error that was measured."""
        self.seconds = 0.0
        """Time of the last reference frame, both runs [s]."""

    @property
    def is_too_slow(self) -> bool:
        """Whether a reference frame takes longer than `MAX_SECONDS`: no error is measured then."""
        return self._slow >= SLOW_TRIES

    def run_frame(self, step: Callable[[], object]) -> None:
        """Run one frame by calling `step`, and measure within the allowed time."""
        self._credit += SHARE_OF_FRAME * FRAME_SECONDS
        began = time.perf_counter()
        measured = self._work is None and self._credit > 0 and not self.is_too_slow
        if measured:
            self._begin()
        self._credit -= time.perf_counter() - began
        step()
        began = time.perf_counter()
        if measured:
            self._end()
        if self._work is not None and self._credit > 0:
            self._continue(self._credit)
        self._credit -= time.perf_counter() - began

    def measure_frame(self, step: Callable[[], object] | None = None) -> FrameError:
        """Run one frame, by calling `step` if there is one, and return its error, however long that takes."""
        self._begin()
        (step or self._running.step)()
        self._end()
        self._continue(inf)
        assert self.result is not None
        return self.result

    def _begin(self) -> None:
        self._reference.start_from(self._running)
        self._before = self._running.positions()
        self._work = self._measure()

    def _end(self) -> None:
        self._after, self._frame = self._running.positions(), self._running.frame

    def _continue(self, seconds: float) -> None:
        """Continue with the reference frame for about this time [s]."""
        end = time.perf_counter() + seconds
        for _ in self._work or ():
            if time.perf_counter() >= end:
                return
        self._work = None

    def _measure(self) -> Iterator[None]:
        """Run the reference frame twice, and store the result. Yields after each slice."""
        runs, self.seconds = [], 0.0
        for refinement in (self._refinement, 2 * self._refinement):
            slices, x = self._reference.slices(refinement), self._before
            while True:
                began = time.perf_counter()
                following = next(slices, None)
                self.seconds += time.perf_counter() - began
                if following is None:
                    break
                x = following
                yield
            runs.append(x)
        distances = np.linalg.norm(self._after - runs[1], axis=1)
        self.result = FrameError(
            self._frame,
            rms(distances),
            rms(np.linalg.norm(self._after - self._before, axis=1)),
            rms(np.linalg.norm(runs[1] - runs[0], axis=1)),
            distances,
        )
        self._slow = self._slow + 1 if self.seconds > MAX_SECONDS else 0
        if 2 * self.seconds < GOAL_SECONDS and 4 * self._refinement <= MAX_REFINEMENT:
            self._refinement *= 2

    def close(self) -> None:
        """Release the copy."""
        self._reference.close()


def rms(distances: Floats) -> float:
    """Return the root mean square of distances."""
    return float(np.sqrt(np.mean(distances**2)))
