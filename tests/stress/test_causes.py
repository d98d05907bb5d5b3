"""Experiments find the cause of a failure, and no cause where there is none."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taichi_cloth.evaluation.stress import causes
from taichi_cloth.evaluation.stress.causes import (
    EXPERIMENTS,
    Cause,
    alive,
    another_rest,
    cause_of,
    end_of,
    exact_motion_is_not_at_rest,
)
from taichi_cloth.evaluation.stress.invariants import Violation
from taichi_cloth.evaluation.stress.setup import Setting, sheet
from taichi_cloth.evaluation.stress.store import Store, load
from taichi_cloth.evaluation.stress.stress_report import NOT_EXAMINED, UNEXPLAINED, explanation
from taichi_cloth.evaluation.stress.trial import TIMED_FRAMES, TooSlow, Trial, UntimedTrial
from taichi_cloth.evaluation.stress.unit import Case, Failure, Unit, Variant, run_unit
from taichi_cloth.geometry.cloth_builder import build_topology
from taichi_cloth.geometry.spring_model import SpringModel
from taichi_cloth.scene.collider_schema import Ground, Sphere
from taichi_cloth.scene.schema import Solver

from .conftest import SMALL, failed, moves_late, result

ONE = Setting("verlet", Solver("verlet", 1, 1, damping=0.0))


def unit_of(run: Callable[[Trial], None], setting: Setting = ONE) -> Unit:
    return Unit(Case(1, "test", "nothing", (Variant("a", run),)), Variant("a", run), setting)


def requires(holds: Callable[[Trial], bool], what: str = "something") -> Callable[[Trial], None]:
    """Return a case that violates a bound unless `holds` is true of the trial."""

    def run(trial: Trial) -> None:
        trial.open(
            sheet(4, spheres=(Sphere(center=(0.0, 5.0, 0.0), radius=0.1, margin=0.15, friction=0.0),)), rest_strain=1.0
        )
        trial.start()
        trial.one_frame()
        trial.skip_rest_check("a test")
        if not holds(trial):
            raise Violation(what, 2.0, 1.0)

    return run


def explained(unit: Unit) -> Cause:
    ran = run_unit(unit, unit.starts(1), None)
    assert ran.failure is not None
    return cause_of(unit, ran.failure)


@pytest.mark.parametrize(
    ("holds", "shown"),
    [
        (lambda trial: trial.setting.solver.iterations >= 4, "too few iterations: alive with 1×4"),
        (lambda trial: trial.simulation.substeps >= 4, "too few substeps: alive with 4×1"),
        (
            lambda trial: trial.setting.solver.iterations * trial.simulation.substeps >= 16,
            "too few substeps and iterations: alive with 4×4",
        ),
        (lambda trial: False, ""),
    ],
)
def test_an_experiment_names_the_change_that_fixes_the_case(holds: Callable[[Trial], bool], shown: str) -> None:
    cause = explained(unit_of(requires(holds)))
    assert (cause.what, cause.shown, cause.experiments) == ("something", shown, len(EXPERIMENTS))
    assert cause.seconds > 0
    cause = replace(cause, origin="abc")
    assert cause.is_of(failed(2.0))
    assert cause.is_of(failed(2.01))
    assert not cause.is_of(failed(2.03))


@pytest.mark.parametrize(
    ("what", "fits"),
    [("particles that went through the ball", True), ("energy above all that was given [J]", True), ("strain", False)],
)
def test_continuous_collision_explains_only_what_it_can(what: str, fits: bool) -> None:
    shown = explained(unit_of(requires(lambda trial: trial.setting.continuous, what))).shown
    assert shown == ("no continuous collision detection: alive with `continuous`" if fits else "")


def test_experiments_multiply_the_substeps_that_were_used() -> None:
    """Not those that were requested: an explicit solver may need more."""
    explicit = Setting("explicit", Solver("explicit", 1, 1, damping=0.0))
    taken: list[tuple[int, int]] = []

    def breaks(trial: Trial) -> None:
        trial.open(sheet(4), rest_strain=1.0)
        trial.start()
        trial.skip_rest_check("a test")
        taken.append((trial.setting.solver.substeps, trial.simulation.substeps))
        raise Violation("something", 2.0, 1.0)

    assert explained(unit_of(breaks, explicit)).shown == ""
    needed = taken[0][1]
    assert needed > 1
    assert taken[-1] == (4 * needed, 4 * needed)


def test_an_experiment_that_takes_too_long_finds_no_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    finer = requires(lambda trial: trial.setting.solver.iterations > ONE.solver.iterations)
    assert explained(unit_of(finer)).shown
    monkeypatch.setattr(causes, "EXPERIMENT_SECONDS", -1.0)
    assert explained(unit_of(finer)).shown == ""


def test_an_experiment_ends_once_its_frames_will_take_too_long() -> None:
    trial = UntimedTrial(SMALL, 0, seconds=1.0, least_frames=10**7)
    trial.open(sheet(4))
    trial.start()
    with pytest.raises(TooSlow):
        trial.run(1.0)
    assert trial.frame == 1 + TIMED_FRAMES  # the first is not timed


def test_a_failure_that_does_not_repeat_has_no_cause() -> None:
    broken: list[int] = []

    def run(trial: Trial) -> None:
        requires(lambda trial: len(broken) > 0)(trial)

    unit = unit_of(run)
    failure = run_unit(unit, unit.starts(1), None).failure
    assert failure is not None
    broken.append(1)
    assert end_of(unit, failure) is None
    assert cause_of(unit, failure).shown == ""


def test_a_failure_after_the_case_is_repeated_and_no_experiment_survives_by_ending_early() -> None:
    unit = unit_of(moves_late)
    ran = run_unit(unit, unit.starts(1), None)
    assert ran.failure is not None
    end = end_of(unit, ran.failure)
    assert end is not None
    assert not alive(end, ONE)


def test_an_error_of_the_program_has_no_cause_and_does_not_count_as_alive() -> None:
    def run(trial: Trial) -> None:
        raise ZeroDivisionError("of a case")

    unit = unit_of(run)
    failure = run_unit(unit, unit.starts(1), None).failure
    assert failure is not None
    assert cause_of(unit, failure).shown == ""

    def unopened(trial: Trial) -> None:
        raise Violation("something", 2.0, 1.0)

    assert explained(unit_of(unopened)).shown == ""

    def later(trial: Trial) -> None:
        if trial.setting != ONE:
            raise ZeroDivisionError("of a case")
        requires(lambda trial: False)(trial)

    assert explained(unit_of(later)).shown == ""


# -- another equilibrium -----------------------------------------------------------------------------


def folded(share: float) -> Callable[[Trial], None]:
    """Return a case of a hanging sheet whose lowest springs are stretched by `share`. It checks the strain."""

    def run(trial: Trial) -> None:
        x = trial.open(sheet(4, pins=("top",)), rest_strain=0.02)
        trial.skip_rest_check("a test")
        x[-5:, 1] -= share / 4
        trial.simulation.set_state(x, np.zeros(3))
        trial.watch.begin()
        trial.watch.strain = share
        trial.check("strain 5 s after", trial.watch.strain, 0.02)

    return run


def test_a_strain_that_relaxes_in_float64_is_no_equilibrium() -> None:
    unit = unit_of(folded(0.3))
    failure = run_unit(unit, unit.starts(1), None).failure
    assert failure is not None
    end = end_of(unit, failure)
    assert end is not None
    assert another_rest(end) == ""


def test_a_strain_that_remains_in_float64_is_an_equilibrium(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here with a reference for which any positions are an equilibrium."""
    monkeypatch.setattr(causes, "rest_positions", lambda model: model.start)
    assert explained(unit_of(folded(0.3))).shown == (
        "another equilibrium of the same springs: relaxed in float64 from there, strain 0.3"
    )
    assert (
        "equilibrium" not in explained(unit_of(requires(lambda trial: False, "strain 5 s after"))).shown
    )  # a collider


