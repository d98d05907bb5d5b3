"""Errors of frames while a scene runs, measured by another process.

The process has a Taichi of its own, so neither compiling its copies nor a slow reference delays the display. It runs at
low priority, and for at most a tenth of the time.
"""

from __future__ import annotations

import os
import signal
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import connection, get_context
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..scene import Scene
from ..scene.schema import FRAME_SECONDS
from ..simulation.convergence import VERLET_MODEL, unconverged
from ..simulation.copies import (
    HORIZON,
    MAX_SECONDS,
    FrameError,
    FrameErrorMeter,
    FrameStart,
    millimeters,
    parts_text,
    share_text,
)
from ..simulation.simulation import Simulation
from ..system import taichi_runtime as runtime
from ..system.errors import UsageError

if TYPE_CHECKING:
    from multiprocessing.context import SpawnProcess

SHARE_OF_TIME = 0.1  # of one core, which measuring may take
STALE_SECONDS = 3.0  # [s] after which a frame of an earlier scene is given up: it may compile for a minute
FRAMES_BEFORE = 60  # frames that a scene runs before the process starts: the first second of a window is its own
SETTLED_SECONDS = 0.3  # [s] after a change in which no measurement begins: another abandons it while a slider moves
ABANDON = "abandon"  # sent to the process: drop the measurement that is under way, at its next frame
ABANDONED_SECONDS = 1.0  # limit of the time after which another frame is measured, after one was abandoned
RECENT = 9  # measured frames whose median is shown: errors of single frames scatter, most of all with `xpbd`
MAX_GROWTH_SECONDS = 3.0  # time up to which the growth of the error is measured
NICENESS = 10  # of the process, where the system has priorities


@dataclass(frozen=True)
class Job:
    """One frame to measure."""

    scene: Scene
    layout: str | None
    start: FrameStart
    after: NDArray[np.float64]
    """Positions after the frame [m], (N, 3)."""

    @classmethod
    def of(cls, simulation: Simulation, start: FrameStart) -> Job:
        """Return the job to measure the last frame of a simulation, which led on from `start`."""
        return cls(simulation.scene, simulation.requested_layout, start, simulation.positions())


@dataclass(frozen=True)
class Answer:
    """What was measured of a job, or why nothing was."""

    error: FrameError | None = None
    growth: float | None = None
    """Distance from the reference `HORIZON` frames later [m] (`FrameErrorMeter.growth`), if there was time."""
    refusal: str = ""
    is_final: bool = False
    """Whether no other frame of this scene can be measured."""
    seconds: float = 0.0
    """Processor time that it took, without compiling [s]."""


