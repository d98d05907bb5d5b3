"""`compare` without a window: two runs of one scene, their pictures and what is measured of them."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from taichi_cloth.accuracy import gallery
from taichi_cloth.cli import main
from taichi_cloth.cli_compare import overrides
from taichi_cloth.scene import load_scene
from taichi_cloth.simulation import Simulation
from taichi_cloth.view.compare_frames import render_both
from taichi_cloth.view.frames import Plan
from taichi_cloth.view.sides import SEAM, partners

pytestmark = pytest.mark.usefixtures("running", "on_lists")

SMALL = ["--set", "rows=8,columns=9", "--size", "202x60", "--frames", "12", "--every", "4"]


def run(tmp_path: Path, *words: str) -> dict:
    assert main(["compare", "curtain", *SMALL, "--out", str(tmp_path / "o"), *words]) == 0
    return json.loads((tmp_path / "o" / "compare.json").read_text())


def halves(path: Path) -> tuple[np.ndarray, np.ndarray]:
    picture = np.asarray(Image.open(path))
    assert picture.shape == (60, 202, 3)
    assert (picture[:, 100 : 100 + SEAM] == 255).all()
    return picture[:, :100], picture[:, 102:]


def test_two_methods_side_by_side(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gallery, "FRAMES", 15)
    told = run(tmp_path, "--a", "solver=verlet,iterations=1", "--b", "solver=spring")
    assert sorted(p.name for p in (tmp_path / "o").glob("*.png")) == [f"frame_0000{k}.png" for k in range(3)]
    assert told["a"]["method"].startswith("verlet 5×1")
    assert told["b"]["method"].startswith("spring")
    assert len(told["a"]["physics_ms"]) == len(told["apart"]) == 12
    wrong = told["rms_error"]
    assert 0 < wrong[1] < wrong[0] / 10  # against the converged motion
    assert 0 < told["apart"][-1] < 0.1
    left, right = halves(tmp_path / "o" / "frame_00000.png")
    np.testing.assert_array_equal(left, right)  # both begin alike
    left, right = halves(tmp_path / "o" / "frame_00002.png")
    assert (left != right).any()
    out = capsys.readouterr().out
    assert "error rms" in out
    assert f"{told['apart'][-1]:.2%} of the side" in out
    before = (tmp_path / "o" / "frame_00000.png").read_bytes()
    assert main(["compare", "curtain", *SMALL, "--out", str(tmp_path / "o"), "--b", "wind_z=9"]) == 2
    assert "--force" in capsys.readouterr().err
    assert (tmp_path / "o" / "frame_00000.png").read_bytes() == before


def both(tmp_path: Path, **other: object) -> list[float]:
    """How far a small curtain and another are apart after each of six frames."""
    grid = {"rows": 8, "columns": 9}
    plan = Plan(tmp_path, 6, 202, 60, every=5)
    with (
        Simulation(load_scene("curtain", **grid)) as a,
        Simulation(load_scene("curtain", **(grid | other))) as b,
    ):
        *runs, distances = render_both(a, b, plan, lambda k: None)
        assert [len(run.ms) for run in runs] == [6, 6]
        there = b.topology.flat[partners(a, b)]
        np.testing.assert_allclose(there, a.topology.flat, atol=1e-6)
    return distances


def test_what_differs_in_its_look_alone_is_not_apart(tmp_path: Path) -> None:
    assert set(both(tmp_path, look_cloth="#00ff00")) == {0.0}
    left, right = halves(tmp_path / "frame_00001.png")
    assert (left != right).any()


def test_other_grids_are_compared_where_they_are_one_cloth(tmp_path: Path) -> None:
    assert 0 < both(tmp_path, rows=15, columns=17)[-1] < 0.05


def test_values_may_hold_commas() -> None:
    assert overrides(["solver=spring, sphere_center=[1, 2, 3],wind_z=2"]) == {
        "solver": "spring",
        "sphere_center": [1, 2, 3],
        "wind_z": 2,
    }


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ([], "both sides are the same scene"),
        (["--a", "solver=sprin"], "spring"),
        (["--a", "iteration=3"], "iterations"),
        (["--a", "iterations"], "KEY=VALUE"),
        (["--b", "rows=9", "--size", "2x2"], "do not fit into 2 pixels"),
    ],
)
def test_mistakes_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], line: str) -> None:
    assert main(["compare", "curtain", "--out", str(tmp_path / "o"), *words]) == 2
    told = capsys.readouterr().err
    assert line in told
    assert told.count("\n") == 1
    assert not list(tmp_path.glob("o/*.png"))
