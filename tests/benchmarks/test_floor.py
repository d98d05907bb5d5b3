"""The programs of benchmarks/floor, compared with plain loops in float64. Nothing is timed."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

HERE = Path(__file__).resolve().parent


def load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # dataclasses look up their module there
    spec.loader.exec_module(module)
    return module


floor = load(HERE.parents[1] / "benchmarks" / "floor" / "floor.py")
loops = load(HERE / "plain_loops.py")

needs_compiler = pytest.mark.skipif(floor.compiler() is None, reason="no C compiler: neither $CC nor cc, gcc, clang")
needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="no node, which runs frame.mjs")

NEAR = 2e-5  # [m] float32 rounds a position of 4 m to 2.4e-7 m; a few hundred corrections add up

# rows, columns, substeps, iterations, frames. 37 columns cross the borders of packets of 8 particles, 11 leave
# lanes empty, and after 75 frames the ball touches the cloth.
CURTAINS = [(2, 2, 2, 3, 2), (3, 5, 2, 3, 2), (9, 11, 2, 3, 3), (7, 37, 2, 3, 2), (5, 10, 1, 2, 75)]
SHEETS = [(2, 2, 20, 3), (3, 3, 20, 3), (6, 11, 20, 4), (4, 37, 70, 2)]


@pytest.fixture(scope="module")
def builds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("builds")


def run(command: list[str], *words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*command, *map(str, words)], capture_output=True, text=True, timeout=60)


def each_build(program: str, builds: Path) -> list[list[str]]:
    found: list[list[str]] = floor.commands_of(program, builds)
    assert found
    return found


def positions(command: list[str], *numbers: int) -> NDArray[np.float64]:
    result = run(command, *numbers, "dump")
    assert result.returncode == 0, result.stderr
    return np.array(json.loads(result.stdout)["positions"])


@needs_compiler
@pytest.mark.parametrize("numbers", CURTAINS)
def test_relax_has_the_motion_of_the_plain_loop(numbers: tuple[int, ...], builds: Path) -> None:
    for command in each_build("relax", builds):
        np.testing.assert_allclose(positions(command, *numbers), loops.relax_frames(*numbers), rtol=0, atol=NEAR)


@needs_node
@pytest.mark.parametrize("numbers", CURTAINS)
def test_frame_has_the_motion_of_the_plain_loop(numbers: tuple[int, ...], builds: Path) -> None:
    expected = loops.relax_frames(*numbers, by_color=False)
    [command] = each_build("frame", builds)
    np.testing.assert_allclose(positions(command, *numbers), expected, rtol=0, atol=1e-9)


@needs_compiler
@pytest.mark.parametrize("numbers", SHEETS)
def test_explicit_has_the_motion_of_the_plain_loop(numbers: tuple[int, ...], builds: Path) -> None:
    rows, columns, substeps, frames = numbers
    expected = loops.explicit_frames(rows, columns, substeps, frames)
    for command in each_build("explicit", builds):
        np.testing.assert_allclose(positions(command, rows, columns, substeps, 1, frames), expected, rtol=0, atol=NEAR)


@pytest.mark.parametrize("change", [{"ball": False}, {"wind": False}, {"by_color": False}])
def test_the_comparison_detects_ball_wind_and_order(change: dict[str, bool]) -> None:
    numbers = (5, 10, 1, 2, 75)
    assert np.abs(loops.relax_frames(*numbers) - loops.relax_frames(*numbers, **change)).max() > 20 * NEAR


@needs_compiler
@pytest.mark.parametrize("native", [True, False])
@pytest.mark.parametrize("program", ["relax", "explicit"])
def test_programs_compile_without_warnings_and_give_equal_motion_without_avx(
    program: str, native: bool, tmp_path: Path
) -> None:
    command = floor.compile_command(program, tmp_path / program, native=native)
    result = run([*command, "-Werror"])
    if native and result.returncode and "march" in result.stderr:
        pytest.skip("this compiler has no -march=native")
    assert result.returncode == 0, result.stderr
    got = positions([str(tmp_path / program)], 6, 11, 20, 1, 1)
    expected = loops.relax_frames(6, 11, 20, 1, 1) if program == "relax" else loops.explicit_frames(6, 11, 20, 1)
    np.testing.assert_allclose(got, expected, rtol=0, atol=NEAR)


@pytest.mark.parametrize(
    "program", [pytest.param("relax", marks=needs_compiler), pytest.param("frame", marks=needs_node)]
)
def test_strain_and_height_match_the_positions(program: str, builds: Path) -> None:
    result = run(each_build(program, builds)[-1], 6, 11, 2, 3, 20, "dump")
    line: dict[str, Any] = json.loads(result.stdout)
    x = np.array(line["positions"]).reshape(6, 11, 3)
    lengths = [np.linalg.norm(np.diff(x, axis=axis), axis=-1).ravel() for axis in (0, 1)]
    assert line["max_strain"] == pytest.approx(np.abs(np.concatenate(lengths) / (4.35 / 10) - 1).max(), rel=1e-4)
    assert line["mean_height"] == pytest.approx(x[..., 1].mean(), rel=1e-6)
    assert 0 < line["best_ms"] <= line["median_ms"] <= line["p95_ms"]


BAD = [(), (24, 30, 5, 12), (1, 30, 5, 12, 1), (24, 30, 0, 12, 1), (24, 30, 5, 12, "x"), (24, 30, 5, 12, 1, "drop")]


@pytest.mark.parametrize("words", BAD)
@pytest.mark.parametrize(
    "program",
    [
        pytest.param("relax", marks=needs_compiler),
        pytest.param("explicit", marks=needs_compiler),
        pytest.param("frame", marks=needs_node),
    ],
)
def test_invalid_arguments_give_one_line_and_exit_code_2(program: str, words: tuple[object, ...], builds: Path) -> None:
    result = run(each_build(program, builds)[0], *words)
    assert result.returncode == 2
    assert len(result.stderr.splitlines()) == 1
    assert result.stdout == ""


@needs_compiler
def test_explicit_refuses_iterations_and_reports_divergence(builds: Path) -> None:
    explicit = each_build("explicit", builds)[0]
    assert run(explicit, 6, 11, 20, 12, 1).returncode == 2
    blown = run(explicit, 24, 30, 5, 1, 60)
    assert (blown.returncode, blown.stdout) == (1, "")
    assert "more substeps" in blown.stderr


@needs_compiler
def test_a_program_is_compiled_once(tmp_path: Path) -> None:
    built = floor.build("relax", tmp_path)
    written = built.stat().st_mtime_ns
    assert floor.build("relax", tmp_path) == built
    assert built.stat().st_mtime_ns == written
    assert list(tmp_path.iterdir()) == [built]


@needs_compiler
def test_time_floor_returns_the_result_of_a_program() -> None:
    line = floor.time_floor("relax", 4, 4, 1, 1, 2)
    assert line is not None
    assert (line["program"], line["rows"], line["frames"]) == ("relax", 4, 2)
    with pytest.raises(floor.FloorError, match="to 100000"):
        floor.time_floor("relax", 1, 4, 1, 1, 2)


def test_cc_selects_the_compiler_and_may_select_none(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    tool = tmp_path / "tool"
    tool.write_text("#!/bin/sh\n")
    tool.chmod(0o755)
    monkeypatch.setenv("CC", f"{tool} -m64")
    if os.name != "nt":
        assert floor.compiler() == f"{tool} -m64"
    monkeypatch.setenv("CC", "no-such-compiler")
    assert floor.compiler() is None
    monkeypatch.delenv("CC")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert [floor.time_floor(program, 2, 2, 1, 1, 1) for program in floor.PROGRAMS] == [None, None, None]
    with pytest.raises(floor.FloorError, match="no program"):
        floor.time_floor("flor", 2, 2, 1, 1, 1)
