"""One start of a case with one setting: what a case does to its cloth, through the calls that everybody has."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from math import inf
from typing import TypeVar

import numpy as np

from ..scene import Scene, live_keys
from ..scene.model import FRAME_SECONDS
from ..simulation import Simulation
from .setting import Setting
from .watch import Broken, Floats, Watch, Worst

Value = TypeVar("Value")

CALM_SECONDS = 5.0  # after a disturbance, to be still again
CALM_FRAMES = 15  # that must all be still, at the end
CALM_STRAIN = 0.01  # above that of the cloth at rest, and of it where that is more than the length
CALM_SPEED = 0.1  # [m/s]
REST_SECONDS, REST_DAMPING = 4.0, 4.0  # [s], [1/s] that bring a cloth to rest
SHAKE = 0.02  # [m/s] of the velocities that make starts differ
SHIFT = 0.01  # [m] of the places, where nothing is pinned
MOST_STEPS = 400_000 * 1089  # substeps times particles, of a run


class OutOfTime(Exception):
    """The run has taken all the substeps that it may."""


@dataclass
class Figure:
    """What a row of the list asks for besides: a number and its bound, infinite where it is only told."""

    what: str
    value: float
    bound: float


@dataclass
class Trial:
    """`number` counts the starts from 0. A case opens a scene, starts it, and lets it run."""

    setting: Setting
    number: int
    figures: list[Figure] = field(default_factory=list)
    worst: Worst = field(default_factory=Worst)
    frame: int = 0
    steps: int = 0
    seconds: float = 0.0  # [s] of wall time that frames took
    most_strain: float = field(init=False)
    simulation: Simulation = field(init=False)
    watch: Watch = field(init=False)

    def __post_init__(self) -> None:
        self.random = np.random.default_rng(self.number)

    def one_of(self, values: Sequence[Value]) -> Value:
        """Starts take the variants of a case in turn."""
        return values[self.number % len(values)]

    @property
    def cells(self) -> int:
        return self.setting.cells

    # -- starting --------------------------------------------------------------------------------------

    def open(self, scene: Scene, far: float = 0.0, rest: Scene | float | None = None) -> Floats:
        """The scene with this setting, at its start, which is returned (N, 3) [m]; `far` as for `Watch`.

        `rest` is the strain that it may end with, or the scene at rest whose strain it should come to: its own.
        """
        own = self.setting.of(scene)
        rest = own if rest is None else rest if isinstance(rest, float) else self.setting.of(rest)
        if isinstance(rest, float):
            self.most_strain = rest
        else:
            still = strain_at_rest(rest)
            self.most_strain = still + CALM_STRAIN * max(1.0, still)
        self.simulation = opened(own)
        self.watch = Watch(self.simulation, self.worst, far if self.setting.tear is None else inf)
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

    # -- running ---------------------------------------------------------------------------------------

    def act(self, change: Callable[[], object]) -> None:
        """Does something to the cloth between two frames. What energy it has by that was given."""
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
        """One frame, and the watch looks; `look` does after every substep, as `Simulation.advance_slowly` says."""
        simulation = self.simulation
        self.steps += simulation.substeps * simulation.topology.particle_count
        if self.frame and self.steps > MOST_STEPS:
            raise OutOfTime
        start = time.perf_counter()
        if look is None:
            simulation.advance_frame()
        else:
            simulation.advance_slowly(look)
        if self.frame:  # the first may compile
            self.seconds += time.perf_counter() - start
        self.frame += 1
        self.watch.look(driven=driven)
        if self.setting.tear is not None:
            self.tell("torn [%]", 100 * float(simulation.torn.mean()))

    def change_solver(self, name: str) -> None:
        """Another method for the same cloth; its springs may have other constants."""
        self.simulation.change_solver(name)
        self.watch.springs_are_others()

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

    def settle(self) -> None:
        """The disturbance is over: runs on, and the cloth must be at rest again in time, unless a part of it falls."""
        self.run(CALM_SECONDS - CALM_FRAMES * FRAME_SECONDS)
        for _ in range(CALM_FRAMES):
            self.one_frame()
            if self.simulation.torn.any():
                continue
            self.demand("strain 5 s after", self.watch.strain, self.most_strain)
            self.demand("speed 5 s after [m/s]", self.watch.speed, CALM_SPEED)

    # -- judging ---------------------------------------------------------------------------------------

    def tell(self, what: str, value: float, bound: float = inf) -> None:
        """A number for the report, the worst of those told. Raises Broken where it is beyond its bound."""
        for figure in self.figures:
            if figure.what == what:
                figure.value, figure.bound = max(figure.value, value), bound
                break
        else:
            self.figures.append(Figure(what, value, bound))
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


@cache
def strain_at_rest(scene: Scene) -> float:
    """The largest strain that a scene comes to by itself; no bound where that takes too long.

    A little shaken: a sheet that is exactly flat stays so, even where a hair would make it buckle.
    """
    simulation = opened(scene)
    start = simulation.topology.start
    simulation.place(start, np.random.default_rng(0).uniform(-SHAKE, SHAKE, start.shape))
    simulation.set("damping", REST_DAMPING)
    frames = round(REST_SECONDS / FRAME_SECONDS)
    if frames * simulation.substeps * simulation.topology.particle_count > MOST_STEPS:
        return inf
    for _ in range(frames):
        simulation.advance_frame()
    return simulation.measure().max_strain
