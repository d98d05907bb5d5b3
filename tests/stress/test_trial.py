"""A trial judges a cloth at rest and every number that a case tells, repeats its seed, and stops what is too slow."""

import math

import numpy as np
import pytest

from taichi_cloth.mesh.from_scene import topology_of
from taichi_cloth.scene.model import Forces, Solver
from taichi_cloth.stress import trial as module
from taichi_cloth.stress.rest import static_strain
from taichi_cloth.stress.scenes import sheet
from taichi_cloth.stress.setting import Setting
from taichi_cloth.stress.trial import CALM_SECONDS, TIMED_FRAMES, TooSlow, Trial
from taichi_cloth.stress.watch import Broken

from .conftest import SMALL

EXPLICIT = Setting("spring", Solver("spring", 1, 1, damping=0.0))
WEIGHTLESS = Forces(gravity=0.0)


@pytest.mark.parametrize(("speed", "alive"), [(0.09, True), (0.11, False)])
def test_nothing_is_faster_than_a_tenth_of_a_metre_a_second(speed: float, alive: bool) -> None:
    trial = Trial(EXPLICIT, 0)
    trial.open(sheet(4, pins=(), damping=0.0, forces=WEIGHTLESS))
    trial.start(velocity=(0.0, 0.0, speed), shake=0.0)
    if alive:
        trial.settle()
    else:
        with pytest.raises(Broken, match="speed 5 s after") as found:
            trial.settle()
        assert found.value.value == pytest.approx(speed, rel=1e-3)
        assert trial.frame == round(60 * CALM_SECONDS) - 14  # the first of the last quarter of a second


@pytest.mark.parametrize(("stretch", "alive"), [(1.008, True), (1.012, False)])
def test_strain_is_at_most_one_percent_above_the_static_one(stretch: float, alive: bool) -> None:
    """Held stretched between two edges; at rest without weight it would be strained by nothing."""
    trial = Trial(SMALL, 0)
    x = trial.open(sheet(4, pins=("left", "right"), forces=WEIGHTLESS))
    trial.start(x * [stretch, 1, 1])
    if alive:
        trial.settle()
    else:
        with pytest.raises(Broken, match="strain 5 s after"):
            trial.settle()


def test_the_bound_on_strain_is_that_of_the_fabric_whatever_the_method() -> None:
    scene = sheet(4)
    static = static_strain(scene)
    assert 0.001 < static < 0.1
    for name in ("verlet", "xpbd", "spring"):
        trial = Trial(Setting(name, Solver(name, 5, 1)), 0)
        trial.open(scene)
        assert trial.most_strain == pytest.approx(static + 0.01)
        trial.only_frames("not run")
    assert static_strain(sheet(4, constant=100.0)) > 5 * static
    assert static_strain(sheet(4, pins=(), rotation=(-90.0, 0.0, 0.0))) == pytest.approx(static, rel=0.05)


def test_a_cloth_must_be_judged_at_rest() -> None:
    trial = Trial(SMALL, 0)
    trial.open(sheet(4), rest_strain=0.1)
    trial.start()
    with pytest.raises(RuntimeError, match="neither let it settle"):
        trial.check_judged()
    with pytest.raises(RuntimeError, match="neither let it settle"):
        trial.open(sheet(4), rest_strain=0.1)
    trial.only_frames("it is a test")
    trial.check_judged()
    assert trial.notes == ["not judged at rest: it is a test"]


def test_no_bound_is_infinite() -> None:
    trial = Trial(SMALL, 0)
    with pytest.raises(ValueError, match="finite"):
        trial.open(sheet(4), rest_strain=math.inf)
    trial.open(sheet(4), rest_strain=0.1)
    with pytest.raises(ValueError, match="finite"):
        trial.settle(most_speed=math.inf)
    with pytest.raises(ValueError, match="finite"):
        trial.tell("way", 1.0, math.inf)


def test_what_is_told_and_refused() -> None:
    trial = Trial(SMALL, 0)
    trial.tell("way", 1.0, 2.0)
    trial.tell("way", 0.5, 2.0)
    trial.tell("other", 7.0)
    assert [(f.what, f.value, f.bound) for f in trial.figures] == [("way", 1.0, 2.0), ("other", 7.0, None)]
    with pytest.raises(Broken, match="way"):
        trial.tell("way", 2.1, 2.0)
    with pytest.raises(Broken, match="way"):
        trial.tell("way", np.nan, 2.0)
    trial.refuses("seven", lambda: [].index("seven"))  # type: ignore[func-returns-value]
    with pytest.raises(Broken, match="is not refused"):
        trial.refuses("seven", lambda: 7)
    with pytest.raises(Broken, match="do not name it"):
        trial.refuses("eight", lambda: [].index("seven"))  # type: ignore[func-returns-value]


