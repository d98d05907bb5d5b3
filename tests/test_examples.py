"""The examples run as scripts, from any folder."""

from __future__ import annotations

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
    assert [path.stem for path in SCRIPTS] == ["01_hang", "02_wind_and_grab", "03_compare_solvers"]
    assert [path.stem for path in SCRIPTS if len(path.read_text(encoding="utf-8").splitlines()) >= 60] == []


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


def test_the_notebook_runs_and_shows_images(tmp_path: Path) -> None:
    run(tmp_path, "-c", EXECUTE, NOTEBOOK, tmp_path / "done.ipynb")
    cells = json.loads((tmp_path / "done.ipynb").read_text(encoding="utf-8"))["cells"]
    shown = [output.get("data", {}) for cell in cells for output in cell.get("outputs", [])]
    assert sum("image/png" in data for data in shown) == 2


def test_the_notebook_is_stored_without_outputs() -> None:
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    assert [cell["outputs"] for cell in cells if cell.get("outputs")] == []
