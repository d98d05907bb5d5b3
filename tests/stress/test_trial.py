"""A trial checks a cloth at rest and every recorded value, repeats its seed, and stops a case that is too slow."""

import math
from functools import partial

import numpy as np
import pytest

from taichi_cloth.evaluation.stress import trial as module
from taichi_cloth.evaluation.stress.invariants import Violation
from taichi_cloth.evaluation.stress.setup import Setting, sheet, static_strain
from taichi_cloth.evaluation.stress.trial import (
    CALM_SECONDS,
    TIMED_EVERY,
    TIMED_FRAMES,
    TIMED_WINDOW,
    TooSlow,
    Trial,
)
from taichi_cloth.geometry.cloth_builder import build_topology
from taichi_cloth.scene.collider_schema import Sphere
from taichi_cloth.scene.schema import Forces, Solver

from .conftest import SMALL

EXPLICIT = Setting("explicit", Solver("explicit", 1, 1, damping=0.0))
WEIGHTLESS = Forces(gravity=0.0)


@pytest.mark.parametrize(("speed", "alive"), [(0.09, True), (0.11, False)])
def test_the_speed_at_rest_is_at_most_a_tenth_of_a_meter_per_second(speed: float, alive: bool) -> None:
    trial = Trial(EXPLICIT, 0)
    trial.open(sheet(4, pins=(), damping=0.0, forces=WEIGHTLESS))
    trial.start(velocity=(0.0, 0.0, speed), shake=0.0)
    if alive:
        trial.settle()
    else:
        with pytest.raises(Violation, match="speed 5 s after") as found:
            trial.settle()
        assert found.value.value == pytest.approx(speed, rel=1e-3)
        assert trial.frame == round(60 * CALM_SECONDS) - 14  # the first of the last quarter of a second


@pytest.mark.parametrize(("stretch", "alive"), [(1.008, True), (1.012, False)])
def test_the_strain_at_rest_is_at_most_one_percent_above_the_static_strain(stretch: float, alive: bool) -> None:
    """It is stretched between two edges; without weight its static strain is 0."""
    trial = Trial(SMALL, 0)
    x = trial.open(sheet(4, pins=("left", "right"), forces=WEIGHTLESS))
    trial.start(x * [stretch, 1, 1])
    if alive:
        trial.settle()
    else:
        with pytest.raises(Violation, match="strain 5 s after"):
            trial.settle()


def test_the_strain_and_speed_at_rest_are_recorded() -> None:
    """So the digest of a start and the stored figures have them."""
    trial = Trial(SMALL, 0)
    trial.open(sheet(4))
    trial.start()
    trial.settle()
    found = {figure.what: figure for figure in trial.figures}
    assert found["strain 5 s after"].bound == trial.max_rest_strain
    assert found["speed 5 s after [m/s]"].bound == module.CALM_SPEED
    assert 0 < found["strain 5 s after"].value < trial.max_rest_strain
    assert 0 < found["speed 5 s after [m/s]"].value < module.CALM_SPEED


def test_a_case_runs_for_ten_seconds_and_the_cloth_stays_at_rest() -> None:
    trial = Trial(SMALL, 0)
    trial.open(sheet(4))
    trial.start()
    trial.settle()
    trial.finish()
    assert trial.frame == 600
    trial.finish()
    assert trial.frame == 600  # not longer


def test_a_cloth_that_moves_after_its_check_at_rest_fails() -> None:
    trial = Trial(EXPLICIT, 0)
    gravity = 0.0195  # [m/s²] after 5 s it falls at 0.0975 m/s
    trial.open(sheet(4, pins=(), damping=0.0, forces=Forces(gravity=gravity)))
    trial.start(shake=0.0)
    trial.settle()
    with pytest.raises(Violation, match="speed 5 s after"):
        trial.finish()
    assert 300 < trial.frame < 320


def test_a_scene_without_a_check_at_rest_runs_no_longer() -> None:
    trial = Trial(SMALL, 0)
    trial.open(sheet(4))
    trial.start()
    trial.settle()
    trial.open(sheet(4))
    trial.start()
    trial.one_frame()
    trial.skip_rest_check("a test")
    trial.finish()
    assert trial.frame == 301


def test_the_bound_on_strain_depends_on_the_fabric_and_not_on_the_solver() -> None:
    scene = sheet(4)
    static = static_strain(scene)
    assert 0.001 < static < 0.1
    for name in ("verlet", "xpbd", "explicit"):
        trial = Trial(Setting(name, Solver(name, 5, 1)), 0)
        trial.open(scene)
        assert trial.max_rest_strain == pytest.approx(static + 0.01)
        trial.skip_rest_check("not run")
    assert static_strain(sheet(4, constant=100.0)) > 5 * static
    on_ball = sheet(4, pins=(), rotation=(-90.0, 0.0, 0.0), spheres=(Sphere(),))
    assert static_strain(on_ball) == pytest.approx(static, rel=0.05)