class ErrorProcess:
    """Measures frames of a running cloth one after another. The cloth makes the same bits as without."""

    def __init__(self) -> None:
        self.answer: Answer | None = None
        """The last measurement of the scene that runs."""
        self.before_change: FrameError | None = None
        """The last error before the cloth was changed otherwise than by a frame; None after another scene."""
        self.recent: deque[float] = deque(maxlen=RECENT)
        """The last errors [m] since the cloth was changed otherwise than by a frame."""
        self.by_solver: dict[str, str] = {}
        """The median error of each solver that was measured, as text; cleared with another scene."""
        self.is_held = False
        """Whether no frame is to be measured now, also if the process is free."""
        self._frames = 0
        self._scene: Scene | None = None
        self._is_busy = False  # with a job
        self._is_stale = False  # whether the answer to that job will be dropped
        self._is_starting = False  # whether the process is not ready for a job
        self._sent = 0.0  # wall time of that job [s]
        self._sent_scene: Scene | None = None  # of that job
        self._took: float | None = None  # wall time of the last measurement of this scene [s]
        self._next = 0.0  # wall time of the next job [s]
        self._process: SpawnProcess | None = None
        self._pipe: connection.Connection | None = None

    def run_frame(self, simulation: Simulation) -> None:
        """Run one frame, and have it measured if the process is free and has time left."""
        self._frames += 1
        if simulation.scene is not self._scene:
            self.forget()
            self._scene, self._took = simulation.scene, None
        self.receive()
        if self.is_held or not self.is_free:
            simulation.step()
            return
        start = FrameStart.of(simulation)
        simulation.step()
        self._send(Job.of(simulation, start))

    def forget(self) -> None:
        """Drop the last measurement, and the one that is under way: the cloth has changed otherwise than by a frame."""
        if self._pipe is not None and self._is_busy and not self._is_stale:
            with suppress(OSError):
                self._pipe.send(ABANDON)
        self.before_change = self.error or self.before_change
        self.answer, self._is_stale = None, True
        self.recent.clear()
        self._wait(SETTLED_SECONDS)

    def _wait(self, seconds: float) -> None:
        """Let no measurement begin for some time [s]."""
        self._next = max(self._next, time.perf_counter() + seconds)

    @property
    def state(self) -> str:
        """What the process does while there is no answer, with the time that it has taken: it may have to compile."""
        if not self._is_busy:
            pause = self._next - time.perf_counter()
            return "not measured yet" + (f": the next in {pause:.0f} s" if pause > 1 else "")
        seconds = f"{time.perf_counter() - self._sent:.0f} s"
        if self._is_starting:
            return f"not measured yet: starting ({seconds})"
        if self._is_stale:
            return f"not measured yet: busy with a frame before the change ({seconds})"
        whole = f" of about {self._took:.0f} s" if self._took else ""
        return f"being measured ({seconds}{whole})"

    @property
    def error(self) -> FrameError | None:
        """The last error of a frame that was measured, if it was not refused and the reference has converged."""
        found = self.answer and not self.answer.refusal and self.answer.error
        return found if found and found.reference_has_converged else None

    @property
    def is_refused(self) -> bool:
        """Whether no frame of this scene can be measured."""
        return self.answer is not None and self.answer.is_final

    @property
    def is_free(self) -> bool:
        """Whether the process can measure the next frame."""
        is_refused, waits = self.is_refused, self._frames <= FRAMES_BEFORE or time.perf_counter() < self._next
        return not (is_refused or waits or self._is_busy)

    def _send(self, job: Job) -> None:
        try:
            if self._pipe is None:
                self._start()
            else:
                self._pipe.send(job)
                self._is_stale, self._sent_scene = False, self._scene
            self._is_busy, self._sent = True, time.perf_counter()
        except OSError as error:
            self.answer = Answer(refusal=f"the process that measures it has ended ({error})", is_final=True)

    def _start(self) -> None:
        context = get_context("spawn")
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=serve, args=(other,), daemon=True, name="taichi_cloth errors")
        self._process.start()
        other.close()
        # Its first answer, which is dropped, says that it is ready. Before, a large job would block until it is.
        self._is_starting = self._is_stale = True

    def receive(self) -> None:
        """Take over the answer to the last job, if it has come."""
        if not self._is_busy or self._pipe is None:
            return
        try:
            if not self._pipe.poll():
                self._give_up_stale_job()
                return
            answer: Answer = self._pipe.recv()
        except (EOFError, OSError):
            answer = Answer(refusal="the process that measures it has ended", is_final=True)
        if not self._is_stale:
            self.answer = answer
            self._add(self.error)
        self._took = self._took if self._is_stale else time.perf_counter() - self._sent
        self._is_busy = self._is_starting = False
        self._wait(answer.seconds * (1 / SHARE_OF_TIME - 1))

    def _add(self, found: FrameError | None) -> None:
        """Add the error of a frame to those of its solver, if it was measured."""
        if found is None:
            return
        self.recent.append(found.error)
        if self._sent_scene:
            typical = replace(found, error=float(np.median(self.recent)))
            self.by_solver[self._sent_scene.solver.name] = short_text(typical)

    def _give_up_stale_job(self) -> None:
        """End the process if it works for another scene and takes long; the next job starts a process."""
        is_of_this_scene = self._is_starting or self._sent_scene is self._scene
        if not is_of_this_scene and time.perf_counter() - self._sent > STALE_SECONDS:
            self.close()
            self._is_busy = False

    def close(self) -> None:
        """End the process."""
        if self._pipe is not None and self._process is not None:
            self._pipe.close()
            self._process.terminate()
            self._process.join(1.0)
        self._pipe = self._process = None


MEASURED_AGAINST = "  against a fine run with explicit"


def short_text(found: FrameError) -> str:
    """Return the error of a frame in a few letters."""
    return millimeters(found.error) if found.is_resolved else f"< {millimeters(2 * found.reference_error)}"


