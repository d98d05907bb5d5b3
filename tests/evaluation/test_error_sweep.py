"""The Pareto front of settings: measured points, the front, and the files of the command."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from taichi_cloth.__main__ import main
from taichi_cloth.evaluation.bench import error_sweep
from taichi_cloth.evaluation.bench.error_sweep import Curtain, Point, elbow, measure, pareto
from taichi_cloth.scene.schema import SOLVER_NAMES
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.usefixtures("running")

POINT = Point("explicit", 8, 14, 1, 0.1, 0.2, 1e-6, 1e-5, 0.0, 0.01, 1.0)


def points(*numbers: tuple[float, float]) -> list[Point]:
    return [replace(POINT, median_ms=ms, p95_ms=ms, max_error=error) for ms, error in numbers]


def test_the_explicit_solver_is_accurate_and_euler_is_not() -> None:
    curtain = Curtain(8)
    accurate, euler = measure(curtain, "explicit", 1, 1), measure(curtain, "xpbd", 5, 12)
    assert accurate.substeps > 5
    assert accurate.max_error < 1e-4
    assert abs(accurate.stretch) < 1e-4
    assert accurate.remaining_amplitude == pytest.approx(1.0, abs=1e-3)
    assert 0.005 < euler.rms_error < euler.max_error < 0.2
    assert euler.remaining_amplitude == pytest.approx((1 + (31.416 / 300) ** 2) ** -150, rel=1e-3)


@pytest.mark.parametrize(
    "curtain", [Curtain(11, degrees=70.0), Curtain(8, stiffness=5e3), Curtain(9, area_density=1.0)]
)
def test_other_angles_stiffness_and_weights_are_as_accurate(curtain: Curtain) -> None:
    once, four_times = (measure(curtain, "explicit", n, 1).max_error for n in (1, 4))
    assert once < 2e-4
    assert four_times < 2e-5


@pytest.mark.parametrize("solver", SOLVER_NAMES)
def test_every_solver_has_structural_springs_only(solver: str) -> None:
    with Simulation(error_sweep.scene_of(Curtain(6), solver, 5, 1)) as simulation:
        assert list(simulation.topology.family_counts) == ["structural"]
        assert simulation.positions()[0] == pytest.approx([-0.5, 0.0, 0.0], abs=1e-6)
        assert simulation.positions()[-1] == pytest.approx([0.5, -(0.5**0.5), 0.5**0.5], abs=1e-6)


def test_a_wrong_weight_increases_the_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error is that of the simulation: a sheet that is too heavy stretches."""
    unchanged = error_sweep.scene_of
    monkeypatch.setattr(
        error_sweep, "scene_of", lambda curtain, *words: unchanged(replace(curtain, area_density=0.5), *words)
    )
    assert measure(Curtain(8, stiffness=50.0), "explicit", 4, 1).max_error > 5e-3


def test_the_front_has_the_points_that_no_other_point_dominates() -> None:
    found = points((1.0, 0.5), (2.0, 0.6), (3.0, 0.1), (0.5, 0.9), (3.5, float("nan")), (4.0, 0.1))
    assert [(p.median_ms, p.max_error) for p in pareto(found)] == [(0.5, 0.9), (1.0, 0.5), (3.0, 0.1)]


def test_cloth_that_is_not_finite_is_not_on_the_front(capsys: pytest.CaptureFixture[str]) -> None:
    broken = replace(POINT, median_ms=0.01, rms_error=float("nan"), max_error=1e-9)  # in files of earlier versions
    assert pareto([broken, POINT]) == [POINT]
    error_sweep.print_report([broken, POINT])
    assert "not finite" in capsys.readouterr().out
    assert error_sweep.summary_lines([broken]) == ["8 cells: no setting is finite"]


@pytest.mark.parametrize("wrong", [float("nan"), 0.02])
def test_the_error_is_that_of_all_frames_and_directions(wrong: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """In one frame of the swing a particle is elsewhere along the top edge, or nowhere."""
    curtain, frames = Curtain(4), iter(range(1000))
    correct = measure(curtain, "explicit", 1, 1).max_error
    plain = Simulation.positions

    def positions(simulation: Simulation) -> np.ndarray:
        x = plain(simulation)
        if len(x) == 25 and next(frames) == 10:  # not the spring whose amplitude is measured too
            x[12, 0] += wrong
        return x

    monkeypatch.setattr(Simulation, "positions", positions)
    found = measure(curtain, "explicit", 1, 1).max_error
    assert correct < 1e-3
    assert found == pytest.approx(wrong, rel=1e-2, nan_ok=True)


def test_the_knee_is_where_the_front_bends() -> None:
    assert elbow(points((1.0, 1.0), (2.0, 1e-3), (100.0, 1e-4))).median_ms == 2.0
    assert elbow(points((1.0, 1.0), (2.0, 0.5))).median_ms == 2.0


def test_the_summary_names_the_best_setting_for_each_frame_rate() -> None:
    lines = error_sweep.summary_lines(points((1.0, 1e-2), (5.0, 1e-3), (12.0, 1e-4)))
    assert lines[0].startswith("8 cells: explicit 14 is the elbow")
    assert [line.split(": ")[1] for line in lines[1:]] == ["0.01", "0.001", "0.0001"]


def test_the_command_writes_a_table_files_and_plots(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(error_sweep, "GRIDS", (4, 6))
    words = ["bench", "--error", "--filter", "explicit", "--csv", "o.csv", "--json", "o.json", "--plot", "pictures"]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert out.count("←") >= 3  # in the legend and on both grids
    assert "is the elbow" in out
    with Path("o.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["cells"] for row in rows] == ["4", "4", "6", "6"]
    assert all(float(row["max_error"]) < 1e-3 for row in rows)
    assert len(json.loads(Path("o.json").read_text())["points"]) == 4
    for cells in (4, 6):
        with Image.open(f"pictures/error_{cells}.png") as picture:
            assert picture.size == (960, 600)
            colors = picture.convert("RGB").resize((96, 60)).getcolors()
            assert colors is not None
            assert len(colors) > 10


@pytest.mark.parametrize(
    ("words", "message"),
    [(["--plot", "p"], "need --error"), (["--error", "--features"], "use only one of")],
)
def test_options_that_do_not_go_together(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", *words]) == 2
    assert message in capsys.readouterr().err
