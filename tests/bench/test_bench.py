"""`taichi-cloth bench` measures what it says and writes it down. Nothing here depends on how long a frame takes."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
from dataclasses import asdict, fields
from math import isfinite, isnan
from pathlib import Path
from types import SimpleNamespace

import pytest

from taichi_cloth import cli
from taichi_cloth.bench import cases, children, floor, report
from taichi_cloth.bench.cases import Case
from taichi_cloth.bench.children import Bench, ChildFailed, bench, steps
from taichi_cloth.bench.report import Row, StageRow
from taichi_cloth.scene import load_scene
from taichi_cloth.solvers import SOLVERS

SEED = Case("curtain", "verlet", 5, 7, 2, 3, "list")
SHEET = Case("sheet", "spring", 5, 7, 1, 1, "list")
NOT_A_PATH = Case("curtain", "verlet", 5, 7, 2, 3, "tapestry")
STAGES = [Case("curtain", "verlet", 5, 7, 2, 3, "list", change) for change in ("", "-wind", "+limit", "=reflection")]

Measured = tuple[list[Row], list[StageRow], dict[str, str]]


@pytest.fixture(autouse=True, scope="module")
def taichi() -> None:
    """Taichi runs in the children only."""


@pytest.fixture(scope="module")
def measured() -> Measured:
    """Three cases, one of which fails, on a machine without a compiler; and three stages."""
    names: list[str] = []
    with pytest.MonkeyPatch.context() as patch, bench(3, names.append) as running:
        patch.setenv("PATH", "")
        patch.delenv("CC", raising=False)
        rows, stages = running.measure([SEED, SHEET, NOT_A_PATH], STAGES)
    assert all(child._process.poll() is not None for child in running._children)
    assert len(names) == steps([SEED, SHEET, NOT_A_PATH], STAGES) - 1  # what failed is not compiled a second time
    return rows, stages, running.floor.missing


def test_a_row_has_every_number_and_all_are_finite(measured: Measured) -> None:
    for row in measured[0][:2]:
        told = {name: value for name, value in asdict(row).items() if value is not None}
        not_here = {"over_c", "under_javascript", "error"} | ({"stretch"} if row.scene == "sheet" else set())
        assert {field.name for field in fields(Row)} - set(told) == not_here
        numbers = [value for value in told.values() if not isinstance(value, str)]
        assert all(isfinite(value) for value in numbers)
        assert row.frames == 3
        assert (row.columns, row.rows, row.path) == (7, 5, "list")
        assert min(row.median_ms, row.ns_per_spring, row.cold_s, row.warm_s, row.peak_mb, row.state_mb) > 0
        assert row.p95_ms >= row.median_ms
        sweeps = row.substeps * row.iterations
        assert row.ns_per_spring * sweeps * row.springs == pytest.approx(1e6 * row.median_ms)
    curtain, sheet, _ = measured[0]
    assert curtain.springs == sheet.springs == (4 * 7 + 5 * 6) + 2 * 4 * 6 + (5 * 5 + 3 * 7)
    assert curtain.substeps == 2
    assert sheet.substeps > 1  # the least that are stable


def test_stages_are_compared_with_all_of_them(measured: Measured) -> None:
    stages = measured[1]
    assert [stage.change for stage in stages] == ["", "-wind", "+limit", "=reflection"]
    assert stages[0].more_ms == 0
    assert all(stage.median_ms > 0 and stage.cold_s > 0 for stage in stages)
    assert all(stage.frames_per_second == pytest.approx(1e3 / stage.median_ms) for stage in stages)
    assert stages[0].penetration == 0 < stages[3].penetration
    assert stages[1].more_ms == pytest.approx(stages[1].median_ms - stages[0].median_ms)


def test_without_a_compiler_the_floor_is_a_dash_and_the_reason_a_line(
    measured: Measured, capsys: pytest.CaptureFixture[str]
) -> None:
    rows, stages, missing = measured
    assert report.cells(rows[0])[9:11] == ["-", "-"]
    report.print_report(rows, stages, missing)
    lines = capsys.readouterr().out.splitlines()
    assert "C: no compiler ($CC, cc, gcc, clang)" in lines
    assert " ".join(report.HEADINGS).split() in [line.split() for line in lines[:2]]
    assert any(line.lstrip().startswith("without wind") for line in lines)
    assert any(line.lstrip().startswith("with limit") for line in lines)
    assert any(line.lstrip().startswith("ball with reflection") for line in lines)
    assert " cores · Python 3." in lines[-1]
    assert "Taichi 1." in lines[-1]


def test_a_measurement_that_fails_says_why_and_the_others_go_on(measured: Measured) -> None:
    row = measured[0][2]
    assert (row.solver, row.path, row.median_ms) == ("verlet", "tapestry", None)
    assert "verlet has no path 'tapestry'" in str(row.error)
    assert report.cells(row)[5:] == ["-"] * 12
    assert list(report.failures(measured[0], measured[1])) == ["verlet 7×5 tapestry, failed"]


def test_csv_and_json_read_back(measured: Measured, tmp_path: Path) -> None:
    rows, stages, missing = measured
    report.write_csv(tmp_path / "b.csv", rows)
    with (tmp_path / "b.csv").open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert [line["solver"] for line in lines] == ["verlet", "spring", "verlet"]
    assert float(lines[0]["median_ms"]) == rows[0].median_ms
    assert lines[0]["over_c"] == ""
    report.write_json(tmp_path / "b.json", rows, stages, missing)
    told = json.loads((tmp_path / "b.json").read_text(encoding="utf-8"))
    assert [Row(**row) for row in told["rows"]] == rows
    assert [StageRow(**row) for row in told["stages"]] == stages
    assert told["machine"] == report.machine()
    assert told["missing"] == missing


class Told:
    """A child that answers what it is told to; a frame of it takes 6 ms, but for one that takes 60."""

    def frames(self, count: int, seconds: float) -> list[list[float]]:
        return [[6.0] * (count - 1) + [60.0]]

    def finish(self) -> dict[str, object]:
        outcome = {"max_strain": 0.3, "static_strain": 0.1, "state_bytes": 5e6}
        return {"cases": [outcome], "peak_bytes": 7e6}


class ToldFloor:
    """C takes 2, 3 and 1 ms in three rounds, JavaScript 12, 18 and 6."""

    def __init__(self) -> None:
        self.rounds = {"frame": [2.0, 3.0, 1.0], "javascript": [12.0, 18.0, 6.0]}

    def median_ms(self, program: str, *numbers: int) -> float | None:
        return self.rounds[program].pop(0)


@pytest.mark.parametrize("compiler", [True, False])
def test_ratios_are_those_of_medians_round_by_round(tmp_path: Path, compiler: bool) -> None:
    running = Bench(tmp_path, 30, lambda name: None)
    running.floor = ToldFloor() if compiler else SimpleNamespace(median_ms=lambda *numbers: None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(children, "floor_of", lambda case: SimpleNamespace(in_c="frame", in_javascript="javascript"))
        row = running._time(SEED, Told(), {"substeps": 2, "springs": 100, "path": "list", "compile_s": 1.0})
    running.end()
    # 6/2, 6/3 and 6/1; 12/6, 18/6 and 6/6
    assert (row.over_c, row.under_javascript) == ((3.0, 2.0) if compiler else (None, None))
    assert (row.median_ms, row.p95_ms, row.frames) == (6.0, 60.0, 30)
    assert row.ns_per_spring == pytest.approx(6e6 / (2 * 3 * 100))
    assert (row.stretch, row.state_mb, row.peak_mb) == (pytest.approx(0.2), 5.0, 7.0)


@pytest.mark.skipif(not floor.FLOOR.exists(), reason="an installed wheel has no benchmarks")
def test_the_floor_is_timed_at_the_same_numbers(tmp_path: Path) -> None:
    (tmp_path / "floor.py").write_text(
        "class FloorError(Exception): pass\n"
        "def time_floor(*numbers):\n"
        "    if numbers[0] == 'explicit': raise FloorError('it does not compile')\n"
        "    return None if numbers[0] == 'frame' else {'median_ms': sum(numbers[1:])}\n"
    )
    timer = floor.FloorTimer(tmp_path / "floor.py")
    assert timer.median_ms("relax", 24, 30, 5, 12, 40) == 24 + 30 + 5 + 12 + 40
    assert timer.median_ms("frame", 24, 30, 5, 12, 40) is None
    assert timer.median_ms("explicit", 24, 30, 60, 1, 40) is None
    assert timer.missing == {"JavaScript": "no node", "explicit 30×24": "it does not compile"}


def test_a_wheel_has_no_floor(tmp_path: Path) -> None:
    timer = floor.FloorTimer(tmp_path / "floor.py")
    assert timer.median_ms("relax", 24, 30, 5, 12, 40) is None
    assert timer.missing == {"C, JavaScript": "benchmarks/floor is only in a checkout"}


@pytest.mark.parametrize(
    ("ms", "rate"),
    [(0.5, 360), (2.77, 360), (2.78, 144), (6.9, 144), (6.95, 60), (16.6, 60), (16.7, 0), (200.0, 0)],
)
def test_the_pictures_a_second_that_a_frame_is_fast_enough_for(ms: float, rate: int) -> None:
    assert cases.highest_rate(ms) == rate


def test_the_strain_that_the_weight_explains() -> None:
    # 0.2 kg/m² · 9.81 m/s² · 3.45 m on 2000 N/m
    assert cases.static_strain(load_scene("curtain", solver="xpbd")) == pytest.approx(0.0033845, abs=1e-7)
    assert cases.static_strain(load_scene("curtain")) == 0
    assert isnan(cases.static_strain(cases.scene_of(SHEET)))


def test_the_seed_frame_is_that_of_the_floor_on_any_grid() -> None:
    for rows, columns in ((24, 30), (64, 64)):
        scene = cases.scene_of(cases.case_of("verlet", (rows, columns)))
        cloth = scene.cloth
        assert cloth.height / (rows - 1) == pytest.approx(4.35 / (columns - 1))  # square cells
        assert cloth.center[1] + cloth.height / 2 == pytest.approx(3.975)
        assert (scene.solver.substeps, scene.solver.iterations) == (5, 12)
        assert scene.wind is not None
        assert len(scene.spheres) == 1
        assert scene.ground is None
    assert cases.floor_of(cases.case_of("verlet")) == cases.Floor("relax", "frame")
    assert cases.floor_of(cases.case_of("verlet", (64, 64))) == cases.Floor("relax", None)
    assert cases.floor_of(cases.case_of("spring")) == cases.Floor("explicit", None)
    assert cases.floor_of(cases.case_of("xpbd")) == cases.Floor(None, None)


def test_every_solver_and_path_is_among_the_cases() -> None:
    assert {case.solver for case in cases.default_cases()} == set(SOLVERS)
    every = {(case.solver, case.path) for case in cases.all_cases()}
    assert every == {(name, path) for name, kind in SOLVERS.items() for path in kind.paths}
    assert {case.solver for case in cases.only(cases.all_cases(), "spring")} == {"spring"}
    changes = [case.change for case in cases.stage_cases()]
    assert changes[:7] == ["", "-wind", "-sphere", "-ground", "-shear", "-bend", "+limit"]
    assert changes[-2:] == ["=reflection", "=repulsion"]


def test_stages_are_left_out_and_added() -> None:
    curtain = load_scene("curtain")
    assert cases.changed(curtain, "") == curtain
    assert cases.changed(curtain, "-wind").wind is None
    assert cases.changed(curtain, "-sphere").spheres == ()
    assert cases.changed(curtain, "-shear").springs.shear == 0
    assert cases.changed(curtain, "-bend").fabric.bend == 0
    assert cases.changed(curtain, "+limit").limit is not None
    assert [ball.response for ball in cases.changed(curtain, "=repulsion").spheres] == ["repulsion"]


def test_a_child_whose_bench_has_ended_is_gone() -> None:
    with bench(3) as running:
        compiling = running._compile("verlet", [SEED], running._cache())
        while not running._children:
            pass
    assert running._children[0]._process.poll() is not None
    assert isinstance(compiling.exception(), ChildFailed)


def hear_ctrl_c() -> None:
    """A job that a shell put into the background hears none, and its children neither."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_ctrl_c_ends_the_children_too(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "taichi_cloth", "bench", "--only", "verlet"]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    process = subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=hear_ctrl_c
    )
    assert process.stdout is not None
    assert "compiling" in process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)  # a child that lived on would hold stderr open
    assert (process.returncode, err.count("\n")) == (130, 1)
    assert list(tmp_path.iterdir()) == []


