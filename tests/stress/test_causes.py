"""Experiments find what was wrong where something was, and nothing where nothing was."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.scene.model import Solver, Sphere
from taichi_cloth.stress import causes
from taichi_cloth.stress.case import Case, Variant
from taichi_cloth.stress.causes import EXPERIMENTS, Cause, alive, another_rest, cause_of, end_of
from taichi_cloth.stress.scenes import sheet
from taichi_cloth.stress.setting import Setting
from taichi_cloth.stress.store import Store, load
from taichi_cloth.stress.trial import Trial
from taichi_cloth.stress.unit import Unit, run_unit
from taichi_cloth.stress.watch import Broken

from .conftest import failed, result

ONE = Setting("verlet", Solver("verlet", 1, 1, damping=0.0))


def unit_of(run: Callable[[Trial], None], setting: Setting = ONE) -> Unit:
    return Unit(Case(1, "test", "nothing", (Variant("a", run),)), Variant("a", run), setting)


def demands(holds: Callable[[Trial], bool], what: str = "something") -> Callable[[Trial], None]:
    """A case that breaks a bound unless the setting is as it should be."""

    def run(trial: Trial) -> None:
        trial.open(sheet(4, spheres=(Sphere(center=(0.0, 5.0, 0.0), radius=0.1),)), rest_strain=1.0)
        trial.start()
        trial.one_frame()
        trial.only_frames("a test")
        if not holds(trial):
            raise Broken(what, 2.0, 1.0)

    return run


def explained(unit: Unit) -> Cause:
    ran = run_unit(unit, unit.starts(1), None)
    assert ran.failure is not None
    return cause_of(unit, ran.failure)


@pytest.mark.parametrize(
    ("holds", "shown"),
    [
        (lambda trial: trial.setting.solver.iterations >= 8, "too few iterations: alive with 1×8"),
        (lambda trial: trial.simulation.substeps >= 8, "too few substeps: alive with 8×1"),
        (
            lambda trial: trial.setting.solver.iterations * trial.simulation.substeps >= 64,
            "too few substeps and iterations: alive with 8×8",
        ),
        (lambda trial: trial.setting.swept, "colliders are not swept: alive with `swept`"),
        (lambda trial: False, ""),
    ],
)
def test_what_an_experiment_shows(holds: Callable[[Trial], bool], shown: str) -> None:
    cause = explained(unit_of(demands(holds)))
    assert (cause.what, cause.shown, cause.experiments) == ("something", shown, len(EXPERIMENTS))
    cause = replace(cause, origin="abc")
    assert cause.is_of(failed(2.0))
    assert cause.is_of(failed(2.01))
    assert not cause.is_of(failed(2.03))


def test_explicit_substeps_count_as_they_are_taken() -> None:
    """Not as they were asked for: a method may need more."""
    spring = Setting("spring", Solver("spring", 1, 1, damping=0.0))
    taken: list[tuple[int, int]] = []

    def breaks(trial: Trial) -> None:
        trial.open(sheet(4), rest_strain=1.0)
        trial.start()
        trial.only_frames("a test")
        taken.append((trial.setting.solver.substeps, trial.simulation.substeps))
        raise Broken("something", 2.0, 1.0)

    assert explained(unit_of(breaks, spring)).shown == ""
    needed = taken[0][1]
    assert needed > 1
    assert taken[-1] == (8 * needed, 8 * needed)


def test_an_experiment_that_takes_too_long_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    finer = demands(lambda trial: trial.setting.solver.iterations > ONE.solver.iterations)
    assert explained(unit_of(finer)).shown
    monkeypatch.setattr(causes, "EXPERIMENT_SECONDS", -1.0)
    assert explained(unit_of(finer)).shown == ""


def test_a_failure_that_does_not_repeat_has_no_cause() -> None:
    broken: list[int] = []

    def run(trial: Trial) -> None:
        demands(lambda trial: len(broken) > 0)(trial)

    unit = unit_of(run)
    failure = run_unit(unit, unit.starts(1), None).failure
    assert failure is not None
    broken.append(1)
    assert end_of(unit, failure) is None
    assert cause_of(unit, failure).shown == ""


def test_an_error_of_the_program_is_no_cause_and_not_alive() -> None:
    def run(trial: Trial) -> None:
        raise ZeroDivisionError("of a case")

    unit = unit_of(run)
    failure = run_unit(unit, unit.starts(1), None).failure
    assert failure is not None
    assert cause_of(unit, failure).shown == ""

    def unopened(trial: Trial) -> None:
        raise Broken("something", 2.0, 1.0)

    assert explained(unit_of(unopened)).shown == ""

    def later(trial: Trial) -> None:
        if trial.setting != ONE:
            raise ZeroDivisionError("of a case")
        demands(lambda trial: False)(trial)

    assert explained(unit_of(later)).shown == ""


# -- another state of rest -----------------------------------------------------------------------------


def folded(share: float) -> Callable[[Trial], None]:
    """A sheet that hangs, with its lowest row of threads `share` of their length wrong; strains are looked at."""

    def run(trial: Trial) -> None:
        x = trial.open(sheet(4, pins=("top",)), rest_strain=0.02)
        trial.only_frames("a test")
        x[-5:, 1] -= share / 4
        trial.simulation.place(x, np.zeros(3))
        trial.watch.begin()
        trial.watch.strain = share
        trial.demand("strain 5 s after", trial.watch.strain, 0.02)

    return run


def test_a_strain_that_float64_loses_is_not_at_rest() -> None:
    unit = unit_of(folded(0.3))
    failure = run_unit(unit, unit.starts(1), None).failure
    assert failure is not None
    end = end_of(unit, failure)
    assert end is not None
    assert another_rest(end) == ""


def test_a_strain_that_float64_keeps_is_a_state_of_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here with a reference that takes any place to be at rest."""
    monkeypatch.setattr(causes, "rest_positions", lambda model: model.start)
    assert explained(unit_of(folded(0.3))).shown == (
        "another equilibrium of the same springs: relaxed in float64 from there, strain 0.3"
    )
    assert "equilibrium" not in explained(unit_of(demands(lambda trial: False, "strain 5 s after"))).shown  # a collider


