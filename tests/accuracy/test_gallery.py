"""Errors on a scene: the truth is true, and what is nearer to it is said to be."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth import cli, load_scene
from taichi_cloth.accuracy import gallery
from taichi_cloth.errors import WrongUse
from taichi_cloth.scene.model import SOLVER_NAMES, Cloth, Fabric, Scene, Solver

pytestmark = pytest.mark.usefixtures("running", "on_lists")

HANGING = Scene(
    name="hanging",
    cloth=Cloth(rows=9, columns=9, width=1.0, height=1.0, pins=("top",), rotation=(-40.0, 0.0, 0.0)),
    fabric=Fabric(warp=500.0, weft=500.0, shear=0.0, bend=0.0),
    solver=Solver("xpbd", 5, 12, damping=0.0),
)


def test_every_solver_is_measured_and_the_scenes_own_setting_comes_first() -> None:
    found = gallery.settings(HANGING)
    assert found[0] == ("xpbd", 5, 12)
    assert len(set(found)) == len(found)
    assert {name for name, _, _ in found} == set(SOLVER_NAMES)
    assert {name for name, _, _ in gallery.settings(load_scene("round"))} == set(SOLVER_NAMES) - {"lines"}
    with pytest.raises(WrongUse, match="tear: a cloth that tears has no motion"):
        gallery.settings(load_scene("tear"))


def test_nearer_methods_have_smaller_errors() -> None:
    truth, finer, doubt = gallery.converged(HANGING)
    assert truth.shape == (gallery.FRAMES, 81, 3)
    assert finer == gallery.FINEST
    assert doubt < 1e-4
    rms = [gallery.measure(HANGING, *s, truth).rms_error for s in (("xpbd", 5, 12), ("xpbd", 20, 12), ("spring", 1, 1))]
    assert rms[0] > 2 * rms[1] > 20 * rms[2] > 0


def test_a_mesh_has_a_truth_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gallery, "FRAMES", 4)
    (tmp_path / "flap.obj").write_text("v 0 0 0\nv 2 0 0\nv 2 0 1\nv 0 0 1\nf 4 3 2 1\n")
    flap = replace(HANGING, cloth=Cloth(file="flap.obj", folder=str(tmp_path), pins=(0, 1)))
    truth, _, doubt = gallery.converged(flap)
    assert truth.shape == (4, 4, 3)
    away = gallery.measure(flap, "verlet", 5, 1, truth)
    assert 0 < 10 * doubt < away.rms_error <= away.max_error < 0.1


def test_a_wrong_scene_is_wrong() -> None:
    """The rows measure the program: with a quarter more stiffness the cloth moves otherwise."""
    truth, _, _ = gallery.converged(HANGING)
    stiffer = replace(HANGING, fabric=replace(HANGING.fabric, warp=625.0))
    assert gallery.measure(stiffer, "spring", 1, 1, truth).rms_error > 1e-3


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(gallery, "SETTINGS", {"spring": ((1, 1),)})
    monkeypatch.setattr(gallery, "FRAMES", 3)
    words = ["bench", "--error", "--scene", "drape15", "--csv", "o.csv", "--markdown", "o.md"]
    assert cli.main(words) == 0
    assert "drape15: Up to frame 3, " in capsys.readouterr().out
    assert "\n## drape15\n" in Path("o.md").read_text(encoding="utf-8")
    rows = Path("o.csv").read_text(encoding="utf-8").splitlines()
    own = load_scene("drape15").solver
    assert [row.split(",")[:2] for row in rows[1:]] == [
        ["drape15", f"{own.name} {own.substeps}×{own.iterations}"],
        ["drape15", rows[2].split(",")[1]],
    ]
    assert np.isfinite([float(row.split(",")[4]) for row in rows[1:]]).all()
    assert cli.main(words) == 2  # o.csv is there
    assert "o.csv" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--scene", "curtain"], "go with --error"),
        (["--error", "--markdown", "o.md"], "goes with --scene"),
        (["--error", "--scene", "curtain", "--full"], "not with --stages, --only, --full"),
        (["--error", "--scene", "curtian"], "curtain"),
    ],
)
def test_words_that_do_not_go_together(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", *words]) == 2
    assert said in capsys.readouterr().err
