"""Points of the front: what is measured, which are on it, and what the command writes."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from taichi_cloth import cli
from taichi_cloth.accuracy import report, sweep
from taichi_cloth.accuracy.sweep import Point, knee, measure, pareto
from taichi_cloth.accuracy.truth import Curtain
from taichi_cloth.scene.model import SOLVER_NAMES
from taichi_cloth.simulation import Simulation

pytestmark = pytest.mark.usefixtures("running")

POINT = Point("spring", 8, 14, 1, 0.1, 0.2, 1e-6, 1e-5, 0.0, 0.01, 1.0)


def points(*numbers: tuple[float, float]) -> list[Point]:
    return [replace(POINT, median_ms=ms, p95_ms=ms, max_error=error) for ms, error in numbers]


def test_the_explicit_method_is_right_and_euler_is_not() -> None:
    curtain = Curtain(8)
    right, wrong = measure(curtain, "spring", 1, 1), measure(curtain, "xpbd", 5, 12)
    assert right.substeps > 5
    assert right.max_error < 1e-4
    assert abs(right.stretch) < 1e-4
    assert right.kept == pytest.approx(1.0, abs=1e-3)
    assert 0.005 < wrong.rms_error < wrong.max_error < 0.2
    assert wrong.kept == pytest.approx((1 + (31.416 / 300) ** 2) ** -150, rel=1e-3)


@pytest.mark.parametrize("curtain", [Curtain(11, degrees=70.0), Curtain(8, constant=5e3), Curtain(9, area_density=1.0)])
def test_other_angles_stiffness_and_weights_are_as_right(curtain: Curtain) -> None:
    once, four_times = (measure(curtain, "spring", n, 1).max_error for n in (1, 4))
    assert once < 2e-4
    assert four_times < 2e-5


@pytest.mark.parametrize("solver", SOLVER_NAMES)
def test_every_method_has_springs_along_its_threads_only(solver: str) -> None:
    with Simulation(sweep.scene_of(Curtain(6), solver, 5, 1)) as simulation:
        assert list(simulation.topology.family_counts) == ["structural"]
        assert simulation.positions()[0] == pytest.approx([-0.5, 0.0, 0.0], abs=1e-6)
        assert simulation.positions()[-1] == pytest.approx([0.5, -(0.5**0.5), 0.5**0.5], abs=1e-6)


def test_a_wrong_weight_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error is that of the program: a sheet that is too heavy stretches, far from the motion of the right one."""
    right = sweep.scene_of
    monkeypatch.setattr(sweep, "scene_of", lambda curtain, *words: right(replace(curtain, area_density=0.5), *words))
    assert measure(Curtain(8, constant=50.0), "spring", 4, 1).max_error > 5e-3


def test_the_front_holds_what_nothing_beats() -> None:
    found = points((1.0, 0.5), (2.0, 0.6), (3.0, 0.1), (0.5, 0.9), (3.5, float("nan")), (4.0, 0.1))
    assert [(p.median_ms, p.max_error) for p in pareto(found)] == [(0.5, 0.9), (1.0, 0.5), (3.0, 0.1)]


def test_the_knee_is_where_the_front_bends() -> None:
    assert knee(points((1.0, 1.0), (2.0, 1e-3), (100.0, 1e-4))).median_ms == 2.0
    assert knee(points((1.0, 1.0), (2.0, 0.5))).median_ms == 2.0


def test_words_name_the_best_within_each_budget() -> None:
    lines = report.words(points((1.0, 1e-2), (5.0, 1e-3), (12.0, 1e-4)))
    assert lines[0].startswith("8 cells: spring 14 is the knee")
    assert [line.split(": ")[1] for line in lines[1:]] == ["0.01", "0.001", "0.0001"]


def test_the_command_writes_table_files_and_pictures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sweep, "GRIDS", (4, 6))
    words = ["bench", "--error", "--only", "spring", "--csv", "o.csv", "--json", "o.json", "--plot", "pictures"]
    assert cli.main(words) == 0
    told = capsys.readouterr().out
    assert told.count("←") >= 3  # in the legend and on both grids
    assert "is the knee" in told
    with Path("o.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["cells"] for row in rows] == ["4", "4", "6", "6"]
    assert all(float(row["max_error"]) < 1e-3 for row in rows)
    assert len(json.loads(Path("o.json").read_text())["points"]) == 4
    for cells in (4, 6):
        with Image.open(f"pictures/error_{cells}.png") as picture:
            assert picture.size == (960, 600)
            assert len(picture.convert("RGB").resize((96, 60)).getcolors()) > 10


@pytest.mark.parametrize(
    ("words", "message"),
    [(["--plot", "p"], "they go with --error"), (["--error", "--stages"], "three measurements")],
)
def test_options_that_do_not_go_together(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", *words]) == 2
    assert message in capsys.readouterr().err