@pytest.mark.parametrize(("share", "found"), [(0.955, True), (1.045, True), (0.945, False), (1.055, False)])
def test_the_strain_of_an_equilibrium_changes_by_at_most_a_twentieth(
    share: float, found: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cloth that relaxes farther was not at rest, so its failure stays unexplained."""
    strain = 0.3
    unit = unit_of(folded(strain))
    failure = run_unit(unit, unit.starts(1), None).failure
    assert failure is not None
    end = end_of(unit, failure)
    assert end is not None

    def relaxed(model: SpringModel) -> np.ndarray:
        x = model.start.copy()
        x[1, -5:] -= (share - 1) * strain / 4
        return x

    monkeypatch.setattr(causes, "rest_positions", relaxed)
    assert another_rest(end).endswith(f", strain {share * strain:.3g}") == found


def test_a_collapsed_sheet_comes_to_rest_in_another_equilibrium() -> None:
    """With simulated frames: a solver that converges in its substeps ends in an equilibrium of float64 too."""

    def run(trial: Trial) -> None:
        x = trial.open(sheet(32), rest_strain=0.04)
        trial.skip_rest_check("a test")
        pinned = trial.simulation.topology.pinned
        x[~pinned] = 1e-3 * trial.random.standard_normal(x[~pinned].shape)
        trial.simulation.set_state(x, np.zeros(3))
        trial.watch.begin()
        trial.run(8.0)
        trial.check("strain 5 s after", trial.watch.strain, 0.04)

    shown = explained(unit_of(run, Setting("xpbd", Solver("xpbd", 60, 4, damping=0.0)))).shown
    assert shown.startswith("another equilibrium of the same springs")


# -- exact motion ------------------------------------------------------------------------------------

SOFT = Setting("xpbd", Solver("xpbd", 20, 4, damping=0.0))


def hangs(constant: float, damping: float = 0.2, kick: float = 0.0, **sections: Any) -> Callable[[Trial], None]:
    """Return a case of a sheet that is released from rest. Before the last frames a hidden `kick` [m/s] disturbs it."""

    def run(trial: Trial) -> None:
        trial.open(sheet(4, constant=constant, damping=damping, **sections), far=100.0)

        def disturb() -> None:
            if kick and trial.frame == 281:
                v = trial.simulation.velocities() + [0.0, 0.0, kick]
                trial.change(lambda: trial.simulation.set_state(trial.simulation.positions(), v))

        trial.start()
        trial.settle(after_frame=disturb)

    return run


@pytest.mark.parametrize(
    ("run", "setting", "shown"),
    [
        (hangs(30.0), SOFT, True),
        (hangs(30.0, kick=0.3), Setting("verlet", Solver("verlet", 5, 12, damping=0.0)), False),
        (hangs(30.0, spheres=(Sphere(center=(0.0, 90.0, 0.0), radius=0.1),)), SOFT, False),
        (hangs(1000.0, damping=2.0, kick=0.3), SOFT, False),
        (hangs(30.0, kick=3.0), SOFT, False),
    ],
    ids=["soft", "springs without constants", "a collider", "a solver's own motion", "a solver's larger motion"],
)
def test_a_swing_that_the_exact_motion_has_too_explains_no_larger_one(
    run: Callable[[Trial], None], setting: Setting, shown: bool
) -> None:
    unit = unit_of(run, setting)
    failure = run_unit(unit, unit.starts(1), None).failure
    assert failure is not None
    assert failure.what in ("strain 5 s after", "speed 5 s after [m/s]")
    end = end_of(unit, failure)
    assert end is not None
    found = exact_motion_is_not_at_rest(end)
    assert found.startswith(f"the exact motion is not at rest either: {failure.what} ") == shown
    assert bool(found) == shown


def test_the_exact_motion_begins_at_the_last_disturbance() -> None:
    def run(trial: Trial) -> None:
        trial.open(sheet(4, constant=30.0, damping=0.2), far=100.0)
        trial.start()
        trial.run(0.1)
        trial.settle()

    unit = unit_of(run, SOFT)
    failure = run_unit(unit, unit.starts(1), None).failure
    assert failure is not None
    end = end_of(unit, failure)
    assert end is not None
    x, v, frame = end.disturbed
    assert frame == 6
    assert -0.1 * 9.81 < v[-1, 1] < -0.5
    assert x[-1, 1] == pytest.approx(-0.5 - 9.81 * 0.1**2 / 2, abs=0.01)


def test_experiments_that_were_tried_are_not_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    unit = unit_of(requires(lambda trial: False))
    failure = run_unit(unit, unit.starts(1), None).failure
    assert failure is not None
    monkeypatch.setattr(causes, "EXPERIMENTS", (lambda end: "the first", lambda end: "the second"))
    assert [cause_of(unit, failure, tried).shown for tried in (0, 1, 2)] == ["the first", "the second", ""]


# -- float32 -------------------------------------------------------------------------------------------


def swinging(damping: float) -> Callable[[Trial], None]:
    def run(trial: Trial) -> None:
        trial.open(sheet(4, pins=("top",), damping=damping), rest_strain=1.0)
        trial.start(velocity=(0.0, 0.0, 0.2))
        trial.one_frame()
        trial.skip_rest_check("a test")
        trial.check("speed 5 s after [m/s]", trial.watch.speed, 0.1)

    return run


@pytest.mark.parametrize(("damping", "shown"), [(2.0, True), (0.0, False)])
def test_a_damped_swing_comes_to_rest_later(damping: float, shown: bool) -> None:
    cause = explained(unit_of(swinging(damping), Setting("explicit", Solver("explicit", 10, 1, damping=0.0))))
    assert cause.shown.startswith("at rest later: ") == shown
    assert bool(cause.shown) == shown


@pytest.mark.parametrize(("name", "damping", "shown"), [("explicit", 2.0, 1), ("explicit", 0.0, 0), ("verlet", 2.0, 0)])
def test_a_cloth_that_rests_only_in_float64_is_explained_by_rounding(
    name: str, damping: float, shown: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here with a cloth that never comes to rest in float32; only explicit solvers are repeated in float64."""
    monkeypatch.setattr(causes, "speed_later", lambda trial: 0.2)
    cause = explained(unit_of(swinging(damping), Setting(name, Solver(name, 10, 1, damping=0.0))))
    assert cause.shown.startswith("rounding to float32: ") == bool(shown)


@pytest.mark.parametrize(
    ("bound", "solver", "shown"),
    [(1e-4, "explicit", "the exact motion drifts too: "), (1.0, "explicit", ""), (1e-4, "verlet", "")],
)
def test_cloth_that_drifts_in_float64_too_is_not_at_rest(bound: float, solver: str, shown: str) -> None:
    """A sheet just released from level falls by ½gt²; within as many frames it drifts no meter."""
    scene = sheet(4, rotation=(-90.0, 0.0, 0.0))
    topology = build_topology(scene, "fabric")
    failure = Failure(start=0, seed=1, frame=1203, what="drift [m]", value=2 * bound, bound=bound)
    unit = unit_of(lambda trial: None, Setting(solver, Solver(solver, 10, 1)))
    end = causes.FailedState(unit, failure, scene, topology.start, 0 * topology.start, 10, np.inf)
    assert causes.in_float64(end).startswith(shown)
    assert bool(causes.in_float64(end)) == bool(shown)
    too_soon = replace(end, failure=replace(failure, frame=1200))  # drift counts from then on
    assert causes.in_float64(too_soon) == ""
    wet = replace(scene, ground=Ground(height=-9.0))
    assert causes.in_float64(replace(end, scene=wet)) == ""


def test_a_drift_that_takes_too_long_to_repeat_has_no_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = sheet(4, rotation=(-90.0, 0.0, 0.0))
    start = build_topology(scene, "fabric").start
    failure = Failure(start=0, seed=1, frame=1260, what="drift [m]", value=1.0, bound=0.1)
    end = causes.FailedState(unit_of(lambda trial: None, SMALL), failure, scene, start, 0 * start, 10, np.inf)
    assert causes.exact_motion_drifts(end)
    monkeypatch.setattr(causes, "EXPERIMENT_SECONDS", -1.0)
    assert causes.exact_motion_drifts(end) == ""


# -- storage -------------------------------------------------------------------------------------------


def test_a_cause_is_stored_as_long_as_its_failure(tmp_path: Path) -> None:
    unit = unit_of(requires(lambda trial: False))
    store = Store.new(tmp_path / "o.json", [unit])
    store.add(failed(2.0, setting="verlet"))
    failure = store.results[unit.key].failure
    assert store.untried([unit]) == [(unit, failure, 0)]
    store.explain(unit.key, Cause("something", 2.02, "", experiments=1))
    assert store.untried([unit]) == [(unit, failure, 1)]  # there are more experiments now
    assert explanation(store, store.results[unit.key]) == NOT_EXAMINED
    store.explain(unit.key, Cause("something", 2.02, "", experiments=len(EXPERIMENTS)))
    assert store.untried([unit]) == []
    assert store.unexplained(store.ordered())
    assert explanation(store, store.results[unit.key]) == UNEXPLAINED
    store.explain(unit.key, Cause("something", 2.02, "it is made to", experiments=1))
    assert store.untried([unit]) == []
    assert explanation(store, store.results[unit.key]) == "it is made to"
    assert load(tmp_path / "o.json") == store
    assert Store.new(None, [unit]).continued(load(tmp_path / "o.json")).reason(store.ordered()[0]) == "it is made to"
    store.add(failed(3.0, setting="verlet"))
    assert store.untried([unit]) == [(unit, store.results[unit.key].failure, 0)]
    assert load(tmp_path / "o.json").causes == {}
    store.add(result(setting="verlet"))
    assert store.untried([unit]) == []


@pytest.mark.parametrize(
    ("start", "successes", "found"),
    [(0, 0, False), (0, 1, False), (0, 2, False), (0, 3, True), (1, 3, False), (1, 9, False), (4, 10, True)],
)
def test_the_failed_start_and_others_must_survive(start: int, successes: int, found: bool) -> None:
    """Two others, or nine if the first start survived without the change."""
    seeds = []
    unit = unit_of(requires(lambda trial: False))
    failing = 7

    def run(trial: Trial) -> None:
        if trial.setting.continuous:
            seeds.append(trial.seed)
        requires(lambda trial: trial.setting.continuous and len(seeds) <= successes)(trial)

    unit = unit_of(run)
    failure = run_unit(unit, [(start, failing)], None).failure
    assert failure is not None
    assert failure.start == start
    end = end_of(unit, failure)
    assert end is not None
    assert alive(end, replace(ONE, continuous=True)) == found
    assert seeds == [failing, *(seed for _, seed in unit.starts(9))][: min(successes + 1, 10 if start else 3)]
