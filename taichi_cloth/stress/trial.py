"""One start of a variant with one setting: what a case does to its cloth, through the calls that everybody has."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from statistics import median

import numpy as np

from ..scene import Scene, live_keys
from ..scene.model import FRAME_SECONDS
from ..simulation import Simulation
from .rest import static_strain
from .setting import Setting
from .watch import Broken, Floats, Watch, Worst

CALM_SECONDS = 5.0  # after a disturbance, to be still again
CALM_FRAMES = 15  # that must all be still, at the end
CALM_STRAIN = 0.01  # above the static strain
CALM_SPEED = 0.1  # [m/s]
SHAKE = 0.02  # [m/s] of the velocities that make starts differ
SHIFT = 0.01  # [m] of the places, where nothing is pinned
SLOW_MS = 1000 / 30  # a frame: nobody can use slower ones interactively, and a variant with such is not run to its end
TIMED_FRAMES = 5  # after the first, which may compile: from so many on, their median is what a frame takes
TIMED_ENOUGH_MS = 1000.0  # of fewer frames than that
TIMED_EVERY = 60  # frames, after which the median of all of the scene's is looked at again


class TooSlow(Exception):
    """A frame takes longer than the variant allows."""

    def __init__(self, ms: float, limit: float) -> None:
        super().__init__(f"{ms:.0f} ms a frame")
        self.ms, self.limit = ms, limit


@dataclass
class Figure:
    """What a row of the list asks for besides: a number, and its bound if it has one."""

    what: str
    value: float
    bound: float | None


@dataclass
class Trial:
    """A case opens a scene, starts it, and lets it run. The seed decides all that is random in it."""

    setting: Setting
    seed: int
    figures: list[Figure] = field(default_factory=list)
    worst: Worst = field(default_factory=Worst)
    frame: int = 0
    notes: list[str] = field(default_factory=list)  # what is judged otherwise than usual, and why
    times: list[float] = field(default_factory=list)  # [ms] of frames, without each scene's first and those in steps
    limit_ms: float = SLOW_MS
    most_strain: float = field(init=False)
    simulation: Simulation = field(init=False)
    watch: Watch = field(init=False)

    def __post_init__(self) -> None:
        self.random = np.random.default_rng(self.seed)
        self._first, self._timed_from = True, 0  # of the scene's frames
        self._unjudged = False

    # -- starting --------------------------------------------------------------------------------------

    def open(
        self, scene: Scene, *, far: float = 0.0, rest: Scene | None = None, rest_strain: float | None = None
    ) -> Floats:
        """The scene with this setting, at its start, which is returned (N, 3) [m]; `far` as for `Watch`.

        `rest` is the scene whose static strain the cloth must come back to, its own unless given. `rest_strain` is the
        bound on the strain at rest itself.
        """
        self.check_judged()
        own = self.setting.of(scene)
        if rest_strain is not None:
            if not np.isfinite(rest_strain):
                raise ValueError("the strain at rest needs a finite bound")
            self.most_strain = rest_strain
        else:
            still = own if rest is None else self.setting.of(rest)
            self.most_strain = static_strain(still) + CALM_STRAIN
        self.simulation = opened(own)
        self.watch = Watch(self.simulation, self.worst, far)
        self.limit_ms, self._first, self._unjudged = SLOW_MS, True, True
        self._timed_from = len(self.times)
        return self.simulation.topology.start.copy()

    def start(
        self, places: Floats | None = None, velocity: Sequence[float] = (0.0, 0.0, 0.0), shake: float = SHAKE
    ) -> None:
        """Begins with these places, or as the scene does, a little shaken [m/s]: no two starts are alike."""
        topology = self.simulation.topology
        x = topology.start.copy() if places is None else places
        if not topology.pinned.any():
            x = x + self.random.uniform(-SHIFT, SHIFT, 3)
        self.simulation.place(x, self.random.uniform(-shake, shake, x.shape) + np.asarray(velocity))
        self.watch.begin()

    def frame_limit_ms(self, ms: float, reason: str) -> None:
        """Lets a frame of this scene take so long."""
        self.limit_ms = ms
        self.note(f"up to {ms:g} ms a frame: {reason}")

    def only_frames(self, reason: str) -> None:
        """This scene is judged in its frames alone: it has no time to come to rest."""
        self._unjudged = False
        self.note(f"not judged at rest: {reason}")

    def note(self, line: str) -> None:
        if line not in self.notes:
            self.notes.append(line)

    def check_judged(self) -> None:
        """Raises RuntimeError where a scene was opened and never judged at rest: that is a mistake of its case."""
        if self._unjudged:
            raise RuntimeError("a case opened a scene and neither let it settle nor said why it cannot")

    # -- running ---------------------------------------------------------------------------------------

    def act(self, change: Callable[[], object]) -> None:
        """Does something to the cloth between two frames. The energy that changes by it was given, or taken."""
        before = self.energy()
        change()
        self.watch.given(self.energy() - before)
        self.watch.look_at_colliders()

    def energy(self) -> float:
        return self.watch.energy(self.simulation.positions(), self.simulation.velocities())

    def run(self, seconds: float, *, driven: bool = False) -> None:
        for _ in range(round(seconds / FRAME_SECONDS)):
            self.one_frame(driven=driven)

    def one_frame(self, *, driven: bool = False, look: Callable[[float], object] | None = None) -> None:
        """One frame, and the watch looks; `look` does after every substep, as `Simulation.advance_slowly` says.

        `driven`: a hand moves in this frame. A frame that is looked at after every substep is not timed: the time would
        be that of the look, and of a launch a substep, which nobody else has.
        """
        simulation, watch = self.simulation, self.watch
        if driven:
            watch.begin_hand_work()

            def see(share: float) -> None:
                watch.add_hand_work()
                if look is not None:
                    look(share)

            simulation.advance_slowly(see)
        elif look is not None:
            simulation.advance_slowly(look)
        else:
            self._advance_timed()
        self.frame += 1
        watch.look()
        self._check_time()
        if self.setting.tear is not None:
            self.tell("torn [%]", 100 * float(simulation.torn.mean()))

    def _advance_timed(self) -> None:
        start, busy = time.perf_counter(), time.process_time()
        self.simulation.advance_frame()
        # Both agree but for other programs on the machine, or for more than one thread.
        took = min(time.perf_counter() - start, time.process_time() - busy)
        if not self._first:  # the first may compile
            self.times.append(1e3 * took)
        self._first = False

    def _check_time(self) -> None:
        """Raises TooSlow, where the median of the scene's frames so far is over the limit: soon, and now and then."""
        count = len(self.times) - self._timed_from
        few = 0 < count < TIMED_FRAMES and sum(self.times[self._timed_from :]) > TIMED_ENOUGH_MS
        if few or count == TIMED_FRAMES or (count and count % TIMED_EVERY == 0):
            ms = median(self.times[self._timed_from :])
            if ms > self.limit_ms:
                raise TooSlow(ms, self.limit_ms)

    def change_solver(self, name: str) -> None:
        """Another method for the same cloth, with springs of its own."""

        def change() -> None:
            self.simulation.change_solver(name)
            self.watch.springs_are_others()

        self.act(change)

    def change_scene(self, scene: Scene) -> None:
        """The same sheet goes on with the fabric, the masses and the colliders of another scene."""

        def change() -> None:
            self.simulation.change(self.setting.of(scene))
            self.watch.scene_is_another()

        self.act(change)

    def lead_pins(self, places: Floats) -> None:
        """Puts the pins elsewhere [m], in the order of their numbers, between two frames."""
        simulation = self.simulation
        pinned = simulation.topology.pinned
        x, v = simulation.positions(), simulation.velocities()
        x[pinned] = places

        def place() -> None:
            simulation.place(x, v)

        self.act(place)
        self.watch.pins_are_at(places)

    def move_pins(self, places: Floats, seconds: float) -> None:
        """Leads the pins straight there, and runs."""
        start = self.simulation.positions()[self.simulation.topology.pinned]
        frames = max(1, round(seconds / FRAME_SECONDS))
        for k in range(frames):
            self.lead_pins(start + (places - start) * (k + 1) / frames)
            self.one_frame()

    def settle(self, *, most_speed: float = CALM_SPEED) -> None:
        """The disturbance is over: runs on, and the cloth must be at rest again in time, unless a part of it falls.

        `most_speed` [m/s] is for a cloth that something still moves.
        """
        if not np.isfinite(most_speed):
            raise ValueError("the speed at rest needs a finite bound")
        self._unjudged = False
        self.run(CALM_SECONDS - CALM_FRAMES * FRAME_SECONDS)
        for _ in range(CALM_FRAMES):
            self.one_frame()
            if self.simulation.torn.any():
                continue
            self.demand("strain 5 s after", self.watch.strain, self.most_strain)
            self.demand("speed 5 s after [m/s]", self.watch.speed, most_speed)

    # -- judging ---------------------------------------------------------------------------------------

    def tell(self, what: str, value: float, bound: float | None = None) -> None:
        """A number for the report, the worst of those told. Raises Broken where it is beyond its bound, if any."""
        if bound is not None and not np.isfinite(bound):
            raise ValueError(f"{what} needs a finite bound, or none")
        for figure in self.figures:
            if figure.what == what:
                figure.value, figure.bound = max(figure.value, value), bound
                break
        else:
            self.figures.append(Figure(what, value, bound))
        if bound is not None:
            self.demand(what, value, bound)

    def refuses(self, what: str, attempt: Callable[[], object]) -> None:
        """Tries something that must be refused with a line that names it. Raises Broken."""
        try:
            attempt()
        except ValueError as error:
            self.demand(f"refusals of {what} that do not name it", what not in str(error), 0)
        else:
            raise Broken(f"{what} is not refused", 1, 0)

    def demand(self, what: str, value: float, bound: float) -> None:
        if not value <= bound:
            raise Broken(what, value, bound)


_opened: list[Simulation] = []  # the last one


def opened(scene: Scene) -> Simulation:
    """A simulation of the scene at its start: the one that ran last, if it is the same."""
    if _opened and _opened[0].scene == scene:
        simulation = _opened[0]
        for name, key in live_keys(scene).items():
            simulation.set(name, key.value)
        simulation.set("wind", True)
        simulation.reset()
        return simulation
    close()
    _opened.append(Simulation(scene))
    return _opened[0]


def close() -> None:
    """Gives back what `opened` keeps."""
    while _opened:
        _opened.pop().close()
