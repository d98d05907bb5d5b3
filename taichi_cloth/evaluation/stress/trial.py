"""One start of a variant with one setting.

A case changes its cloth through the public interface of `Simulation`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from statistics import median

import numpy as np

from ...scene import parameters_of
from ...scene.schema import FRAME_SECONDS, Scene
from ...simulation.simulation import Simulation
from .invariants import Extremes, Floats, InvariantMonitor, Violation
from .setup import Setting, static_strain

CASE_SECONDS = 10.0  # for which a case runs at least
CALM_SECONDS = 5.0  # time to come to rest after a disturbance
STILL_SECONDS = 20.0  # time after which cloth at rest may no longer drift
CALM_FRAMES = 15  # frames at the end of that time that must all be at rest
CALM_STRAIN = 0.01  # excess over the static strain at rest
CALM_SPEED = 0.1  # [m/s] of the fastest particle at rest
REST_STRAIN, REST_SPEED = "strain 5 s after", "speed 5 s after [m/s]"  # figures of nearly every variant
INTERSECTIONS = "intersections at the end"
SHAKE = 0.02  # [m/s] amplitude of the random velocities of a start
SHIFT = 0.01  # [m] amplitude of the random translation of a start without pins
SLOW_MS = 1000 / 30  # limit for a frame, for interactive use; a slower variant is stopped
TIMED_FRAMES = 5  # frames after which their median is checked; the first, which may compile kernels, does not count
TIMED_ENOUGH_MS = 1000.0  # total time after which fewer frames are enough
TIMED_EVERY = 60  # frames after which the median of the last frames of the scene is checked again
TIMED_WINDOW = 600  # of these frames, 10 s: a check of a long run takes no longer than one of a short run


@dataclass
class Measurement:
    """A value that a case records, with its bound if it has one."""

    what: str
    value: float
    bound: float | None

    @property
    def excess(self) -> float:
        """The value over its bound, or over 0 if it has none."""
        return self.value - (self.bound or 0.0)


def add_worst(figures: list[Measurement], new: Measurement) -> None:
    """Add a measurement, or replace the one of the same quantity if its excess is smaller. NaN counts as largest."""
    for k, old in enumerate(figures):
        if old.what == new.what:
            if not new.excess <= old.excess:
                figures[k] = new
            return
    figures.append(new)


class TooSlow(Exception):
    """A frame takes longer than the limit of the variant."""

    def __init__(self, ms: float, limit: float) -> None:
        super().__init__(f"{ms:.0f} ms a frame")
        self.ms, self.limit = ms, limit


@dataclass
class Trial:
    """One run of a case: it opens a scene, starts it, runs it and checks it. All random numbers depend on the seed."""

    setting: Setting
    seed: int
    figures: list[Measurement] = field(default_factory=list)
    worst: Extremes = field(default_factory=Extremes)
    frame: int = 0
    notes: list[str] = field(default_factory=list)
    """What this trial judges differently, and why."""
    times: list[float] = field(default_factory=list)
    """Times of frames [ms], without the first of each scene and without those run substep by substep."""
    limit_ms: float = SLOW_MS
    max_rest_strain: float = field(init=False)
    """Bound on the strain at rest."""
    simulation: Simulation = field(init=False)
    watch: InvariantMonitor = field(init=False)

    def __post_init__(self) -> None:
        self.random = np.random.default_rng(self.seed)
        self._first = True  # the next frame is the first of its scene
        self._timed_from = 0  # index in `times` of the first time of the scene
        self._needs_rest_check = False
        self._max_rest_speed: float | None = None  # [m/s] bound of the last scene, if it was checked at rest

    # -- starting ------------------------------------------------------------------------------------------------------

    def open(
        self, scene: Scene, *, far: float = 0.0, rest: Scene | None = None, rest_strain: float | None = None
    ) -> Floats:
        """Open a scene with this setting, and return its start positions [m], (N, 3).

        At rest the strain may exceed the static strain of the scene `rest` (default: this scene) by `CALM_STRAIN`, or
        may reach the bound `rest_strain`. `far` [m] as for `InvariantMonitor`. Raises ValueError if a bound is not
        finite, and RuntimeError if the scene opened before was not checked at rest.
        """
        self.require_rest_check()
        with_setting = self.setting.of(scene)
        if rest_strain is not None:
            if not np.isfinite(rest_strain):
                raise ValueError("rest_strain must be finite")
            self.max_rest_strain = rest_strain
        else:
            still = with_setting if rest is None else self.setting.of(rest)
            self.max_rest_strain = static_strain(still) + CALM_STRAIN
        self.simulation = opened(with_setting)
        self.watch = InvariantMonitor(self.simulation, self.worst, far)
        self.limit_ms, self._first, self._needs_rest_check = SLOW_MS, True, True
        self._timed_from, self._max_rest_speed = len(self.times), None
        return self.simulation.topology.start.copy()

    def start(
        self, positions: Floats | None = None, velocity: Sequence[float] = (0.0, 0.0, 0.0), shake: float = SHAKE
    ) -> None:
        """Start at `positions` [m], (N, 3), or at those of the scene.

        All particles get `velocity` [m/s] and a random velocity of up to `shake` [m/s] along each axis. Cloth without
        pins is also translated randomly by up to `SHIFT`. So no two starts are equal.
        """
        topology = self.simulation.topology
        x = topology.start.copy() if positions is None else positions
        if not topology.pinned.any():
            x = x + self.random.uniform(-SHIFT, SHIFT, 3)
        self.simulation.set_state(x, self.random.uniform(-shake, shake, x.shape) + np.asarray(velocity))
        self.watch.begin()

    def frame_limit_ms(self, ms: float, reason: str) -> None:
        """Set the limit on the time of a frame of this scene [ms]."""
        self.limit_ms = ms
        self.note(f"up to {ms:g} ms a frame: {reason}")

    def skip_rest_check(self, reason: str) -> None:
        """Declare that this scene is checked only after each frame: it has no time to come to rest."""
        self._needs_rest_check = False
        self.note(f"not judged at rest: {reason}")

    def note(self, line: str) -> None:
        """Add a note to the result, once."""
        if line not in self.notes:
            self.notes.append(line)

    def require_rest_check(self) -> None:
        """Raise RuntimeError if a scene was opened and never checked at rest, which is an error of the case."""
        if self._needs_rest_check:
            raise RuntimeError("a case opened a scene and called neither settle() nor skip_rest_check()")

    # -- running -------------------------------------------------------------------------------------------------------

    def change(self, change: Callable[[], object]) -> None:
        """Change the cloth between two frames. The change of its energy counts as work done on it."""
        before = self.energy()
        change()
        self.watch.add_work(self.energy() - before)
        self.watch.read_colliders()

    def energy(self) -> float:
        """Return the energy of the cloth [J]."""
        return self.watch.energy(self.simulation.positions(), self.simulation.velocities())

    def run(self, seconds: float, *, driven: bool = False) -> None:
        """Run frames for a time [s]. `driven`: a grab moves in them."""
        for _ in range(round(seconds / FRAME_SECONDS)):
            self.one_frame(driven=driven)

    def one_frame(self, *, driven: bool = False, look: Callable[[float], object] | None = None) -> None:
        """Run one frame and check it. Raises Violation and TooSlow.

        `driven`: a grab moves in this frame. `look` is called after each substep, as by `step_by_substep`. A frame run
        substep by substep is not timed: its time would include `look` and one kernel launch per substep.
        """
        simulation, watch = self.simulation, self.watch
        if driven:
            watch.begin_grab_work()

            def after_substep(share: float) -> None:
                watch.add_grab_work()
                if look is not None:
                    look(share)

            simulation.step_by_substep(after_substep)
        elif look is not None:
            simulation.step_by_substep(look)
        else:
            self._timed_step()
        self.frame += 1
        watch.check_frame()
        self._check_time()
        if self.setting.tear is not None:
            self.record("torn [%]", 100 * float(simulation.torn.mean()))

    def _timed_step(self) -> None:
        """Run one frame and append its time."""
        wall_start, cpu_start = time.perf_counter(), time.process_time()
        self.simulation.step()
        # Wall time counts other programs on the machine, and CPU time counts every thread: the smaller is the frame's.
        seconds = min(time.perf_counter() - wall_start, time.process_time() - cpu_start)
        if not self._first:  # the first may compile kernels
            self.times.append(1e3 * seconds)
        self._first = False

    def _check_time(self) -> None:
        """Raise TooSlow if the median time of the scene's last frames is over the limit. Checked early and often."""
        count = len(self.times) - self._timed_from
        few = 0 < count < TIMED_FRAMES and sum(self.times[self._timed_from :]) > TIMED_ENOUGH_MS
        if few or count == TIMED_FRAMES or (count and count % TIMED_EVERY == 0):
            ms = median(self.times[-min(count, TIMED_WINDOW) :])
            if ms > self.limit_ms:
                raise TooSlow(ms, self.limit_ms)

    def change_solver(self, name: str) -> None:
        """Switch to another solver, which has springs of its own, for the same cloth."""

        def change() -> None:
            self.simulation.switch_solver(name)
            self.watch.read_springs()

        self.change(change)

    def change_scene(self, scene: Scene) -> None:
        """Continue the same sheet with the fabric, masses and colliders of another scene."""

        def change() -> None:
            self.simulation.switch_scene(self.setting.of(scene))
            self.watch.read_scene()

        self.change(change)

    def set_pins(self, positions: Floats) -> None:
        """Move the pins to positions [m], in the order of their indices, between two frames."""
        simulation = self.simulation
        pinned = simulation.topology.pinned
        x, v = simulation.positions(), simulation.velocities()
        x[pinned] = positions

        def set_pins() -> None:
            simulation.set_state(x, v)

        self.change(set_pins)
        self.watch.set_pin_positions(positions)

    def move_pins(self, positions: Floats, seconds: float) -> None:
        """Run for a time [s] while the pins move straight to positions [m]."""
        start = self.simulation.positions()[self.simulation.topology.pinned]
        frames = max(1, round(seconds / FRAME_SECONDS))
        for k in range(frames):
            self.set_pins(start + (positions - start) * (k + 1) / frames)
            self.one_frame()

    def settle(self, *, max_speed: float = CALM_SPEED, after_frame: Callable[[], object] | None = None) -> None:
        """Run `CALM_SECONDS` after the last disturbance, and check that the cloth is at rest in the last `CALM_FRAMES`.

        Torn cloth is not checked, because pieces of it fall. `max_speed` [m/s] is the bound on the speed, for cloth
        that something still moves. `after_frame` is called after each frame. Raises Violation, and ValueError if
        `max_speed` is not finite.
        """
        if not np.isfinite(max_speed):
            raise ValueError("max_speed must be finite")
        self._needs_rest_check, self._max_rest_speed = False, max_speed
        frames = round(CALM_SECONDS / FRAME_SECONDS)
        for k in range(frames):
            self.one_frame()
            if after_frame is not None:
                after_frame()
            if k >= frames - CALM_FRAMES:
                self._check_rest(max_speed)

    def finish(self) -> None:
        """Run until the end of `CASE_SECONDS`, and check that the cloth stays at rest.

        Call it at the end of a case. A scene that `skip_rest_check` is for runs no further. Raises Violation, TooSlow,
        and RuntimeError as `require_rest_check`.
        """
        self.require_rest_check()
        while self._max_rest_speed is not None and self.frame < round(CASE_SECONDS / FRAME_SECONDS):
            self.one_frame()
            self._check_rest(self._max_rest_speed)

    def _check_rest(self, max_speed: float) -> None:
        """Check that the cloth is at rest, unless it is torn."""
        if not self.simulation.torn.any():
            self.record(REST_STRAIN, self.watch.strain, self.max_rest_strain)
            self.record(REST_SPEED, self.watch.speed, max_speed)

    # -- checking ------------------------------------------------------------------------------------------------------

    def record(self, what: str, value: float, bound: float | None = None) -> None:
        """Record a quantity for the report, which shows the largest excess over its bound. Raises Violation above 0."""
        if bound is not None and not np.isfinite(bound):
            raise ValueError(f"{what}: the bound must be finite, or None")
        add_worst(self.figures, Measurement(what, value, bound))
        if bound is not None:
            self.check(what, value, bound)

    def expect_error(self, what: str, attempt: Callable[[], object]) -> None:
        """Try an invalid call. Raises Violation unless it raises ValueError with a message that contains `what`."""
        try:
            attempt()
        except ValueError as error:
            self.check(f"refusals of {what} that do not name it", what not in str(error), 0)
        else:
            raise Violation(f"{what} is not refused", 1, 0)

    def check(self, what: str, value: float, bound: float) -> None:
        """Raise Violation unless the value is at most the bound. NaN fails."""
        if not value <= bound:
            raise Violation(what, value, bound)


@dataclass
class UntimedTrial(Trial):
    """A trial without a limit on the time of a frame, but with one on all frames together [s]."""

    seconds: float = np.inf
    least_frames: int = 0
    """Frames that it will have at least: it ends once these will take too long."""

    def _check_time(self) -> None:
        count, ms = len(self.times), sum(self.times)
        if count >= TIMED_FRAMES:
            ms *= max(1.0, self.least_frames / count)
        if ms > 1e3 * self.seconds:
            raise TooSlow(ms, 1e3 * self.seconds)


_opened: list[Simulation] = []  # the last simulation, kept for the next start


def opened(scene: Scene) -> Simulation:
    """Return a simulation of a scene at its start. Reuses the last one if its scene is equal."""
    if _opened and _opened[0].scene == scene:
        simulation = _opened[0]
        for name, key in parameters_of(scene).items():
            simulation.params[name] = key.value
        if scene.wind is not None:
            simulation.params["wind"] = True
        simulation.reset()
        return simulation
    close()
    _opened.append(Simulation(scene))
    return _opened[0]


def close() -> None:
    """Close the simulation that `opened` keeps."""
    while _opened:
        _opened.pop().close()
