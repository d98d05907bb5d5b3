"""The command `bench` measures and writes its results. No test depends on how long a frame takes."""

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
from typing import Any

import pytest

from taichi_cloth.__main__ import main
from taichi_cloth.evaluation.bench import bench_report as report
from taichi_cloth.evaluation.bench import cases, subprocess_runner
from taichi_cloth.evaluation.bench.bench_report import FeatureRow, Row
from taichi_cloth.evaluation.bench.cases import Case
from taichi_cloth.evaluation.bench.subprocess_runner import Bench, ChildFailed, bench, steps
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.solvers import LAYOUTS, SOLVERS
from taichi_cloth.system.console import write_csv

CURTAIN = Case("curtain", "verlet", 5, 7, 2, 3, "serial")
SHEET = Case("sheet", "explicit", 5, 7, 1, 1, "serial")
NOT_A_LAYOUT = Case("curtain", "verlet", 5, 7, 2, 3, "tapestry")
FEATURES = [
    Case("curtain", "verlet", 5, 7, 2, 3, "serial", change) for change in ("", "-wind", "+strain_limit", "=reflection")
]

Measured = tuple[list[Row], list[FeatureRow], dict[str, str]]


@pytest.fixture(autouse=True, scope="module")
def taichi() -> None:
    """Taichi runs only in child processes."""


@pytest.fixture(scope="module")
def measured() -> Measured:
    """Measure three cases, one of which fails, on a machine without a compiler; and four feature cases."""
    names: list[str] = []
    with pytest.MonkeyPatch.context() as patch, bench(3, names.append) as running:
        patch.setenv("PATH", "")
        patch.delenv("CC", raising=False)
        rows, features = running.measure([CURTAIN, SHEET, NOT_A_LAYOUT], FEATURES)
    assert all(child._process.poll() is not None for child in running._children)
    assert len(names) == steps([CURTAIN, SHEET, NOT_A_LAYOUT], FEATURES) - 1  # a failed case is not compiled again
    return rows, features, running.floor.missing


def test_a_row_has_every_value_and_all_are_finite(measured: Measured) -> None:
    for row in measured[0][:2]:
        values = {name: value for name, value in asdict(row).items() if value is not None}
        missing = {"ratio_to_c", "speedup_over_javascript", "error"} | ({"stretch"} if row.scene == "sheet" else set())
        assert {field.name for field in fields(Row)} - set(values) == missing
        numbers = [value for value in values.values() if not isinstance(value, str)]
        assert all(isfinite(value) for value in numbers)
        assert row.frames == 3
        assert (row.columns, row.rows, row.layout) == (7, 5, "serial")
        assert min(values[name] for name in ("ns_per_spring", "cold_s", "warm_s", "peak_mb", "state_mb")) > 0
        assert 0 < values["median_ms"] <= values["p95_ms"]
        sweeps = row.substeps * row.iterations
        assert values["ns_per_spring"] * sweeps * values["springs"] == pytest.approx(1e6 * values["median_ms"])
    curtain, sheet, _ = measured[0]
    assert curtain.springs == sheet.springs == (4 * 7 + 5 * 6) + 2 * 4 * 6 + (5 * 5 + 3 * 7)
    assert curtain.substeps == 2
    assert sheet.substeps > 1  # the fewest that are stable


def test_features_are_compared_with_the_unchanged_curtain(measured: Measured) -> None:
    features = measured[1]
    assert [row.change for row in features] == ["", "-wind", "+strain_limit", "=reflection"]
    assert features[0].more_ms == 0
    assert all(asdict(row)["median_ms"] > 0 and asdict(row)["cold_s"] > 0 for row in features)
    ms = [asdict(row)["median_ms"] for row in features]
    assert [row.frames_per_second for row in features] == pytest.approx([1e3 / one for one in ms])
    assert features[0].penetration == 0 < asdict(features[3])["penetration"]
    assert features[1].more_ms == pytest.approx(ms[1] - ms[0])


def test_without_a_compiler_the_report_has_dashes_and_the_reason(
    measured: Measured, capsys: pytest.CaptureFixture[str]
) -> None:
    rows, features, missing = measured
    assert report.cells(rows[0])[9:11] == ["-", "-"]
    report.print_report(rows, features, missing)
    lines = capsys.readouterr().out.splitlines()
    assert "C: no compiler ($CC, cc, gcc, clang)" in lines
    assert " ".join(report.HEADINGS).split() in [line.split() for line in lines[:2]]
    assert any(line.lstrip().startswith("without wind") for line in lines)
    assert any(line.lstrip().startswith("with strain_limit") for line in lines)
    assert any(line.lstrip().startswith("sphere with reflection") for line in lines)
    assert " cores · Python 3." in lines[-1]
    assert "Taichi 1." in lines[-1]


def test_a_failed_measurement_gives_the_reason_and_the_others_continue(measured: Measured) -> None:
    row = measured[0][2]
    assert (row.solver, row.layout, row.median_ms) == ("verlet", "tapestry", None)
    assert "unknown layout 'tapestry'" in str(row.error)
    assert report.cells(row)[5:] == ["-"] * 13
    assert list(report.failures(measured[0], measured[1])) == ["verlet 7×5 tapestry, failed"]


