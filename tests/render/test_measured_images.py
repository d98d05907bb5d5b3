"""The error of frames in the report of a render, and in its images."""

from __future__ import annotations

import json
import re
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from taichi_cloth.__main__ import main
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.render.colors import rounded_up
from taichi_cloth.render.image import RenderReport
from taichi_cloth.simulation.copies import FrameErrorMeter
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.usefixtures("serial_layout", "running")

SMALL = {"rows": 6, "columns": 7}


def rendered(out: Path, *options: str) -> dict[int, dict[str, float]]:
    """Render a small scene. Return the measured errors by frame."""
    grid = [word for key, value in SMALL.items() for word in ("--set", f"{key}={value}")]
    command = ["render", "drape15", *grid, "--size", "96x64", "--samples", "1", "--out", str(out), *options]
    assert main(command) == 0
    report = json.loads((out / "run.json").read_text(encoding="utf-8"))
    return {entry["frame"]: entry["frame_error"] for entry in report["frames"] if "frame_error" in entry}


def test_every_tenth_frame_is_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = rendered(tmp_path / "a", "--frames", "25", "--every", "25", "--errors")
    assert list(found) == [9, 19]
    scene = load_scene("drape15", **SMALL)
    with Simulation(scene) as simulation, closing(FrameErrorMeter(scene)) as meter:
        simulation.step(9)
        assert found[9] == pytest.approx(meter.measure_frame(simulation).parts)
    median = np.median([parts["error"] for parts in found.values()])
    assert f"error of a frame: median {1e3 * median:.2g} mm" in capsys.readouterr().out


def test_a_run_too_short_to_be_measured_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert not rendered(tmp_path / "a", "--frames", "3", "--errors")
    assert "no error was measured: --errors measures every 10th frame" in capsys.readouterr().out


def test_the_median_leaves_out_errors_that_the_reference_cannot_tell() -> None:
    report = RenderReport("a", 1, "", {}, {}, [{}])
    assert report.median_error["error"] is None
    for error, converged in ((1.0, True), (90.0, False), (3.0, True), (2.0, True)):
        parts = {"error": error, "motion": 1.0, "residual": None, "step_error": error}
        report.frames.append({"frame_error": parts | {"reference_has_converged": converged}})
    assert report.median_error["error"] == 2.0


def test_images_do_not_depend_on_the_measurement(tmp_path: Path) -> None:
    assert rendered(tmp_path / "a", "--frames", "21", "--every", "10", "--errors")
    assert not rendered(tmp_path / "b", "--frames", "21", "--every", "10")
    for name in ("frame_00000.png", "frame_00002.png"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_in_the_view_error_every_image_shows_the_error_of_its_frame(tmp_path: Path) -> None:
    found = rendered(tmp_path / "a", "--frames", "5", "--every", "2", "--view", "error")
    assert list(found) == [1, 3]  # the frames that lead to the second and the third image
    assert rounded_up(found[3]["error"]) > 0
    first, last = (redness(Image.open(tmp_path / "a" / f"frame_0000{k}.png")) for k in (0, 2))
    assert last > first + 40  # nothing is measured before the first frame


def redness(image: Image.Image) -> float:
    """How much redder than blue the reddest pixels are."""
    pixels = np.asarray(image.convert("RGB")).astype(int)
    return float(np.percentile(pixels[..., 0] - pixels[..., 2], 99))


def test_a_video_in_the_view_error_shows_the_error_of_every_frame(tmp_path: Path) -> None:
    video = tmp_path / "a.webp"
    small = ["--set", "rows=6", "--set", "columns=7", "--size", "96x64", "--frames", "4", "--samples", "1"]
    assert main(["render", "drape15", "--video", str(video), "--view", "error", *small]) == 0
    with Image.open(video) as images:
        found = []
        for k in range(4):
            images.seek(k)
            found.append(redness(images))
    assert min(found[1:]) > found[0] + 40


def test_a_video_has_no_run_json_for_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["render", "drape15", "--video", str(tmp_path / "a.webp"), "--errors"]) == 2
    assert "--errors writes run.json, beside images: leave out --video" in capsys.readouterr().err


def test_errors_that_cannot_be_measured_are_refused_before_images_are_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "a"
    assert not rendered(out, "--frames", "2")
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    stiff = ["render", "drape15", "--out", str(out), "--force", "--solver", "xpbd", "--set", "fabric.warp=1e9"]
    for option in (["--errors"], ["--view", "error"]):
        assert main([*stiff, *option]) == 2
        error = capsys.readouterr().err
        assert re.search(r"errors of frames cannot be measured: its reference would need [\d,]+ substeps", error)
        assert f"without {' '.join(option)} the scene renders" in error
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
