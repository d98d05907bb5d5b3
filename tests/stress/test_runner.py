"""Units run in parallel, the most expensive first. One whose process dies does not stop the others."""

import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.evaluation.stress.runner import dearest_first, run_all
from taichi_cloth.evaluation.stress.setup import SETTINGS
from taichi_cloth.evaluation.stress.unit import Case, Result, Unit, Variant

from .conftest import SMALL, SWINGS


def test_the_most_expensive_units_run_first() -> None:
    cheap, dear = (replace(SWINGS, setting=SETTINGS[name]) for name in ("verlet", "implicit"))
    assert dearest_first([cheap, dear], {}) == [dear, cheap]
    assert dearest_first([dear, cheap], {cheap.key: 9.0, dear.key: 1.0}) == [cheap, dear]
    assert dearest_first([dear, cheap], {dear.key: 1.0}) == [cheap, dear]  # an unknown cost counts as high


def test_a_unit_whose_process_dies_fails_and_the_others_finish(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Worker processes get the module path, and import what they run."""
    (tmp_path / "endings.py").write_text(
        "import os\n\ndef lives(trial):\n    trial.frame = 3\n\ndef dies(trial):\n    os._exit(3)\n", encoding="utf-8"
    )
    monkeypatch.syspath_prepend(tmp_path)
    endings = importlib.import_module("endings")
    names = ("lives", "dies", "lives", "lives")
    cases = [Case(k, way, "", (Variant("one", getattr(endings, way)),)) for k, way in enumerate(names, 1)]
    found: dict[int, Result] = {}
    units = [Unit(case, case.variants[0], SMALL) for case in cases]
    run_all(units, lambda unit: unit.starts(2), None, lambda result: found.update({result.case: result}))
    assert [found[k].state for k in range(1, 5)] == ["alive", "failed", "alive", "alive"]
    assert [found[k].ran for k in range(1, 5)] == [2, 1, 2, 2]
    failure = found[2].failure
    assert failure is not None
    assert (failure.what, failure.seed) == ("times that its process ended", units[1].starts(1)[0][1])


def test_a_unit_that_is_too_slow_beside_others_runs_again_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first run of each leaves a file. One is slow only then, one always."""
    (tmp_path / "speeds.py").write_text(
        "from pathlib import Path\n"
        "from taichi_cloth.evaluation.stress.trial import TooSlow\n\n"
        "def first_time(trial):\n"
        "    mark = Path(__file__).with_name(f'{trial.seed}')\n"
        "    known = mark.exists()\n"
        "    mark.touch()\n"
        "    return not known\n\n"
        "def fast(trial):\n    first_time(trial)\n\n"
        "def slow_beside_others(trial):\n    if first_time(trial):\n        raise TooSlow(40.0, 33.0)\n\n"
        "def slow(trial):\n    raise TooSlow(50.0 if first_time(trial) else 45.0, 33.0)\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(tmp_path)
    speeds = importlib.import_module("speeds")
    names = ("slow_beside_others", "slow", "fast")
    cases = [Case(k, way, "", (Variant("one", getattr(speeds, way)),)) for k, way in enumerate(names, 1)]
    found: list[Result] = []
    run_all([Unit(case, case.variants[0], SMALL) for case in cases], lambda unit: unit.starts(1), None, found.append)
    assert [(one.case, one.state, one.slow_ms) for one in found] == [
        (3, "alive", None),
        (1, "alive", None),
        (2, "too slow", 45.0),
    ]


def test_every_processor_gets_the_same_kernels_of_linear_algebra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a worker process: the variables act only before NumPy is imported."""
    (tmp_path / "kernels.py").write_text(
        "import os\n\ndef shows(trial):\n"
        "    trial.note(f\"{os.environ['OPENBLAS_NUM_THREADS']} {os.environ.get('OPENBLAS_CORETYPE')}\")\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("OPENBLAS_NUM_THREADS", "OPENBLAS_CORETYPE"):
        monkeypatch.delenv(name, raising=False)
    way = importlib.import_module("kernels").shows
    case = Case(1, "kernels", "", (Variant("one", way),))
    for found, shown in ((["AVX2"], "1 Haswell"), (["X86_V3", "X86_V4"], "1 Haswell"), (["NEON"], "1 None")):
        monkeypatch.delenv("OPENBLAS_CORETYPE", raising=False)
        monkeypatch.setattr(
            np, "show_config", lambda mode, found=found: {"SIMD Extensions": {"baseline": [], "found": found}}
        )
        results: list[Result] = []
        run_all([Unit(case, case.variants[0], SMALL)], lambda unit: [(0, 5)], None, results.append)
        assert [one.notes for one in results] == [[shown]]
