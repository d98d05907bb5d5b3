"""Errors on a scene: the reference and the program agree, what is wrong is seen, and the page is that of the run."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth import cli, load_scene, scene_names
from taichi_cloth.accuracy import gallery
from taichi_cloth.errors import WrongUse
from taichi_cloth.scene.model import SOLVER_NAMES, Capsule, Cloth, Fabric, Ground, Scene, Solver, Sphere, Wind

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
    assert gallery.settings(load_scene("tear"))[0][0] == "xpbd"


def test_scenes_without_a_reference_are_refused_and_listed_with_the_reason() -> None:
    assert set(gallery.left_out()) == {"fold", "stack", "twist"}
    with pytest.raises(WrongUse, match="fold has no independent reference: self-collision is not in the reference"):
        gallery.settings(load_scene("fold"))


def test_nearer_methods_have_smaller_errors() -> None:
    truth = gallery.solution(HANGING, 60)
    assert truth.places.shape == (60, 81, 3)
    assert truth.uncertainty[0] < 1e-5
    rms = [gallery.measure(HANGING, *s, truth).rms_error for s in (("xpbd", 5, 12), ("xpbd", 20, 12), ("rk4", 1, 1))]
    assert rms[0] > 2 * rms[1] > 100 * rms[2] > 0


def test_a_mesh_has_a_reference_too(tmp_path: Path) -> None:
    (tmp_path / "flap.obj").write_text("v 0 0 0\nv 2 0 0\nv 2 0 1\nv 0 0 1\nf 4 3 2 1\n")
    flap = replace(HANGING, cloth=Cloth(file="flap.obj", folder=str(tmp_path), pins=(0, 1)))
    truth = gallery.solution(flap, 4)
    assert truth.places.shape == (4, 4, 3)
    away = gallery.measure(flap, "verlet", 5, 1, truth)
    assert 0 < 10 * truth.uncertainty[0] < away.rms_error <= away.max_error < 0.1


WINDY = replace(
    HANGING,
    name="windy",
    cloth=replace(HANGING.cloth, pins=("top-left",), rotation=(-85.0, 0.0, 0.0), center=(0.0, 0.6, 0.0)),
    fabric=Fabric(warp=300.0, weft=200.0, shear=100.0, bend=2.0, bending=1e-3, compression=0.5),
    solver=Solver("rk4", 40, 1, damping=1.0),
    wind=Wind(x=2.0, z=1.0, turbulence=1.0),
    spheres=(Sphere(center=(0.1, 0.4, 0.1), radius=0.15, margin=0.02, friction=0.4, sway=(0.0, 0.0, 0.05)),),
    ground=Ground(height=0.35, friction=0.3),
)
WRONG = {
    "the wind blows from the other side": replace(WINDY, wind=Wind(x=-2.0, z=1.0, turbulence=1.0)),
    "no gusts": replace(WINDY, wind=Wind(x=2.0, z=1.0, turbulence=0.0)),
    "no lift": replace(WINDY, wind=Wind(x=2.0, z=1.0, turbulence=1.0, lift=0.0)),
    "no friction": replace(WINDY, spheres=(replace(WINDY.spheres[0], friction=0.0),)),
    "a ball that stands still": replace(WINDY, spheres=(replace(WINDY.spheres[0], sway=(0.0, 0.0, 0.0)),)),
    "a tenth more mass": replace(WINDY, cloth=replace(WINDY.cloth, area_density=0.22)),
    "a third more stiffness": replace(WINDY, fabric=replace(WINDY.fabric, warp=400.0)),
    "twice the bending": replace(WINDY, fabric=replace(WINDY.fabric, bending=2e-3)),
    "threads that push fully": replace(WINDY, fabric=replace(WINDY.fabric, compression=1.0)),
    "less damping": replace(WINDY, solver=replace(WINDY.solver, damping=0.9)),
    "a margin 2 mm less": replace(WINDY, spheres=(replace(WINDY.spheres[0], margin=0.018),)),
}


@pytest.fixture(scope="module")
def windy() -> gallery.Solution:
    return gallery.solution(WINDY, 24)


def test_the_program_has_the_forces_and_contact_of_the_reference(windy: gallery.Solution) -> None:
    """Two codes that share nothing agree on wind, friction, bending, slack threads and damping."""
    assert windy.horizon > 15
    assert windy.uncertainty[0] < 2e-5
    assert gallery.measure(WINDY, "rk4", 40, 1, windy).rms_error < 5e-5


NEEDLE = Capsule(
    center=(0.04, 0.3, 0.03), length=0.5, radius=0.02, margin=0.01, friction=0.4, rotation=(20.0, 0.0, 10.0),
    sway=(0.0, 0.1, 0.0), against="triangles",
)  # fmt: skip
PRICKED = replace(
    HANGING,
    name="pricked",
    cloth=replace(HANGING.cloth, pins=("top", "bottom"), rotation=(-90.0, 0.0, 0.0), center=(0.0, 0.6, 0.0)),
    solver=Solver("rk4", 40, 1, damping=1.0),
    capsules=(NEEDLE,),
)


def test_the_program_has_the_contact_with_triangles_of_the_reference() -> None:
    truth = gallery.solution(PRICKED, 24)
    assert truth.horizon > 10
    right, slippery, blunt = (
        gallery.measure(replace(PRICKED, capsules=(needle,)), "rk4", 40, 1, truth).rms_error
        for needle in (NEEDLE, replace(NEEDLE, friction=0.0), replace(NEEDLE, against="particles"))
    )
    assert right < 1e-4
    assert min(slippery, blunt) > 3 * right


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_scene_is_wrong(what: str, windy: gallery.Solution) -> None:
    assert gallery.measure(WRONG[what], "rk4", 40, 1, windy).rms_error > 2e-4


def test_an_error_below_the_uncertainty_is_not_told_as_a_number() -> None:
    assert gallery.share(0.00123, 1e-5) == "0.12%"
    assert gallery.share(9e-6, 1e-5) == "< 0.001%"


def test_the_page_of_the_scenes_is_that_of_the_stored_run() -> None:
    root = Path(__file__).parents[2]
    [stored] = root.glob("benchmarks/results/*/scene_errors.json")
    told = json.loads(stored.read_text(encoding="utf-8"))
    assert (root / "docs/scene_errors.md").read_text(encoding="utf-8") == gallery.page(told)
    assert told["left_out"] == gallery.left_out()
    assert {one["scene"] for one in told["scenes"]} == set(scene_names()) - set(told["left_out"])


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(gallery, "SETTINGS", {"spring": ((1, 1),)})
    monkeypatch.setattr(gallery, "FRAMES", 3)
    words = ["bench", "--error", "--scene", "drape15", "--csv", "o.csv", "--markdown", "o.md", "--json", "o.json"]
    assert cli.main(words) == 0
    assert "drape15: Of the longer side, over frames 1 to 3. " in capsys.readouterr().out
    assert "\n## drape15\n" in Path("o.md").read_text(encoding="utf-8")
    assert Path("o.md").read_text(encoding="utf-8") == gallery.page(json.loads(Path("o.json").read_text()))
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