def test_csv_and_json_can_be_read_back(measured: Measured, tmp_path: Path) -> None:
    rows, features, missing = measured
    write_csv(tmp_path / "b.csv", rows, Row)
    with (tmp_path / "b.csv").open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert [line["solver"] for line in lines] == ["verlet", "explicit", "verlet"]
    assert float(lines[0]["median_ms"]) == rows[0].median_ms
    assert lines[0]["ratio_to_c"] == ""
    report.write_json(tmp_path / "b.json", rows, features, missing)
    stored = json.loads((tmp_path / "b.json").read_text(encoding="utf-8"))
    assert [Row(**row) for row in stored["rows"]] == rows
    assert [FeatureRow(**row) for row in stored["features"]] == features
    assert stored["machine"] == report.machine()
    assert stored["missing"] == missing


class FixedChild:
    """A child with fixed answers: a frame takes 6 ms, except one that takes 60 ms."""

    def frames(self, count: int, seconds: float) -> list[list[float]]:
        return [[6.0] * (count - 1) + [60.0]]

    def finish(self) -> dict[str, object]:
        outcome = {"max_strain": 0.3, "static_strain": 0.1, "state_bytes": 5e6, "frame_error": 0.0012}
        return {"cases": [outcome], "peak_bytes": 7e6}


class FixedTimer:
    """C takes 2, 3 and 1 ms in three rounds, JavaScript 12, 18 and 6 ms."""

    def __init__(self) -> None:
        self.rounds = {"frame": [2.0, 3.0, 1.0], "javascript": [12.0, 18.0, 6.0]}

    def median_ms(self, program: str, *numbers: int) -> float | None:
        return self.rounds[program].pop(0)


@pytest.mark.parametrize("compiler", [True, False])
def test_ratios_are_the_medians_of_the_ratios_of_all_rounds(tmp_path: Path, compiler: bool) -> None:
    running = Bench(tmp_path, 30, lambda name: None)
    timer: Any = FixedTimer() if compiler else SimpleNamespace(median_ms=lambda *numbers: None)
    child: Any = FixedChild()
    running.floor = timer
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            subprocess_runner,
            "native_programs_of",
            lambda case: SimpleNamespace(in_c="frame", in_javascript="javascript"),
        )
        row = running._time(CURTAIN, child, {"substeps": 2, "springs": 100, "layout": "serial", "compile_s": 1.0})
    running.end()
    # 6/2, 6/3 and 6/1; 12/6, 18/6 and 6/6
    assert (row.ratio_to_c, row.speedup_over_javascript) == ((3.0, 2.0) if compiler else (None, None))
    assert (row.median_ms, row.p95_ms, row.frames) == (6.0, 60.0, 30)
    assert row.ns_per_spring == pytest.approx(6e6 / (2 * 3 * 100))
    assert (row.stretch, row.state_mb, row.peak_mb) == (pytest.approx(0.2), 5.0, 7.0)


@pytest.mark.skipif(not cases.FLOOR.exists(), reason="an installed wheel has no benchmarks")
def test_native_programs_are_timed_with_the_same_arguments(tmp_path: Path) -> None:
    (tmp_path / "floor.py").write_text(
        "class FloorError(Exception): pass\n"
        "def time_floor(*numbers):\n"
        "    if numbers[0] == 'explicit': raise FloorError('it does not compile')\n"
        "    return None if numbers[0] == 'frame' else {'median_ms': sum(numbers[1:])}\n"
    )
    timer = cases.NativeTimer(tmp_path / "floor.py")
    assert timer.median_ms("relax", 24, 30, 5, 12, 40) == 24 + 30 + 5 + 12 + 40
    assert timer.median_ms("frame", 24, 30, 5, 12, 40) is None
    assert timer.median_ms("explicit", 24, 30, 60, 1, 40) is None
    assert timer.missing == {"JavaScript": "no node", "explicit 30×24": "it does not compile"}


def test_a_wheel_has_no_native_programs(tmp_path: Path) -> None:
    timer = cases.NativeTimer(tmp_path / "floor.py")
    assert timer.median_ms("relax", 24, 30, 5, 12, 40) is None
    assert timer.missing == {"C, JavaScript": "benchmarks/floor is only in a checkout"}


@pytest.mark.parametrize(
    ("ms", "rate"),
    [(0.5, 360), (2.77, 360), (2.78, 144), (6.9, 144), (6.95, 60), (16.6, 60), (16.7, 0), (200.0, 0)],
)
def test_the_highest_frame_rate_of_a_frame_time(ms: float, rate: int) -> None:
    assert cases.highest_rate(ms) == rate


def test_the_static_strain_is_that_of_the_weight() -> None:
    # 0.2 kg/m² · 9.81 m/s² · 3.45 m on 2000 N/m
    assert cases.static_strain(load_scene("curtain", solver="xpbd")) == pytest.approx(0.0033845, abs=1e-7)
    assert cases.static_strain(load_scene("curtain")) == 0
    assert isnan(cases.static_strain(cases.scene_of(SHEET)))