def test_a_case_must_check_its_cloth_at_rest() -> None:
    trial = Trial(SMALL, 0)
    trial.open(sheet(4), rest_strain=0.1)
    trial.start()
    with pytest.raises(RuntimeError, match="neither settle"):
        trial.require_rest_check()
    with pytest.raises(RuntimeError, match="neither settle"):
        trial.open(sheet(4), rest_strain=0.1)
    trial.skip_rest_check("it is a test")
    trial.require_rest_check()
    assert trial.notes == ["not judged at rest: it is a test"]


def test_infinite_bounds_are_refused() -> None:
    trial = Trial(SMALL, 0)
    with pytest.raises(ValueError, match="finite"):
        trial.open(sheet(4), rest_strain=math.inf)
    trial.open(sheet(4), rest_strain=0.1)
    with pytest.raises(ValueError, match="finite"):
        trial.settle(max_speed=math.inf)
    with pytest.raises(ValueError, match="finite"):
        trial.record("distance", 1.0, math.inf)


def test_recorded_values_and_expected_errors() -> None:
    trial = Trial(SMALL, 0)
    trial.record("distance", 1.0, 2.0)
    trial.record("distance", 0.5, 2.0)
    trial.record("other", 7.0)
    assert [(f.what, f.value, f.bound) for f in trial.figures] == [("distance", 1.0, 2.0), ("other", 7.0, None)]
    trial.record("distance", 0.9, 1.0)  # nearer to its bound, as one scene of several may have
    assert (trial.figures[0].value, trial.figures[0].bound) == (0.9, 1.0)
    with pytest.raises(Violation, match="distance"):
        trial.record("distance", 2.1, 2.0)
    with pytest.raises(Violation, match="distance"):
        trial.record("distance", np.nan, 2.0)
    trial.expect_error("seven", lambda: ["six"].index("seven"))
    with pytest.raises(Violation, match="is not refused"):
        trial.expect_error("seven", lambda: 7)
    with pytest.raises(Violation, match="do not name it"):
        trial.expect_error("eight", lambda: ["six"].index("seven"))


def ends(seed: int, before: bool) -> bytes:
    """Return the final positions of a run with a grab. If `before`, another seed runs first in the same simulation."""
    if before:
        ends(seed + 1, before=False)
    trial = Trial(SMALL, seed)
    trial.open(sheet(8), rest_strain=0.1)
    trial.start()
    corner = trial.simulation.topology.particle_count - 1
    grab = trial.simulation.grab(corner)
    trial.change(partial(grab.move_to, trial.random.normal(size=3)))
    trial.one_frame(driven=True)
    trial.change(grab.release)
    trial.change(lambda: trial.simulation.params.update({"gravity": 1.0}))
    trial.run(0.2)
    trial.skip_rest_check("a test")
    return trial.simulation.positions().tobytes()


def test_a_seed_repeats_its_run_bit_for_bit() -> None:
    assert ends(3, before=False) == ends(3, before=True)
    assert ends(3, before=False) != ends(4, before=False)


@pytest.mark.parametrize(("pins", "shift"), [((), 0.01), (("top",), 0.0)])
def test_no_two_starts_are_equal(pins: tuple[str, ...], shift: float) -> None:
    """Cloth without pins is translated by up to `shift` [m] along each axis; all get a random velocity."""
    translations, velocities = [], []
    for seed in range(20):
        trial = Trial(SMALL, seed)
        start = trial.open(sheet(4, pins=pins), rest_strain=0.1)
        trial.start()
        moved = trial.simulation.positions() - start
        assert moved == pytest.approx(np.broadcast_to(moved[-1], moved.shape), abs=1e-6)
        translations.append(np.abs(moved).max(axis=0))
        velocities.append(np.abs(trial.simulation.velocities()).max())
        trial.skip_rest_check("not run")
    for found, most in ((translations, shift), (velocities, 0.02)):
        assert 0.9 * most <= np.max(found) <= most + 1e-6
        assert len(np.unique(found, axis=0)) == (len(found) if most else 1)


class Clock:
    """A clock that advances by the given seconds in each frame."""

    def __init__(self, steps: list[float]) -> None:
        self.now, self.steps, self.asked = 0.0, iter(steps), 0

    def read(self) -> float:
        self.asked += 1
        self.now += next(self.steps, 0.0) if self.asked % 2 == 0 else 0.0
        return self.now


