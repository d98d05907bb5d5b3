"""Units run side by side: dearest first, and one that ends its process takes no other with it."""

import importlib
from dataclasses import replace
from pathlib import Path

import pytest

from taichi_cloth.stress.case import Case, Variant
from taichi_cloth.stress.running import dearest_first, run_all
from taichi_cloth.stress.setting import SETTINGS
from taichi_cloth.stress.unit import Result, Unit

from .conftest import BREAKS, SMALL, SWINGS


def test_the_dearest_run_first() -> None:
    cheap, dear = (replace(SWINGS, setting=SETTINGS[name]) for name in ("verlet", "projective"))
    assert dearest_first([cheap, dear], {}) == [dear, cheap]
    assert dearest_first([dear, cheap], {cheap.key: 9.0, dear.key: 1.0}) == [cheap, dear]
    assert dearest_first([dear, cheap], {dear.key: 1.0}) == [cheap, dear]  # what is not known may be dear


def test_what_ends_its_process_is_told_and_takes_no_other_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Processes are handed the module path, and import what they run."""
    (tmp_path / "ways_to_end.py").write_text(
        "import os\n\ndef lives(trial):\n    trial.frame = 3\n\ndef dies(trial):\n    os._exit(3)\n", encoding="utf-8"
    )
    monkeypatch.syspath_prepend(tmp_path)
    ways = importlib.import_module("ways_to_end")
    names = ("lives", "dies", "lives", "lives")
    cases = [Case(k, way, "", (Variant("one", getattr(ways, way)),)) for k, way in enumerate(names, 1)]
    found: dict[int, Result] = {}
    units = [Unit(case, case.variants[0], SMALL) for case in cases]
    run_all(units, lambda unit: unit.starts(2), None, lambda result: found.update({result.case: result}))
    assert [found[k].state for k in range(1, 5)] == ["alive", "failed", "alive", "alive"]
    assert [found[k].ran for k in range(1, 5)] == [2, 1, 2, 2]
    failure = found[2].failure
    assert failure is not None
    assert (failure.what, failure.seed) == ("times that its process ended", units[1].starts(1)[0][1])


def test_one_unit_runs_in_this_process() -> None:
    found: list[Result] = []
    run_all([BREAKS], lambda unit: [(0, 5)], None, found.append)
    assert [(one.state, one.failure and one.failure.seed) for one in found] == [("failed", 5)]