def test_a_sheet_that_was_put_at_one_point_comes_to_rest_in_a_knot() -> None:
    """Of real frames: a method that solves its substeps well ends where float64 stays too."""

    def run(trial: Trial) -> None:
        x = trial.open(sheet(32), rest_strain=0.04)
        trial.only_frames("a test")
        pinned = trial.simulation.topology.pinned
        x[~pinned] = 1e-3 * trial.random.standard_normal(x[~pinned].shape)
        trial.simulation.place(x, np.zeros(3))
        trial.watch.begin()
        trial.run(8.0)
        trial.demand("strain 5 s after", trial.watch.strain, 0.04)

    shown = explained(unit_of(run, Setting("xpbd", Solver("xpbd", 60, 4, damping=0.0)))).shown
    assert shown.startswith("another equilibrium of the same springs")


# -- float32 -------------------------------------------------------------------------------------------


def swinging(damping: float) -> Callable[[Trial], None]:
    def run(trial: Trial) -> None:
        trial.open(sheet(4, pins=("top",), damping=damping), rest_strain=1.0)
        trial.start(velocity=(0.0, 0.0, 0.2))
        trial.one_frame()
        trial.only_frames("a test")
        trial.demand("speed 5 s after [m/s]", trial.watch.speed, 0.1)

    return run


@pytest.mark.parametrize(("damping", "shown"), [(2.0, True), (0.0, False)])
def test_what_swings_and_is_damped_comes_to_rest_later(damping: float, shown: bool) -> None:
    cause = explained(unit_of(swinging(damping), Setting("spring", Solver("spring", 10, 1, damping=0.0))))
    assert cause.shown.startswith("at rest later: ") == shown
    assert bool(cause.shown) == shown


@pytest.mark.parametrize(("name", "damping", "shown"), [("spring", 2.0, 1), ("spring", 0.0, 0), ("verlet", 2.0, 0)])
def test_what_only_float64_brings_to_rest_was_rounded(
    name: str, damping: float, shown: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here with a cloth that trembles for ever in float32; only explicit methods take the same steps."""
    monkeypatch.setattr(causes, "speed_later", lambda trial: 0.2)
    cause = explained(unit_of(swinging(damping), Setting(name, Solver(name, 10, 1, damping=0.0))))
    assert cause.shown.startswith("rounding to float32: ") == bool(shown)


# -- kept ----------------------------------------------------------------------------------------------


def test_causes_are_kept_as_long_as_they_are_of_what_failed(tmp_path: Path) -> None:
    unit = unit_of(demands(lambda trial: False))
    store = Store.new(tmp_path / "o.json", [unit])
    store.add(failed(2.0, setting="verlet"))
    failure = store.results[unit.key].failure
    assert store.untried([unit]) == [(unit, failure)]
    store.explain(unit.key, Cause("something", 2.02, "", experiments=1))
    assert store.untried([unit]) == [(unit, failure)]  # there are more experiments now
    store.explain(unit.key, Cause("something", 2.02, "", experiments=len(EXPERIMENTS)))
    assert store.untried([unit]) == []
    assert store.unexplained(store.ordered())
    store.explain(unit.key, Cause("something", 2.02, "it is made to", experiments=1))
    assert store.untried([unit]) == []
    assert load(tmp_path / "o.json") == store
    assert Store.new(None, [unit]).continued(load(tmp_path / "o.json")).reason(store.ordered()[0]) == "it is made to"
    store.add(failed(3.0, setting="verlet"))
    assert store.untried([unit]) == [(unit, store.results[unit.key].failure)]
    assert load(tmp_path / "o.json").causes == {}
    store.add(result(setting="verlet"))
    assert store.untried([unit]) == []


@pytest.mark.parametrize(("mended", "found"), [(0, False), (1, False), (2, False), (3, True)])
def test_the_start_that_failed_and_two_others_must_be_alive(mended: int, found: bool) -> None:
    seeds = []
    unit = unit_of(demands(lambda trial: False))
    failing = 7

    def run(trial: Trial) -> None:
        if trial.setting.swept:
            seeds.append(trial.seed)
        demands(lambda trial: trial.setting.swept and len(seeds) <= mended)(trial)

    unit = unit_of(run)
    failure = run_unit(unit, [(0, failing)], None).failure
    assert failure is not None
    end = end_of(unit, failure)
    assert end is not None
    assert alive(end, replace(ONE, swept=True)) == found
    assert seeds == [failing, *(seed for _, seed in unit.starts(2))][: mended + 1]
