"""The committed pages match the committed results, and every cause belongs to one of them."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from taichi_cloth.evaluation.stress import stress_report
from taichi_cloth.evaluation.stress.runner import select_units
from taichi_cloth.evaluation.stress.store import Store, fingerprint, load
from taichi_cloth.evaluation.stress.stress_report import cells_of, counts
from taichi_cloth.evaluation.stress.unit import SLOW

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def stored() -> Store:
    return load(ROOT / "benchmarks" / "results" / "stability.json")


def test_the_pages_match_the_stored_results(stored: Store, tmp_path: Path) -> None:
    stress_report.write_pages(tmp_path / "stability.md", stored)
    for name in ("stability.md", "stability_rows.md"):
        assert (ROOT / "docs" / name).read_text("utf-8") == (tmp_path / name).read_text("utf-8")


def test_other_documents_have_the_same_counts(stored: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    import stored as documents

    words = documents.load("stability")
    assert words is not None
    found = {setting: dict(states) for setting, states in documents.survival(words).items()}
    counted = counts(cells_of(stored)).items()
    assert found == {setting: {state: n for state, n in states.items() if n} for setting, states in counted}


def test_the_stored_results_belong_to_these_cases(stored: Store) -> None:
    units = {unit.key: unit for unit in select_units()}
    assert set(stored.results) <= set(stored.planned)
    everything = replace(stored, planned=list(units))
    assert stored.planned == [key for key in units if everything.is_needed(key)]
    older = 0
    for result in stored.ordered():
        unit = units[result.key]
        if result.origin != fingerprint(unit):
            older += 1  # which the file counts
        else:
            assert (result.name, result.parameters) == (unit.case.name, unit.case.parameters)
            assert result.about == unit.case.note
    assert stored.older == older


def test_the_page_names_the_cases_that_no_setting_runs_for_a_second(stored: Store) -> None:
    whole = [one for one in stored.ordered() if not re.search(r"\b(13×13|9×9|7×7|5×5)\b", one.variant)]
    frames = {case: max(one.frames for one in whole if one.case == case) for case in range(1, 41)}
    too_slow = {result.case for result in whole if result.state == SLOW}
    short = [str(case) for case in sorted(too_slow) if frames[case] < 60 and case != 40]  # which has one frame
    words = " ".join((ROOT / "docs" / "stability.md").read_text("utf-8").split())
    assert f"no variant of cases {', '.join(short[:-1])} and {short[-1]} ran for a second" in words
    longest = {case: max(one.frames for one in stored.ordered() if one.case == case) for case in map(int, short)}
    unjudged = [case for case, count in longest.items() if count < 120]  # of ten seconds
    assert unjudged == [16]
    assert "So has case 16, whose specification bounds only the time: none is fast enough for them" in words


def test_every_cause_belongs_to_a_failure(stored: Store) -> None:
    assert set(stored.causes) == {result.key for result in stored.ordered() if stored.cause(result)}
