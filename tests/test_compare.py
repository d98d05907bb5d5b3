"""`compare` without a window: two runs of one scene, their images and measurements."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from taichi_cloth.__main__ import main
from taichi_cloth.evaluation.bench import scene_error
from taichi_cloth.evaluation.compare import explanations, overrides
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.render.image import RenderPlan
from taichi_cloth.render.split_view import SEAM, nearest_vertex_map, render_both
from taichi_cloth.scene.fabric_schema import Look
from taichi_cloth.scene.schema import Camera, Cloth, Forces, Scene
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.usefixtures("running", "serial_layout")

SMALL = ["--set", "rows=8,columns=9", "--size", "202x60", "--frames", "12", "--every", "4"]


def run(tmp_path: Path, *words: str) -> dict[str, Any]:
    assert main(["compare", "curtain", *SMALL, "--out", str(tmp_path / "o"), *words]) == 0
    report: dict[str, Any] = json.loads((tmp_path / "o" / "compare.json").read_text())
    return report


def image_halves(path: Path) -> tuple[np.ndarray, np.ndarray]:
    image = np.asarray(Image.open(path))
    assert image.shape == (60, 202, 3)
    assert (image[:, 100 : 100 + SEAM] == 255).all()
    return image[:, :100], image[:, 102:]


def test_figures_that_seem_to_contradict_each_other_are_explained() -> None:
    cancel, order = "residual and step error point in opposite directions", "the order of the sides can differ"

    def lines(a: list[float | None], b: list[float | None], rms: list[float | None]) -> list[bool]:
        text = "\n".join(explanations([a, b], rms))
        assert ("b: residual" in text) == (b[0] == 1e-3)
        return ["a: " + cancel in text, order in text]

    assert lines([3e-3, 3e-3, 1e-4], [2e-3, 1e-3, 1e-3], [0.3, 0.2]) == [False, False]
    assert lines([3e-3, 18e-3, 17e-3], [2e-3, 1e-3, 1e-3], [0.3, 0.2]) == [True, False]
    assert lines([3e-3, 3e-3, 1e-4], [2e-3, 1e-3, 1e-3], [0.1, 0.2]) == [False, True]
    assert lines([3e-3, 3e-3, 1e-4], [1e-3, 3e-3, 3e-3], [0.3, 0.2]) == [False, False]
    assert lines([3e-3, None, 3e-3], [2e-3, 1e-3, 1e-3], [None, 0.2]) == [False, False]
    assert lines([None, None, None], [2e-3, 1e-3, 1e-3], [0.1, 0.2]) == [False, False]


def test_two_solvers_side_by_side(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene_error, "FRAMES", 15)
    report = run(tmp_path, "--a", "solver=verlet,iterations=1", "--b", "solver=explicit")
    assert sorted(p.name for p in (tmp_path / "o").glob("*.png")) == [f"frame_0000{k}.png" for k in range(3)]
    assert report["a"]["method"].startswith("verlet 5×1")
    assert report["b"]["method"].startswith("explicit")
    assert len(report["a"]["physics_ms"]) == len(report["rms_distance"]) == 12
    errors = report["rms_error"]
    assert 0 < errors[1] < errors[0] / 10  # relative to the reference solution
    assert 0 < report["rms_distance"][-1] < 0.1
    [rough], [fine] = (report[side]["frame_errors"] for side in "ab")  # of the tenth of twelve frames
    assert rough["frame"] == fine["frame"] == 10
    assert 0 < fine["error"] < rough["error"] / 10
    assert fine["residual"] is None  # explicit does not iterate
    left, right = image_halves(tmp_path / "o" / "frame_00000.png")
    np.testing.assert_array_equal(left, right)  # both start in the same state
    left, right = image_halves(tmp_path / "o" / "frame_00002.png")
    assert (left != right).any()
    out = capsys.readouterr().out
    assert "RMS error" in out
    assert "reference solution: 12 frames of " in out
    assert "verlet has stiffnesses without unit" in out
    for name in ("error", "residual", "step_error"):
        assert f"{1e3 * rough[name]:.2g}" in out
    assert f"{report['rms_distance'][-1]:.2%} of the side" in out
    before = (tmp_path / "o" / "frame_00000.png").read_bytes()
    assert main(["compare", "curtain", *SMALL, "--out", str(tmp_path / "o"), "--b", "wind_z=9"]) == 2
    assert "--force" in capsys.readouterr().err
    assert (tmp_path / "o" / "frame_00000.png").read_bytes() == before


def test_iterations_of_a_solver_without_any_are_pointed_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report = run(tmp_path, "--a", "solver=explicit", "--b", "solver=explicit,iterations=5", "--no-errors")
    assert report["rms_distance"][-1] == 0
    assert "b: explicit does not iterate: iterations has no effect" in capsys.readouterr().out


def test_the_view_error_shows_the_last_error_that_was_measured(tmp_path: Path) -> None:
    sides = ("--a", "solver=verlet,iterations=1", "--b", "solver=explicit", "--view", "error")

    def is_colored(image: str) -> bool:
        """Whether the left half has pixels of the warm end of the scale; the cloth is gray before."""
        left = np.asarray(Image.open(tmp_path / image))[:, :80]
        red, blue = left[..., 0].astype(int), left[..., 2].astype(int)
        return bool(((red - blue) > 60).mean() > 0.01)

    run(tmp_path, *sides, "--frames", "16")
    assert [is_colored(f"o/frame_0000{k}.png") for k in range(4)] == [False, False, False, True]  # frames 0, 4, 8, 12
    report = run(tmp_path, *sides, "--frames", "16", "--no-errors", "--force")
    assert report["a"]["frame_errors"] == []
    assert not is_colored("o/frame_00003.png")


def test_without_a_reference_frames_have_no_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stiff = ("--set", "warp=1e9", "--set", "weft=1e9", "--set", "width=0.4", "--set", "area_density=0.001")
    report = run(tmp_path, *stiff, "--a", "iterations=2", "--b", "iterations=3")
    assert "no reference solution: it would take" in capsys.readouterr().out
    assert report["a"]["frame_errors"] == report["b"]["frame_errors"] == []
    assert report["rms_error"] == [None, None]


@pytest.mark.parametrize("sets_camera", [False, True])
def test_the_camera_follows_cloth_that_flies_sideways_unless_the_scene_sets_one(
    tmp_path: Path, sets_camera: bool
) -> None:
    cloth = Cloth(rows=5, columns=5, width=1.0, height=1.0, pins=())
    scene = Scene(cloth=cloth, forces=Forces(gravity=0.0), look=Look(color="#ff0000", second_color="#ff0000"))
    if sets_camera:
        scene = replace(scene, camera=Camera(eye=(0.0, 2.2, 1.6), target=(0.0, 2.2, 0.0)))
    plan = RenderPlan(tmp_path, 2, 202, 60)
    with Simulation(scene) as a, Simulation(scene) as b:

        def fly(frame: int) -> None:
            for simulation in (a, b):
                simulation.set_state(simulation.positions() + [0.6, 0.0, 0.0])

        render_both(a, b, plan, fly, errors=False)
    left, _ = image_halves(tmp_path / "frame_00001.png")
    red = (left[..., 0].astype(int) - left[..., 2] > 60).any(axis=0)
    assert red.any()
    assert red[-1] == sets_camera


def distances_of(tmp_path: Path, **other: object) -> list[float]:
    """Return the distance between a small curtain and another after each of six frames."""
    grid: dict[str, object] = {"rows": 8, "columns": 9}
    plan = RenderPlan(tmp_path, 6, 202, 60, every=5)
    with (
        Simulation(load_scene("curtain", **grid)) as a,
        Simulation(load_scene("curtain", **(grid | other))) as b,
    ):
        *runs, distances = render_both(a, b, plan, lambda k: None)
        assert [len(run.ms) for run in runs] == [6, 6]
        there = b.topology.flat[nearest_vertex_map(a, b)]
        np.testing.assert_allclose(there, a.topology.flat, atol=1e-6)
    return distances


def test_scenes_that_differ_in_look_only_have_distance_zero(tmp_path: Path) -> None:
    assert set(distances_of(tmp_path, look_color="#00ff00")) == {0.0}
    left, right = image_halves(tmp_path / "frame_00001.png")
    assert (left != right).any()


def test_grids_of_different_resolution_are_compared(tmp_path: Path) -> None:
    assert 0 < distances_of(tmp_path, rows=15, columns=17)[-1] < 0.05


def test_values_may_contain_commas() -> None:
    assert overrides(["solver=explicit, sphere_center=[1, 2, 3],wind.z=2,spheres[0].radius = 1, rows=3"], "--a") == {
        "solver": "explicit",
        "sphere_center": [1, 2, 3],
        "wind.z": 2,
        "spheres[0].radius": 1,
        "rows": 3,
    }


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ([], "both sides are the same scene"),
        (["--a", "solver=explict"], "did you mean 'explicit'?"),
        (["--a", "solver=spring"], "spring was renamed to explicit"),
        (["--a", "iteration=3"], "iterations"),
        (["--a", "iterations:2"], "--a: iterations:2: must be KEY=VALUE"),
        (["--b", "cloth.row=2"], "cloth.row: unknown key (did you mean 'cloth.rows'?)"),
        (["--b", "rows=9", "--size", "2x2"], "need a width of at least 4 pixels, not 2"),
    ],
)
def test_errors_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], line: str) -> None:
    assert main(["compare", "curtain", "--out", str(tmp_path / "o"), *words]) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
    assert not list(tmp_path.glob("o/*.png"))