def ends(seed: int, before: bool) -> bytes:
    """Of a run that is shaken and yanked; after another, of another seed, in the same simulation."""
    if before:
        ends(seed + 1, before=False)
    trial = Trial(SMALL, seed)
    trial.open(sheet(8), rest_strain=0.1)
    trial.start()
    corner = trial.simulation.topology.particle_count - 1
    trial.act(lambda: trial.simulation.grab(corner, trial.random.normal(size=3)))
    trial.one_frame(driven=True)
    trial.act(trial.simulation.release)
    trial.act(lambda: trial.simulation.set("gravity", 1.0))
    trial.run(0.2)
    trial.only_frames("a test")
    return trial.simulation.positions().tobytes()


def test_a_seed_repeats_its_start_to_the_last_bit() -> None:
    assert ends(3, before=False) == ends(3, before=True)
    assert ends(3, before=False) != ends(4, before=False)


class Clock:
    """A clock that a frame moves by so many seconds."""

    def __init__(self, steps: list[float]) -> None:
        self.now, self.steps, self.asked = 0.0, iter(steps), 0

    def read(self) -> float:
        self.asked += 1
        self.now += next(self.steps, 0.0) if self.asked % 2 == 0 else 0.0
        return self.now


@pytest.mark.parametrize(
    ("seconds", "frames"),
    [
        ([9.0, 0.2, 0.01, 0.2, 0.01, 0.2], 6),  # the median of the five after the first
        ([9.0, 1.5], 2),  # one is enough to see
        ([9.0, 0.2, 0.01, 0.2, 0.01, 0.01], None),
        ([9.0, *[0.034] * 5], 6),  # less than thirty frames a second
        ([9.0, *[0.033] * 5], None),
        ([9.0, *[0.01] * 29, *[0.04] * 31], 61),  # it becomes slow, and more than half of its frames are
        ([9.0, *[0.01] * 31, *[0.04] * 29], None),
        ([9.0, *[0.01] * 59, *[0.04] * 61], 121),
    ],
)
def test_what_is_too_slow_stops(monkeypatch: pytest.MonkeyPatch, seconds: list[float], frames: int | None) -> None:
    trial = Trial(SMALL, 0)
    trial.open(sheet(4), rest_strain=0.1)
    trial.start()
    wall, busy = Clock(seconds), Clock(seconds)
    monkeypatch.setattr(module.time, "perf_counter", wall.read)
    monkeypatch.setattr(module.time, "process_time", busy.read)
    if frames is None:
        trial.run(len(seconds) / 60)
        trial.only_frames("a test")
        return
    with pytest.raises(TooSlow) as found:
        trial.run(3.0)
    assert trial.frame == frames
    assert found.value.ms == pytest.approx(1e3 * seconds[-1])


@pytest.mark.parametrize("way", ["driven", "look"])
def test_a_frame_that_is_looked_at_after_every_substep_is_not_timed(way: str) -> None:
    """What the look takes is no time of the method, however long it is."""
    trial = Trial(SMALL, 0)
    trial.open(sheet(4), rest_strain=0.1)
    trial.frame_limit_ms(0.0, "every frame that is timed is too slow")
    trial.start()
    trial.simulation.grab(12, trial.simulation.topology.start[12])
    for _ in range(70):
        trial.one_frame(**{"driven": {"driven": True}, "look": {"look": lambda share: None}}[way])
    assert trial.times == []
    with pytest.raises(TooSlow):
        trial.run(0.2)
    assert (trial.frame, len(trial.times)) == (70 + 1 + TIMED_FRAMES, TIMED_FRAMES)  # the first of them may compile


def test_a_case_may_set_its_own_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    trial = Trial(SMALL, 0)
    trial.open(sheet(4), rest_strain=0.1)
    trial.frame_limit_ms(2000.0, "it is large")
    trial.start()
    clock = Clock([9.0, 1.5, 1.5])
    monkeypatch.setattr(module.time, "perf_counter", clock.read)
    monkeypatch.setattr(module.time, "process_time", clock.read)
    trial.run(3 / 60)
    assert trial.notes == ["up to 2000 ms a frame: it is large"]


def test_a_sheet_that_tears_is_alive_and_need_not_be_still() -> None:
    tearing = SMALL.tearing(0.3)
    trial = Trial(tearing, 0)
    trial.open(sheet(8, pins=("top", "bottom")), rest_strain=0.05)
    trial.start()
    pins = trial.simulation.positions()[trial.simulation.topology.pinned]
    apart = np.where(pins[:, 1:2] < 0, pins - [0.0, 1.0, 0.0], pins)
    trial.move_pins(apart, 0.5)
    trial.settle()
    [torn] = [figure.value for figure in trial.figures if figure.what == "torn [%]"]
    springs = topology_of(tearing.of(sheet(8)), "fabric").spring_count
    assert torn / 100 * springs >= 9  # one thread in each column
    whole = Trial(SMALL, 0)  # it stays twice as long
    whole.open(sheet(8, pins=("top", "bottom")), rest_strain=0.05)
    whole.start()
    whole.move_pins(apart, 0.5)
    with pytest.raises(Broken, match="strain 5 s after"):
        whole.settle()
