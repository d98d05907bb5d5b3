"""A unit runs its starts until one fails, and its result has the worst values of all."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.evaluation.stress.setup import sheet
from taichi_cloth.evaluation.stress.trial import Measurement, TooSlow, Trial, UntimedTrial
from taichi_cloth.evaluation.stress.unit import (
    Case,
    Unit,
    Variant,
    repeat_starts,
    run_unit,
    seed_of,
    variants,
    worst_figures,
)

from .conftest import BREAKS, CASE, SMALL, SWINGS, breaks_once, moves_late, raises_an_error, swings


def unit_of(run: object) -> Unit:
    return Unit(CASE, Variant("one", run), SMALL)  # type: ignore[arg-type]


def test_variants_bind_their_values() -> None:
    taken: list[float] = []
    both = variants(lambda trial, value: taken.append(value), {"1 m": 1.0, "10 m": 10.0})
    assert [variant.name for variant in both] == ["1 m", "10 m"]
    for variant in both:
        variant.run(Trial(SMALL, 0))
    assert taken == [1.0, 10.0]


def test_seeds_are_reproducible_and_unique() -> None:
    assert seed_of(29, "10 m", 0) == 1816848893
    seeds = {seed_of(case, name, start) for case in (1, 2) for name in ("a", "b") for start in range(10)}
    assert len(seeds) == 40
    assert [start for start, _ in SWINGS.starts(3)] == [0, 1, 2]
    other = replace(SWINGS, setting=replace(SMALL, name="other"))
    assert other.starts(3) == SWINGS.starts(3)  # every setting runs the same starts


def test_starts_after_the_first_failure_are_skipped() -> None:
    result = run_unit(unit_of(breaks_once), [(0, 1), (1, 2), (2, 3), (3, 4)], None)
    assert (result.ran, result.starts, result.state) == (3, 4, "failed")
    assert result.failure is not None
    assert (result.failure.start, result.failure.seed, result.failure.frame) == (2, 3, 6)
    assert (result.failure.what, result.failure.value, result.failure.bound) == ("something", 2.0, 1.0)


def test_a_unit_runs_for_ten_seconds_and_judges_all_of_them() -> None:
    def hangs(trial: Trial) -> None:
        trial.open(sheet(4))
        trial.start()
        trial.settle()

    resting = run_unit(unit_of(hangs), SWINGS.starts(1), None)
    assert (resting.state, resting.frames) == ("alive", 600)
    falling = run_unit(unit_of(moves_late), SWINGS.starts(1), None)
    assert falling.failure is not None
    assert (falling.failure.what, falling.failure.frame > 300) == ("speed 5 s after [m/s]", True)


def test_an_untimed_trial_repeats_a_start_on_a_machine_that_is_too_slow() -> None:
    limits = [1e3]  # [ms]

    def slow(trial: Trial) -> None:
        trial.open(sheet(4))
        trial.start()
        trial.limit_ms = limits[0]
        trial.skip_rest_check("it is not about rest")
        trial.run(0.2)

    fast = run_unit(unit_of(slow), SWINGS.starts(1), None)
    limits[0] = 1e-6
    assert run_unit(unit_of(slow), SWINGS.starts(1), None).state == "too slow"
    again = run_unit(unit_of(slow), SWINGS.starts(1), None, UntimedTrial)
    assert (again.state, again.digest) == (fast.state, fast.digest) == ("alive", fast.digest)


def test_two_frames_prepare_the_start_that_confirms_a_result() -> None:
    frames = []

    def counts(trial: Trial) -> None:
        trial.open(sheet(4))
        trial.start()
        trial.settle(after_frame=lambda: frames.append(trial.frame))

    alone = run_unit(unit_of(counts), SWINGS.starts(3)[-1:], None, UntimedTrial)
    frames.clear()
    again = repeat_starts(unit_of(counts), SWINGS.starts(3)[-1:], None)
    assert frames == [1, *range(1, 301)]  # the second of two frames ends the first start
    assert (again.digest, again.state, again.ran) == (alone.digest, "alive", 1)
    assert again.opening > 0
    assert alone.opening == 0


def test_a_start_gives_the_same_result_alone_and_among_others() -> None:
    all_of_them = run_unit(SWINGS, SWINGS.starts(2), None)
    second = run_unit(SWINGS, SWINGS.starts(2)[1:], None)
    first = run_unit(SWINGS, SWINGS.starts(1), None)
    assert (all_of_them.ran, all_of_them.state, all_of_them.frames) == (2, "alive", 6)
    assert all_of_them.figures[0].value == max(first.figures[0].value, second.figures[0].value)
    assert first.figures[0].value != second.figures[0].value
    assert all_of_them.speed == max(first.speed, second.speed)
    assert all_of_them.notes == ["not judged at rest: a test"]
    assert all_of_them.about == "it is a test"


def test_the_digest_is_that_of_the_last_start() -> None:
    both, second = run_unit(SWINGS, SWINGS.starts(2), None), run_unit(SWINGS, SWINGS.starts(2)[1:], None)
    first = run_unit(SWINGS, SWINGS.starts(1), None)
    assert both.digest == second.digest != first.digest
    assert len(both.digest) == 12

    def pushed(trial: Trial) -> None:
        swings(trial)
        x = trial.simulation.positions()
        x[-1, 2] = np.nextafter(np.float32(x[-1, 2]), np.float32(1))  # one bit
        trial.simulation.set_state(x, trial.simulation.velocities())

    assert run_unit(unit_of(pushed), SWINGS.starts(1), None).digest != first.digest

    def slowed(trial: Trial) -> None:
        swings(trial)
        v = trial.simulation.velocities()
        v[-1, 2] = np.nextafter(np.float32(v[-1, 2]), np.float32(1))
        trial.simulation.set_state(trial.simulation.positions(), v)

    def kept(trial: Trial) -> None:
        swings(trial)
        trial.simulation.set_state(trial.simulation.positions(), trial.simulation.velocities())

    ends = [run_unit(unit_of(run), SWINGS.starts(1), None).digest for run in (kept, kept, slowed)]
    assert ends[0] == ends[1] != ends[2]
    assert run_unit(BREAKS, SWINGS.starts(1), None).digest != first.digest  # the same cloth, and a failure


def test_an_image_of_the_failure_is_written(tmp_path: Path) -> None:
    result = run_unit(BREAKS, BREAKS.starts(2), tmp_path)
    path = tmp_path / "01_test_breaks_xpbd_0.png"
    assert result.picture == str(path)
    assert path.read_bytes().startswith(b"\x89PNG")


def slow(trial: Trial) -> None:
    swings(trial)
    raise TooSlow(250.0, 100.0)


def test_too_slow_is_neither_alive_nor_failed() -> None:
    result = run_unit(unit_of(slow), [(0, 1), (1, 2)], None)
    assert (result.state, result.slow_ms, result.ran, result.failure) == ("too slow", 250.0, 1, None)


def not_checked_at_rest(trial: Trial) -> None:
    trial.open(sheet(4), rest_strain=0.1)
    trial.start()


@pytest.mark.parametrize(
    ("run", "line"),
    [(raises_an_error, "ZeroDivisionError: of a case"), (not_checked_at_rest, "RuntimeError: a case opened a scene")],
)
def test_an_error_of_a_case_is_its_failure(run: object, line: str) -> None:
    result = run_unit(unit_of(run), [(0, 1)], None)
    assert result.failure is not None
    assert result.failure.what.startswith(line)


def test_nan_is_the_worst_value() -> None:
    trials = [Trial(SMALL, 0, [Measurement("distance", value, 5.0)]) for value in (1.0, float("nan"), 2.0)]
    [figure] = worst_figures(trials[:1] + trials[2:])
    assert figure.value == 2.0
    [figure] = worst_figures(trials[:2])
    assert figure.value != figure.value


def test_the_key_of_a_unit() -> None:
    assert Unit(Case(3, "c", "", ()), Variant("v", swings), SMALL).key == (3, "v", "xpbd")