# -- the command ---------------------------------------------------------------------------------------


def test_the_command_prints_and_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cases, "default_cases", lambda: [SEED, SHEET])
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    names = [str(tmp_path / "b.csv"), str(tmp_path / "b.json")]
    assert cli.main(["bench", "--only", "spring", "--frames", "3", "--csv", names[0], "--json", names[1]]) == 0
    out = capsys.readouterr().out
    assert out.startswith("1/3 spring 7×5 list, compiling\n2/3 spring 7×5 list\n3/3 ")
    assert "verlet" not in out
    assert len((tmp_path / "b.csv").read_text(encoding="utf-8").splitlines()) == 2
    assert len(json.loads((tmp_path / "b.json").read_text(encoding="utf-8"))["rows"]) == 1


def test_the_stages_alone(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(cases, "stage_cases", lambda: STAGES[:2])
    assert cli.main(["bench", "--stages", "--frames", "3"]) == 0
    out = capsys.readouterr().out
    assert "without wind" in out
    assert "solver" not in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--only", "varlet"], "did you mean 'verlet'?"),
        (["--only", "verlet", "--stages"], "not allowed with"),
        (["--csv", "there.csv"], "there.csv exists already: use --force to replace it"),
        (["--json", "there.csv"], "there.csv exists already"),
        (["--csv", "."], ". is a folder, not a file"),
        (["--json", "none/b.json", "--force"], "none is no folder to write b.json into"),
        (["--frames", "0"], "whole number"),
    ],
)
def test_mistakes_are_one_line_before_anything_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("there.csv").write_text("mine")
    try:
        code = cli.main(["bench", *words])
    except SystemExit as error:
        code = error.code
    out, err = capsys.readouterr()
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert said in err
    assert Path("there.csv").read_text() == "mine"