def test_the_curtain_has_square_cells_and_native_programs_on_any_grid() -> None:
    for rows, columns in ((24, 30), (64, 64)):
        scene = cases.scene_of(cases.case_of("verlet", (rows, columns)))
        cloth = scene.cloth
        assert cloth.height / (rows - 1) == pytest.approx(4.35 / (columns - 1))  # square cells
        assert cloth.center[1] + cloth.height / 2 == pytest.approx(3.975)
        assert (scene.solver.substeps, scene.solver.iterations) == (5, 12)
        assert scene.wind is not None
        assert len(scene.spheres) == 1
        assert scene.ground is None
    assert cases.native_programs_of(cases.case_of("verlet")) == cases.NativePrograms("relax", "frame")
    assert cases.native_programs_of(cases.case_of("verlet", (64, 64))) == cases.NativePrograms("relax", None)
    assert cases.native_programs_of(cases.case_of("explicit")) == cases.NativePrograms("explicit", None)
    assert cases.native_programs_of(cases.case_of("xpbd")) == cases.NativePrograms(None, None)


def test_every_solver_and_layout_is_among_the_cases() -> None:
    assert {case.solver for case in cases.default_cases()} == set(SOLVERS)
    every = {(case.solver, case.layout) for case in cases.all_cases()}
    assert every == {(name, layout) for name, kind in SOLVERS.items() for layout in LAYOUTS}
    assert {case.solver for case in cases.filter_cases(cases.all_cases(), "explicit")} == {"explicit"}
    changes = [case.change for case in cases.feature_cases()]
    assert changes[:7] == ["", "-wind", "-sphere", "-ground", "-shear", "-bend", "+strain_limit"]
    assert changes[-2:] == ["=reflection", "=repulsion"]


def test_features_are_removed_and_added() -> None:
    curtain = load_scene("curtain")
    assert cases.with_change(curtain, "") == curtain
    assert cases.with_change(curtain, "-wind").wind is None
    assert cases.with_change(curtain, "-sphere").spheres == ()
    assert cases.with_change(curtain, "-shear").verlet.shear == 0
    assert cases.with_change(curtain, "-bend").fabric.bend_spring == 0
    assert cases.with_change(curtain, "+strain_limit").strain_limit is not None
    assert [ball.response for ball in cases.with_change(curtain, "=repulsion").spheres] == ["repulsion"]


def test_children_end_with_their_bench() -> None:
    with bench(3) as running:
        compiling = running._compile("verlet", [CURTAIN], running._cache())
        while not running._children:
            pass
    assert running._children[0]._process.poll() is not None
    assert isinstance(compiling.exception(), ChildFailed)


def restore_sigint() -> None:
    """Background jobs of a shell ignore SIGINT, and so do their children."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_sigint_ends_the_children(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "taichi_cloth", "bench", "--filter", "verlet"]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    process = subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=restore_sigint
    )
    assert process.stdout is not None
    assert "compiling" in process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)  # a remaining child would hold stderr open
    assert (process.returncode, err.count("\n")) == (130, 1)
    assert list(tmp_path.iterdir()) == []


# -- the command ---------------------------------------------------------------------------------------


def test_the_command_prints_and_writes_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cases, "default_cases", lambda: [CURTAIN, SHEET])
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    names = [str(tmp_path / "b.csv"), str(tmp_path / "b.json")]
    assert main(["bench", "--filter", "explicit", "--frames", "3", "--csv", names[0], "--json", names[1]]) == 0
    out = capsys.readouterr().out
    assert out.startswith("1/3 explicit 7×5 serial, compiling\n2/3 explicit 7×5 serial\n3/3 ")
    assert "verlet" not in out
    assert len((tmp_path / "b.csv").read_text(encoding="utf-8").splitlines()) == 2
    assert len(json.loads((tmp_path / "b.json").read_text(encoding="utf-8"))["rows"]) == 1


def test_features_can_be_measured_alone(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(cases, "feature_cases", lambda: FEATURES[:2])
    assert main(["bench", "--features", "--frames", "3"]) == 0
    out = capsys.readouterr().out
    assert "without wind" in out
    assert "solver" not in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--filter", "varlet"], "did you mean 'verlet'?"),
        (["--filter", "verlet", "--features"], "not allowed with"),
        (["--csv", "there.csv"], "there.csv already exists; use --force to replace it"),
        (["--json", "there.csv"], "there.csv already exists"),
        (["--csv", "."], ". is a folder, not a file"),
        (["--json", "there.csv/b.json", "--force"], "cannot write b.json: there.csv is not a folder"),
        (["--frames", "0"], "not an integer"),
    ],
)
def test_mistakes_are_reported_in_one_line_before_measuring(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("there.csv").write_text("mine")
    code: object
    try:
        code = main(["bench", *words])
    except SystemExit as error:
        code = error.code
    out, err = capsys.readouterr()
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert said in err
    assert Path("there.csv").read_text() == "mine"
