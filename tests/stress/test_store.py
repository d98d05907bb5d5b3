"""The file is complete after every unit. A resumed run keeps only results of the same version of the program."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from taichi_cloth.evaluation.stress import store as module
from taichi_cloth.evaluation.stress.causes import Cause
from taichi_cloth.evaluation.stress.setup import ROBUST, ROBUST_SLACK
from taichi_cloth.evaluation.stress.store import Store, fingerprint, load
from taichi_cloth.evaluation.stress.trial import Measurement
from taichi_cloth.evaluation.stress.unit import Result, run_unit
from taichi_cloth.system.errors import UsageError

from .conftest import BREAKS, SWINGS, failed, result


def test_a_stored_file_is_read_back(tmp_path: Path) -> None:
    store = Store.new(tmp_path / "o.json", [SWINGS, BREAKS])
    store.add(run_unit(SWINGS, SWINGS.starts(1), None))
    store.add(replace(failed(variant="breaks"), figures=[Measurement("distance", 1.5, None)]))
    again = load(tmp_path / "o.json")
    assert again == store
    assert [r.state for r in again.ordered()] == ["alive", "failed"]
    assert again.ordered()[0].origin == fingerprint(SWINGS)


def test_the_file_is_complete_after_every_unit(tmp_path: Path) -> None:
    store = Store.new(tmp_path / "o.json", [SWINGS, BREAKS])
    for count, unit in enumerate((BREAKS, SWINGS), 1):
        store.add(result(variant=unit.variant.name))
        assert len(json.loads((tmp_path / "o.json").read_text(encoding="utf-8"))["results"]) == count


def test_units_without_a_current_result_are_left(monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store.new(None, [SWINGS, BREAKS])
    store.add(result(variant="swings", starts=4))
    assert store.older == 0
    assert store.left([SWINGS, BREAKS], 4) == [BREAKS]
    assert store.left([SWINGS, BREAKS], 1) == [BREAKS]  # more starts were run than are requested
    assert store.left([SWINGS, BREAKS], 5) == [SWINGS, BREAKS]
    monkeypatch.setattr(module, "fingerprint", lambda unit: "another program")
    again = Store.new(None, [SWINGS, BREAKS]).continued(store)
    assert again.left([SWINGS, BREAKS], 4) == [SWINGS, BREAKS]
    assert again.older == 1


@pytest.mark.parametrize(
    ("found", "needed"),
    [
        ({}, True),
        ({"swings": result(1, "swings", "robust")}, True),
        ({"swings": result(1, "swings", "robust"), "breaks": failed(variant="breaks", setting="robust")}, True),
        ({"swings": result(1, "swings", "robust"), "breaks": result(1, "breaks", "robust", slow_ms=40.0)}, True),
        ({name: result(1, name, "robust") for name in ("swings", "breaks")}, False),
    ],
)
def test_robust_slack_runs_the_cases_that_robust_does_not_survive(
    found: dict[str, Result], needed: bool, tmp_path: Path
) -> None:
    robust, slack = ([replace(one, setting=setting) for one in (SWINGS, BREAKS)] for setting in (ROBUST, ROBUST_SLACK))
    store = Store.new(tmp_path / "o.json", [*robust, *slack])
    for one in found.values():
        store.add(one)
    assert all(store.is_needed(unit.key) for unit in robust)
    assert [store.is_needed(unit.key) for unit in slack] == [needed] * 2
    store.save()
    planned = [unit.key for unit in (robust + slack if needed else robust)]
    assert load(tmp_path / "o.json").planned == planned
    store.add(result(1, "swings", "robust-slack"))  # requested by name
    assert slack[0].key in load(tmp_path / "o.json").planned


def test_robust_slack_alone_is_needed() -> None:
    unit = replace(SWINGS, setting=ROBUST_SLACK)
    assert Store.new(None, [unit]).is_needed(unit.key)


def test_older_results_stay_until_they_are_replaced(tmp_path: Path) -> None:
    older = Store.new(None, [SWINGS])
    older.results[SWINGS.key] = result(variant="swings", origin="older")
    older.results[7, "gone", "xpbd"] = result(7, "gone")
    kept = Store.new(None, [SWINGS, BREAKS]).continued(older, drop=True)
    assert [r.origin for r in kept.ordered()] == ["older"]
    assert kept.left([SWINGS, BREAKS], 10) == [SWINGS, BREAKS]
    kept.path = tmp_path / "o.json"
    kept.add(result(variant="breaks"))
    assert load(kept.path).older == 1
    kept.add(result(variant="swings"))
    assert load(kept.path).older == 0


def test_older_results_of_robust_plan_no_robust_slack(tmp_path: Path) -> None:
    """A run interrupted before `robust` ran again shows the older results: alive, and nothing "not run"."""
    robust, slack = (replace(SWINGS, setting=setting) for setting in (ROBUST, ROBUST_SLACK))
    older = Store.new(None, [robust, slack])
    older.results[robust.key] = result(variant="swings", setting="robust", origin="older")
    store = Store.new(tmp_path / "o.json", [BREAKS, robust, slack]).continued(older)
    store.add(result(variant="breaks"))
    assert load(tmp_path / "o.json").planned == [BREAKS.key, robust.key]
    assert store.is_needed(slack.key)  # until `robust` ran again
    for unit in (robust, slack):
        store.results[unit.key] = result(variant="swings", setting=unit.setting.name, origin="older", digest="0")
    assert store.repeatable([robust, slack]) == [robust]
    store.results[robust.key] = failed(variant="swings", setting="robust", origin="older", digest="0")
    assert store.repeatable([robust, slack]) == [robust, slack]


def test_a_result_is_kept_if_its_last_start_repeats(tmp_path: Path) -> None:
    older = Store.new(None, [SWINGS, BREAKS])
    for unit in (SWINGS, BREAKS):
        found = run_unit(unit, unit.starts(2), None)
        texts = {"parameters": "an older text", "about": "another"}
        older.results[unit.key] = replace(found, origin="older", machine=older.machine, **texts)
    broken = older.results[BREAKS.key]
    assert broken.failure is not None
    older.causes[BREAKS.key] = Cause(broken.failure.what, 3.0, "a reason", 7, "older")
    store = Store.new(tmp_path / "o.json", [SWINGS, BREAKS]).continued(older)
    assert store.repeatable([SWINGS, BREAKS]) == [SWINGS, BREAKS]
    first, last = (run_unit(SWINGS, [start], None) for start in SWINGS.starts(2))
    assert not store.repeat(first)
    assert store.left([SWINGS], 2) == [SWINGS]
    assert store.repeat(last)
    assert store.left([SWINGS], 2) == []
    again = load(tmp_path / "o.json").results[SWINGS.key]
    assert (again.ran, again.origin, bool(again.repeated)) == (2, fingerprint(SWINGS), True)
    assert (again.name, again.parameters, again.about) == (last.name, last.parameters, last.about)
    assert store.repeat(run_unit(BREAKS, BREAKS.starts(1), None))  # the first start failed, so it was the last
    assert store.reason(store.results[BREAKS.key]) == "a reason"
    assert store.repeatable([SWINGS, BREAKS]) == []


def test_the_hours_of_a_run_at_present_are_those_of_the_starts_that_confirmed_it(tmp_path: Path) -> None:
    older = Store.new(None, [SWINGS, BREAKS])
    for unit, seconds in ((SWINGS, 100.0), (BREAKS, 7.0)):
        older.results[unit.key] = replace(run_unit(unit, unit.starts(2), None), origin="older", seconds=seconds)
    store = Store.new(tmp_path / "o.json", [SWINGS, BREAKS]).continued(older)
    assert store.present_seconds() == 107.0
    assert store.repeat(replace(run_unit(SWINGS, SWINGS.starts(2)[-1:], None), seconds=3.0, opening=1.5))
    again = load(tmp_path / "o.json")
    assert again.results[SWINGS.key].seconds == 100.0
    assert again.present_seconds() == 1.5 + 2 * 3.0 + 7.0
    store.add(replace(again.results[SWINGS.key], seconds=50.0))  # it ran again
    assert store.present_seconds() == load(tmp_path / "o.json").present_seconds() == 57.0


@pytest.mark.parametrize("found", [{"digest": ""}, {"digest": "abc", "slow_ms": 40.0}])
def test_a_result_that_no_digest_confirms_runs_again(found: dict[str, Any]) -> None:
    older = Store.new(None, [SWINGS])
    older.results[SWINGS.key] = result(variant="swings", origin="older", machine=older.machine, **found)
    store = Store.new(None, [SWINGS]).continued(older)
    assert store.repeatable([SWINGS]) == []
    assert store.left([SWINGS], 1) == [SWINGS]


@pytest.mark.parametrize("text", ["", "[]", '{"machine": "", "older": 0, "planned": [], "results": [{}]}'])
def test_another_file_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "o.json").write_text(text)
    with pytest.raises(UsageError, match="is not a results file of `stress --json`"):
        load(tmp_path / "o.json")
    with pytest.raises(UsageError, match="No such file"):
        load(tmp_path / "none.json")