def error_lines(meter: ErrorProcess | None, *, frozen: bool = False) -> list[str]:
    """Return the last error of a frame that was measured, or one line that says why none was.

    After it that of the particle with the largest, then its parts. `frozen`: no frame runs that could be measured.
    """
    if meter is None:
        return ["error of a frame: not measured (U)"]
    if meter.answer is None:
        before = meter.before_change
        earlier = f"; before the change: {millimeters(before.error)}" if before else ""
        wait = "; frozen: N runs a frame" if frozen and not meter._is_busy else ""
        return [f"error of a frame: {meter.state}{wait}{earlier}"]
    found, growth = meter.answer.error, meter.answer.growth
    if found is None or meter.answer.refusal:
        return [f"error of a frame: not measured: {meter.answer.refusal}"]
    error = f"error of frame {found.frame}: {millimeters(found.error)} RMS{share_text(found.error, found.motion)}"
    if (count := len(meter.recent)) > 2:
        error += f"; median of {count} frames: {millimeters(float(np.median(meter.recent)))}"
    parts = parts_text(found.error, found.residual, found.step_error)
    estimate = [] if growth is None else [f"  estimate for 1 s without input: {millimeters(growth)}"]
    if not found.reference_has_converged:
        return [f"error of frame {found.frame}: not measured: the reference has not converged"]
    if not found.is_resolved:
        return [
            f"error of frame {found.frame}: below {millimeters(2 * found.reference_error)}, as exact as the reference"
        ]
    largest = f"  largest error of a particle: {millimeters(found.by_particle.max())}"
    return [error, largest, f"  {parts}", *estimate]


def unfinished(simulation: Simulation) -> str:
    """Return a line about iterations that end too early, or that cannot converge to the fabric; empty for others."""
    h = FRAME_SECONDS / simulation.substeps
    few = unconverged(simulation.scene, simulation.topology, h, int(simulation.params["iterations"]))
    return "; ".join(filter(None, [few, VERLET_MODEL * (simulation.scene.solver.name == "verlet")]))


# -- the process -------------------------------------------------------------------------------------------------------


def serve(pipe: connection.Connection) -> None:
    """Answer jobs until the other end of the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    runtime.start("cpu", cpu_max_num_threads=1)
    measurer = Measurer(pipe.poll)
    with suppress(EOFError, OSError):
        pipe.send(Answer())
        while True:
            if (job := pipe.recv()) != ABANDON:  # which may come after its answer was sent
                pipe.send(measurer.answer(job))


class Abandoned(Exception):
    """The measurement that is under way is not needed any more."""


class InterruptibleMeter(FrameErrorMeter):
    """A meter whose measurements end with `Abandoned`, before a frame of its copies, once they are not needed."""

    def __init__(self, scene: Scene, layout: str | None, is_abandoned: Callable[[], bool]) -> None:
        super().__init__(scene, layout)
        for copy in (self._same, self._reference):
            vars(copy)["step"] = partial(self._step, copy.step, is_abandoned)

    @staticmethod
    def _step(step: Callable[[], None], is_abandoned: Callable[[], bool], frames: int = 1) -> None:
        for _ in range(frames):
            if is_abandoned():
                raise Abandoned
            step()


class Measurer:
    """Answers jobs with copies of the scene, which are compiled when the scene changes."""

    def __init__(self, is_abandoned: Callable[[], bool] = lambda: False) -> None:
        """`is_abandoned`: called before each frame of a copy; if true, the answer to the present job is empty."""
        self._is_abandoned = is_abandoned
        self._scene: Scene | None = None
        self._meter: FrameErrorMeter | None = None
        self._refusal = ""

    def answer(self, job: Job) -> Answer:
        """Measure a frame, and then the growth of its error if it does not take too long."""
        self._began = time.process_time()
        try:
            return self._with_growth(job)
        except Abandoned:
            used = min(time.process_time() - self._began, ABANDONED_SECONDS)
            return Answer(seconds=used / (1 / SHARE_OF_TIME - 1))  # so that the next begins after as much time

    def _with_growth(self, job: Job) -> Answer:
        found, began = self.measure(job), time.process_time()  # after compiling
        # The reference ran three times the coarser substeps.
        if self._meter and found.error and not found.refusal and HORIZON * found.seconds / 3 < MAX_GROWTH_SECONDS:
            growth = self._meter.growth(job.start)
            found = replace(found, growth=growth, seconds=found.seconds + time.process_time() - began)
        return found

    def measure(self, job: Job) -> Answer:
        """Measure a frame."""
        try:
            self._open(job)
        except UsageError as refused:
            self._refusal = str(refused)
        if self._meter is None or self._refusal:
            return Answer(refusal=self._refusal, is_final=True)
        error, refusal = self._meter.measure(job.start, job.after), ""
        if error.seconds > MAX_SECONDS:
            refusal = f"its reference takes {error.seconds:.1f} s"
        elif not np.isfinite(error.error):
            refusal = "its reference diverges"
        return Answer(error, refusal=refusal, seconds=error.seconds)

    def _open(self, job: Job) -> None:
        if job.scene == self._scene:
            return
        self.close()
        self._scene, self._refusal = job.scene, ""
        self._meter = InterruptibleMeter(job.scene, job.layout, self._is_abandoned)

    def close(self) -> None:
        """Release the copies."""
        if self._meter is not None:
            self._meter.close()
        self._meter = None
