"""`bench --goals`: commands from their start, and time and error of sheets. Nothing is judged by its time."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from taichi_cloth import cli
from taichi_cloth.accuracy import pinned_sheet
from taichi_cloth.accuracy.pinned_sheet import SheetCase
from taichi_cloth.bench import startup
from taichi_cloth.bench.children import ChildFailed

SMALL = SheetCase("small", 8, "spring", 1, 6)


@pytest.mark.usefixtures("on_lists")
def test_the_error_of_a_method_is_larger_than_that_of_the_reference() -> None:
    found = pinned_sheet.measure(SMALL)
    euler = pinned_sheet.measure(replace(SMALL, name="xpbd", solver="xpbd", substeps=10))
    assert (found.name, found.cells, found.particles, found.frames) == ("small", 8, 81, 6)
    assert 0 < found.rms_error < found.max_error < 1e-4
    assert 0 < found.doubt < 1e-5
    assert euler.rms_error > 100 * max(found.rms_error, found.doubt)
    assert found.max_strain > 0
    assert 0 < found.median_ms <= found.p95_ms


@pytest.mark.usefixtures("on_lists")
def test_what_is_compared_ends_at_the_horizon_where_there_are_obstacles() -> None:
    case = replace(SMALL, obstacles=True)
    scene = pinned_sheet.scene_of(case)
    assert scene.wind is not None
    assert len(scene.spheres) == 1
    assert 1 <= pinned_sheet.measure(case).frames <= case.frames


def test_the_sheets_are_those_of_the_goals() -> None:
    cases = {case.name: pinned_sheet.scene_of(case) for case in pinned_sheet.CASES}
    assert {name: scene.cloth.rows for name, scene in cases.items()} == {
        "whole fabric 128": 129,
        "denim 64": 65,
        "pinned fabric 128": 129,
        "pinned fabric 256": 257,
    }
    assert cases["denim 64"].fabric.warp == 15000
    assert cases["pinned fabric 256"].tethers is not None


def test_commands_are_timed_from_their_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(startup, "RUNS", 1)
    found = list(startup.measure(["render", "drape15", "--frames", "1", "--size", "64x36", "--set", "solver=verlet"]))
    assert len(found) == startup.MEASURED
    alone, _, _, empty, filled = found
    assert all(one.seconds > 0 for one in found)
    assert filled.what == "first frame, cache filled"
    assert empty.seconds > alone.seconds
    assert filled.peak_mb is None or filled.peak_mb > 20
    with pytest.raises(ChildFailed, match="no such scene"):
        list(startup.measure(["render", "no_such_scene"]))


def test_the_command_prints_and_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], running: None
) -> None:
    monkeypatch.setattr(pinned_sheet, "CASES", (SMALL,))
    told = [startup.Startup("taichi-cloth --help", 0.125), startup.Startup("first frame, cache filled", 1.5, 200.0)]
    monkeypatch.setattr(startup, "measure", lambda: iter(told))
    path = tmp_path / "goals.json"
    assert cli.main(["bench", "--goals", "--json", str(path)]) == 0
    stored = json.loads(path.read_text(encoding="utf-8"))
    assert [one["seconds"] for one in stored["commands"]] == [0.125, 1.5]
    assert stored["sheets"][0]["name"] == "small"
    assert stored["date"] == datetime.now(UTC).date().isoformat()
    assert "first frame, cache filled" in capsys.readouterr().out


def test_goals_do_not_go_with_other_measurements(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", "--goals", "--full"]) == 2
    assert cli.main(["bench", "--goals", "--error"]) == 2
    assert cli.main(["bench", "--goals", "--error", "--scene", "table"]) == 2
    assert capsys.readouterr().err.count("\n") == 3
