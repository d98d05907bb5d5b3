"""The examples run as scripts, from any folder."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

TOP = Path(__file__).parents[1]
EXAMPLES = TOP / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
NOTEBOOK = EXAMPLES / "notebook.ipynb"

EXECUTE = """
import sys, nbclient, nbformat
notebook = nbformat.read(sys.argv[1], 4)
nbclient.NotebookClient(notebook, timeout=300).execute()
nbformat.write(notebook, sys.argv[2])
"""


def run(folder: Path, *words: str | Path) -> str:
    """Return the stdout of a program in `folder`; it must exit with 0."""
    path = os.pathsep.join(filter(None, [str(TOP), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONIOENCODING": "utf-8"}
    done = subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_examples_are_short() -> None:
    assert [path.stem for path in SCRIPTS] == [
        "01_hang",
        "02_wind_and_grab",
        "03_compare_solvers",
        "04_wind_sweep",
        "05_gripper_force",
        "06_scene_from_dict",
    ]
    assert [path.stem for path in SCRIPTS if len(path.read_text(encoding="utf-8").splitlines()) >= 50] == []


def test_the_sag_of_a_hanging_sheet_is_the_computed_one(tmp_path: Path) -> None:
    sag, computed = map(float, re.findall(r"([\d.]+) mm", run(tmp_path, EXAMPLES / "01_hang.py")))
    assert sag == pytest.approx(computed, rel=3e-3)


def test_wind_and_grab_writes_an_image(tmp_path: Path) -> None:
    run(tmp_path, EXAMPLES / "02_wind_and_grab.py")
    with Image.open(tmp_path / "wind_and_grab.png") as image:
        pixels = np.asarray(image).astype(int)
    assert pixels.shape == (360, 640, 3)
    green = pixels[..., 1] - pixels[..., 0] > 15  # the color of the cloth, lit and in shade; everything else is gray
    assert 0.02 < green.mean() < 0.3
    assert list(tmp_path.iterdir()) == [tmp_path / "wind_and_grab.png"]


def test_solvers_are_compared_with_their_errors(tmp_path: Path) -> None:
    lines = run(tmp_path, EXAMPLES / "03_compare_solvers.py").splitlines()[1:]
    errors = {line.split()[0]: float(line.split()[-1]) for line in lines}
    assert errors["explicit"] < errors["lines"] < errors["xpbd"] < errors["verlet"] < 2  # % of the side


def table_of(file: Path) -> np.ndarray:
    with file.open(encoding="utf-8", newline="") as lines:
        _, *rows = csv.reader(lines)
    return np.array(rows, float)


def is_plot(file: Path) -> bool:
    with Image.open(file) as image:
        return bool(np.asarray(image.convert("L")).std() > 10)


def test_the_wind_sweep_measures_the_force_of_the_air(tmp_path: Path) -> None:
    shown = run(tmp_path, EXAMPLES / "04_wind_sweep.py").splitlines()
    speeds, angles, pulls = table_of(tmp_path / "wind_sweep.csv").T
    assert len(shown) == len(speeds) == 12
    assert pulls[0] == pytest.approx(1.225 / 2 * speeds[0] ** 2, rel=0.02)  # ½·ρ·v² on 1 m², which still hangs
    assert (np.diff(angles) > 0).all()
    assert angles[-1] < 90
    assert pulls.argmax() in (2, 3, 4)
    assert is_plot(tmp_path / "wind_sweep.png")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["wind_sweep.csv", "wind_sweep.png"]


def test_the_gripper_holds_the_weight_at_the_end(tmp_path: Path) -> None:
    force, weight = map(float, re.findall(r"([\d.]+) N", run(tmp_path, EXAMPLES / "05_gripper_force.py")))
    assert weight == pytest.approx(0.2 * 9.81, rel=1e-3)
    assert force == pytest.approx(weight, rel=0.02)
    seconds, height, _, up, _ = table_of(tmp_path / "gripper_force.csv").T
    assert seconds[-1] == pytest.approx(7.0)
    assert up[seconds < 0.1].max() < 0.05 * weight  # most of the sheet still lies on the floor
    assert up[-60:].mean() == pytest.approx(weight, rel=5e-3)
    assert height[-1] == pytest.approx(1.9)
    assert is_plot(tmp_path / "gripper_force.png")
    assert is_plot(tmp_path / "gripper.png")


def test_without_matplotlib_there_is_a_table_and_no_plot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "missing").mkdir()
    (tmp_path / "missing" / "matplotlib.py").write_text("raise ImportError('not installed')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "missing"))
    assert run(tmp_path, EXAMPLES / "05_gripper_force.py").endswith("no matplotlib, no plot\n")
    assert len(table_of(tmp_path / "gripper_force.csv")) == 420
    assert not (tmp_path / "gripper_force.png").exists()


def test_a_scene_from_a_dict_holds_the_cloth_and_refuses_a_wrong_key(tmp_path: Path) -> None:
    shown = run(tmp_path, EXAMPLES / "06_scene_from_dict.py").splitlines()
    assert shown[0].startswith("xpbd 20×4")
    assert shown[1:] == ["scene: sphere: unknown key (did you mean 'spheres'?)"]
    with Image.open(tmp_path / "ring.png") as image:
        pixels = np.asarray(image).astype(int)
    silk = pixels[..., 0] - pixels[..., 1] > 40
    assert 0.1 < silk.mean() < 0.4
    assert silk[: len(silk) // 2].mean() > 0.1  # on the balls, not on the floor


def test_the_notebook_runs_and_shows_images(tmp_path: Path) -> None:
    run(tmp_path, "-c", EXECUTE, NOTEBOOK, tmp_path / "done.ipynb")
    cells = json.loads((tmp_path / "done.ipynb").read_text(encoding="utf-8"))["cells"]
    shown = [output.get("data", {}) for cell in cells for output in cell.get("outputs", [])]
    assert sum("image/png" in data for data in shown) == 2


def test_the_notebook_is_stored_without_outputs() -> None:
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    assert [cell["outputs"] for cell in cells if cell.get("outputs")] == []
