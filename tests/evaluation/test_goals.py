"""`bench --goals`: run times of commands, and frame time and error of sheets. No test depends on a time."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.__main__ import main
from taichi_cloth.evaluation.bench import pinned_sheet, subprocess_runner
from taichi_cloth.evaluation.bench.pinned_sheet import SheetCase
from taichi_cloth.evaluation.bench.subprocess_runner import ChildFailed

from .conftest import off_once

SMALL = SheetCase("small", 8, "explicit", 1, 6)


@pytest.mark.usefixtures("serial_layout")
def test_the_error_of_a_solver_is_larger_than_that_of_the_reference() -> None:
    found = pinned_sheet.measure(SMALL)
    euler = pinned_sheet.measure(replace(SMALL, name="xpbd", solver="xpbd", substeps=10))
    assert (found.name, found.cells, found.particles, found.frames) == ("small", 8, 81, 6)
    assert 0 < found.uncertainty < found.rms_error < found.max_error < 1e-4
    assert euler.rms_error > 100 * max(found.rms_error, found.uncertainty)
    assert found.max_strain > 0
    assert 0 < found.median_ms <= found.p95_ms


@pytest.mark.usefixtures("serial_layout")
@pytest.mark.parametrize("frame", [0, 2, 4])
def test_error_and_uncertainty_are_of_all_frames_and_particles(frame: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """One particle is off in one frame, at the start, in the middle or at the end."""
    case, error, uncertainty = replace(SMALL, frames=5), 0.01, 0.003
    truth = off_once(pinned_sheet.scene_of(case), case.frames, frame, error, uncertainty, pinned_sheet.SIDE)
    monkeypatch.setattr(pinned_sheet, "solution", lambda case, scene: truth)
    found = pinned_sheet.measure(case)
    rms = 1 / np.sqrt(case.frames * found.particles)
    assert found.max_error == pytest.approx(error)
    assert (found.rms_error, found.uncertainty) == pytest.approx((rms * error, rms * uncertainty))


@pytest.mark.usefixtures("serial_layout")
def test_sheets_with_obstacles_are_compared_up_to_the_horizon() -> None:
    case = replace(SMALL, obstacles=True)
    scene = pinned_sheet.scene_of(case)
    assert scene.wind is not None
    assert len(scene.spheres) == 1
    assert 1 <= pinned_sheet.measure(case).frames <= case.frames


def test_the_reference_has_no_tethers() -> None:
    """The effect of a setting's tethers is an error: tethers that are too short change the cloth."""
    plain, tethered = replace(SMALL, obstacles=False), replace(SMALL, slack=1.0)
    first, second = (pinned_sheet.solution(case, pinned_sheet.scene_of(case)) for case in (plain, tethered))
    assert (first.positions == second.positions).all()
    assert pinned_sheet.scene_of(tethered).tethers is not None


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
    monkeypatch.setattr(subprocess_runner, "RUNS", 1)
    found = list(
        subprocess_runner.measure(["render", "drape15", "--frames", "1", "--size", "64x36", "--set", "solver=verlet"])
    )
    assert len(found) == subprocess_runner.MEASURED
    alone, _, _, empty, filled = found
    assert all(one.seconds > 0 for one in found)
    assert filled.what == "first frame, cache filled"
    assert empty.seconds > alone.seconds
    assert filled.peak_mb is None or filled.peak_mb > 20
    with pytest.raises(ChildFailed, match="no such scene"):
        list(subprocess_runner.measure(["render", "no_such_scene"]))


def test_the_command_prints_and_writes_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], running: None
) -> None:
    monkeypatch.setattr(pinned_sheet, "CASES", (SMALL,))
    commands = [
        subprocess_runner.Startup("taichi-cloth --help", 0.125),
        subprocess_runner.Startup("first frame, cache filled", 1.5, 200.0),
    ]
    monkeypatch.setattr(subprocess_runner, "measure", lambda: iter(commands))
    path = tmp_path / "goals.json"
    assert main(["bench", "--goals", "--json", str(path)]) == 0
    stored = json.loads(path.read_text(encoding="utf-8"))
    assert [one["seconds"] for one in stored["commands"]] == [0.125, 1.5]
    assert stored["sheets"][0]["name"] == "small"
    assert stored["date"] == datetime.now(UTC).date().isoformat()
    assert "first frame, cache filled" in capsys.readouterr().out


def test_goals_cannot_be_combined_with_other_measurements(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--goals", "--all"]) == 2
    assert main(["bench", "--goals", "--error"]) == 2
    assert main(["bench", "--goals", "--error", "--scene", "table"]) == 2
    assert capsys.readouterr().err.count("\n") == 3