@pytest.mark.parametrize(
    ("seconds", "frames"),
    [
        ([9.0, 0.2, 0.01, 0.2, 0.01, 0.2], 6),  # median of the five frames after the first
        ([9.0, 1.5], 2),  # one frame is enough
        ([9.0, 0.2, 0.01, 0.2, 0.01, 0.01], None),
        ([9.0, *[0.034] * 5], 6),  # less than 30 frames per second
        ([9.0, *[0.033] * 5], None),
        ([9.0, *[0.01] * 29, *[0.04] * 31], 61),  # it slows down, and more than half of its frames are slow
        ([9.0, *[0.01] * 31, *[0.04] * 29], None),
        ([9.0, *[0.01] * 59, *[0.04] * 61], 121),
    ],
)
def test_a_case_that_is_too_slow_is_stopped(
    monkeypatch: pytest.MonkeyPatch, seconds: list[float], frames: int | None
) -> None:
    trial = Trial(SMALL, 0)
    trial.open(sheet(4), rest_strain=0.1)
    trial.start()
    wall, cpu = Clock(seconds), Clock(seconds)
    monkeypatch.setattr(module.time, "perf_counter", wall.read)
    monkeypatch.setattr(module.time, "process_time", cpu.read)
    if frames is None:
        trial.run(len(seconds) / 60)
        trial.skip_rest_check("a test")
        return
    with pytest.raises(TooSlow) as found:
        trial.run(3.0)
    assert trial.frame == frames
    assert found.value.ms == pytest.approx(1e3 * seconds[-1])


def test_a_long_run_that_gets_slow_is_stopped_after_a_window_of_slow_frames() -> None:
    """Even if more of its frames were fast, and without a look at all of them."""
    trial = Trial(SMALL, 0)
    trial.open(sheet(4), rest_strain=0.1)
    trial.times = [1.0] * (100 * TIMED_WINDOW)
    trial._check_time()
    trial.times += [50.0] * (TIMED_WINDOW // 2)
    trial._check_time()  # half of them: the median is halfway, and under the limit
    trial.times += [50.0] * TIMED_EVERY
    with pytest.raises(TooSlow) as found:
        trial._check_time()
    assert found.value.ms == 50.0
    trial.skip_rest_check("a test")


@pytest.mark.parametrize("way", ["driven", "look"])
def test_a_frame_run_substep_by_substep_is_not_timed(way: str) -> None:
    trial = Trial(SMALL, 0)
    trial.open(sheet(4), rest_strain=0.1)
    trial.frame_limit_ms(0.0, "every timed frame is too slow")
    trial.start()
    trial.simulation.grab(12)
    for _ in range(70):
        trial.one_frame(**{"driven": {"driven": True}, "look": {"look": lambda share: None}}[way])
    assert trial.times == []
    with pytest.raises(TooSlow):
        trial.run(0.2)
    assert (trial.frame, len(trial.times)) == (70 + 1 + TIMED_FRAMES, TIMED_FRAMES)  # the first may compile kernels


def test_a_case_may_set_its_own_time_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    trial = Trial(SMALL, 0)
    trial.open(sheet(4), rest_strain=0.1)
    trial.frame_limit_ms(2000.0, "it is large")
    trial.start()
    clock = Clock([9.0, 1.5, 1.5])
    monkeypatch.setattr(module.time, "perf_counter", clock.read)
    monkeypatch.setattr(module.time, "process_time", clock.read)
    trial.run(3 / 60)
    assert trial.notes == ["up to 2000 ms a frame: it is large"]


def test_torn_cloth_is_not_checked_at_rest() -> None:
    tearing = SMALL.tearing(0.3)
    trial = Trial(tearing, 0)
    trial.open(sheet(8, pins=("top", "bottom")), rest_strain=0.05)
    trial.start()
    pins = trial.simulation.positions()[trial.simulation.topology.pinned]
    apart = np.where(pins[:, 1:2] < 0, pins - [0.0, 1.0, 0.0], pins)
    trial.move_pins(apart, 0.5)
    trial.settle()
    [torn] = [figure.value for figure in trial.figures if figure.what == "torn [%]"]
    springs = build_topology(tearing.of(sheet(8)), "fabric").spring_count
    assert torn / 100 * springs >= 9  # one spring in each column
    whole = Trial(SMALL, 0)  # untorn, it stays twice as long
    whole.open(sheet(8, pins=("top", "bottom")), rest_strain=0.05)
    whole.start()
    whole.move_pins(apart, 0.5)
    with pytest.raises(Violation, match="strain 5 s after"):
        whole.settle()
