"""Errors on scenes: the reference and the simulation agree, errors are detected, and the page matches the run."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth import list_scenes, load_scene
from taichi_cloth.__main__ import main
from taichi_cloth.evaluation.bench import scene_error
from taichi_cloth.scene.collider_schema import Capsule, Ground, Sphere
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import SOLVER_NAMES, Camera, Cloth, Maps, Scene, Solver, Wind
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import UsageError

from .conftest import off_once

pytestmark = pytest.mark.usefixtures("running", "serial_layout")

HANGING = Scene(
    name="hanging",
    cloth=Cloth(rows=9, columns=9, width=1.0, height=1.0, pins=("top",), rotation=(-40.0, 0.0, 0.0)),
    fabric=Fabric(warp=500.0, weft=500.0, shear=0.0, bend_spring=0.0),
    solver=Solver("xpbd", 5, 12, damping=0.0),
)


def test_every_solver_is_measured_and_the_setting_of_the_scene_comes_first() -> None:
    found = scene_error.settings(HANGING)
    assert found[0] == ("xpbd", 5, 12)
    assert len(set(found)) == len(found)
    assert {name for name, _, _ in found} == set(SOLVER_NAMES)
    assert {name for name, _, _ in scene_error.settings(load_scene("round"))} == set(SOLVER_NAMES) - {"lines"}
    assert scene_error.settings(load_scene("tear"))[0][0] == "xpbd"
    assert {name for name, _, _ in scene_error.settings(load_scene("bias"))} == set(SOLVER_NAMES) - {"lines"}


def test_scenes_without_a_reference_solution_are_refused_and_listed() -> None:
    assert set(scene_error.scenes_without_reference()) == {"fold", "knot", "stack", "towel", "twist"}
    with pytest.raises(UsageError, match="fold has no independent reference: self-collision is not in the reference"):
        scene_error.settings(load_scene("fold"))


def test_more_accurate_settings_have_smaller_errors() -> None:
    truth = scene_error.solution(HANGING, 60)
    assert truth.positions.shape == (60, 81, 3)
    assert truth.uncertainty[0] < 1e-5
    rms = [
        scene_error.measure(HANGING, *s, truth).rms_error for s in (("xpbd", 5, 12), ("xpbd", 20, 12), ("rk4", 1, 1))
    ]
    assert rms[0] > 2 * rms[1] > 100 * rms[2] > 0


def test_an_edited_mesh_or_map_has_another_reference_solution(tmp_path: Path) -> None:
    mesh, weights = tmp_path / "flag.obj", tmp_path / "stiffness.csv"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n")
    weights.write_text("1\n1\n1\n1\n")
    cloth = Cloth(file="flag.obj", folder=str(tmp_path), pins=(0, 1))
    scene = Scene(cloth=cloth, maps=Maps(stiffness=weights.name, folder=str(tmp_path)))
    found = [scene_error.solution(scene, 3).positions]
    weights.write_text("1\n1\n0.5\n1\n")
    found.append(scene_error.solution(scene, 3).positions)
    mesh.write_text(mesh.read_text().replace("v 0 1 0", "v 0 0.8 0"))
    found.append(scene_error.solution(scene, 3).positions)
    assert (found[0] != found[1]).any()
    assert (found[1] != found[2]).any()


@pytest.mark.parametrize("frame", [0, 2, 4])
def test_errors_are_of_all_frames_and_particles(frame: int) -> None:
    """One particle is off in one frame, at the start, in the middle or at the end."""
    frames, error, side = 5, 0.01, 2.0
    truth = off_once(HANGING, frames, frame, error, 0.0, side)
    point = scene_error.measure(HANGING, "xpbd", 5, 12, truth)
    assert point.max_error == pytest.approx(error)
    assert point.rms_error == pytest.approx(error / np.sqrt(truth.positions[:, :, 0].size))


def test_the_largest_penetration_of_all_frames_is_measured() -> None:
    """The sheet starts in a ball that pushes it out: it is deepest in the first frame."""
    x, y, z = HANGING.cloth.center
    ball = Sphere(center=(x, y, z + 0.1), radius=0.3, margin=0.0, response="repulsion", friction=0.0)
    scene = replace(HANGING, spheres=(ball,))
    with Simulation(scene) as simulation:
        start, depths = simulation.positions(), []
        for _ in range(20):
            simulation.step()
            depths.append(simulation.metrics().penetration)
    positions = np.repeat(start[None], len(depths), axis=0)
    point = scene_error.measure(scene, "xpbd", 5, 12, scene_error.Solution(positions, positions, 1.0))
    assert point.max_penetration == max(depths) > 1.2 * depths[-1]
    shown = scene_error.lines(scene_error.SceneErrors("s", 20, 0.0, 0.0, [point]))
    assert (shown[0][-1], shown[1][-1]) == ("depth mm", f"{1e3 * max(depths):.1f}")


def test_a_mesh_cloth_has_a_reference_solution(tmp_path: Path) -> None:
    (tmp_path / "flap.obj").write_text("v 0 0 0\nv 2 0 0\nv 2 0 1\nv 0 0 1\nf 4 3 2 1\n")
    flap = replace(HANGING, cloth=Cloth(file="flap.obj", folder=str(tmp_path), pins=(0, 1)))
    truth = scene_error.solution(flap, 4)
    assert truth.positions.shape == (4, 4, 3)
    point = scene_error.measure(flap, "verlet", 5, 1, truth)
    assert 0 < 10 * truth.uncertainty[0] < point.rms_error <= point.max_error < 0.1


WINDY = replace(
    HANGING,
    name="windy",
    cloth=replace(HANGING.cloth, pins=("top-left",), rotation=(-85.0, 0.0, 0.0), center=(0.0, 0.6, 0.0)),
    fabric=Fabric(warp=300.0, weft=200.0, shear=100.0, bend_spring=2.0, bending_stiffness=1e-3, compression=0.5),
    solver=Solver("rk4", 40, 1, damping=1.0),
    wind=Wind(x=2.0, z=1.0, turbulence=1.0),
    spheres=(Sphere(center=(0.1, 0.4, 0.1), radius=0.15, margin=0.02, friction=0.4, oscillation=(0.0, 0.0, 0.05)),),
    ground=Ground(height=0.35, friction=0.3),
)
WRONG = {
    "wind from the other side": replace(WINDY, wind=Wind(x=-2.0, z=1.0, turbulence=1.0)),
    "no gusts": replace(WINDY, wind=Wind(x=2.0, z=1.0, turbulence=0.0)),
    "no lift": replace(WINDY, wind=Wind(x=2.0, z=1.0, turbulence=1.0, lift=0.0)),
    "no friction": replace(WINDY, spheres=(replace(WINDY.spheres[0], friction=0.0),)),
    "a static ball": replace(WINDY, spheres=(replace(WINDY.spheres[0], oscillation=(0.0, 0.0, 0.0)),)),
    "10 % more mass": replace(WINDY, cloth=replace(WINDY.cloth, area_density=0.22)),
    "33 % more stiffness": replace(WINDY, fabric=replace(WINDY.fabric, warp=400.0)),
    "twice the bending stiffness": replace(WINDY, fabric=replace(WINDY.fabric, bending_stiffness=2e-3)),
    "full resistance to compression": replace(WINDY, fabric=replace(WINDY.fabric, compression=1.0)),
    "less damping": replace(WINDY, solver=replace(WINDY.solver, damping=0.9)),
    "a margin 2 mm less": replace(WINDY, spheres=(replace(WINDY.spheres[0], margin=0.018),)),
}


@pytest.fixture(scope="module")
def windy() -> scene_error.Solution:
    return scene_error.solution(WINDY, 24)


def test_the_simulation_agrees_with_the_reference(windy: scene_error.Solution) -> None:
    """Two independent programs agree on wind, friction, bending, compression and damping."""
    assert windy.horizon > 15
    assert windy.uncertainty[0] < 2e-5
    assert scene_error.measure(WINDY, "rk4", 40, 1, windy).rms_error < 5e-5


NEEDLE = Capsule(
    center=(0.04, 0.3, 0.03),
    length=0.5,
    radius=0.02,
    margin=0.01,
    friction=0.4,
    rotation=(20.0, 0.0, 10.0),
    oscillation=(0.0, 0.1, 0.0),
    collide_with="triangles",
)
PRICKED = replace(
    HANGING,
    name="pricked",
    cloth=replace(HANGING.cloth, pins=("top", "bottom"), rotation=(-90.0, 0.0, 0.0), center=(0.0, 0.6, 0.0)),
    solver=Solver("rk4", 40, 1, damping=1.0),
    capsules=(NEEDLE,),
)


def test_the_simulation_agrees_with_the_reference_on_contact_with_triangles() -> None:
    truth = scene_error.solution(PRICKED, 24)
    assert truth.horizon > 10
    correct, without_friction, with_particles = (
        scene_error.measure(replace(PRICKED, capsules=(needle,)), "rk4", 40, 1, truth).rms_error
        for needle in (NEEDLE, replace(NEEDLE, friction=0.0), replace(NEEDLE, collide_with="particles"))
    )
    assert correct < 1e-4
    assert min(without_friction, with_particles) > 3 * correct


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_scene_has_a_large_error(what: str, windy: scene_error.Solution) -> None:
    assert scene_error.measure(WRONG[what], "rk4", 40, 1, windy).rms_error > 2e-4


def test_an_error_below_the_uncertainty_is_reported_as_a_bound() -> None:
    assert scene_error.share(0.00123, 1e-5) == "0.12%"
    assert scene_error.share(9e-6, 1e-5) == "< 0.001%"


def test_cloth_that_ends_in_nan_is_not_finite(monkeypatch: pytest.MonkeyPatch) -> None:
    """No figure of its error, strain and depth may look like that of accurate cloth."""
    truth = scene_error.Solution(np.zeros((2, 81, 3)), np.zeros((2, 81, 3)), 1.0)

    def broken(simulation: Simulation) -> float:
        x = simulation.positions()
        x[40] = np.nan
        monkeypatch.setattr(simulation, "positions", lambda: x)
        return 1.0

    monkeypatch.setattr(scene_error, "timed_frame", broken)
    point = scene_error.measure(HANGING, "xpbd", 5, 12, truth)
    shown = scene_error.lines(scene_error.SceneErrors("s", 2, 1e-5, 1e-5, [point]))
    assert shown[1][-4:] == ["not finite"] * 4
    assert scene_error.share(float("inf"), 1e-5) == "not finite"


def test_the_page_matches_the_stored_run() -> None:
    root = Path(__file__).parents[2]
    [stored] = root.glob("benchmarks/results/*/scene_errors.json")
    run = json.loads(stored.read_text(encoding="utf-8"))
    assert (root / "docs/scene_errors_rows.md").read_text(encoding="utf-8") == scene_error.page(run)
    assert run["left_out"] == scene_error.scenes_without_reference()
    assert {one["scene"] for one in run["scenes"]} == set(list_scenes()) - set(run["left_out"])
    digests = {one["scene"]: scene_error.digest_of(load_scene(one["scene"])) for one in run["scenes"]}
    assert {one["scene"]: one["digest"] for one in run["scenes"]} == digests, "a scene was changed; run: make errors"


def test_a_scene_that_another_run_measured_says_so() -> None:
    found = scene_error.SceneErrors("s", 2, 1e-5, 1e-5, [])
    assert "Measured" not in scene_error.heading(found)
    assert scene_error.heading(replace(found, measured="2026-02-01 · commit abc")).endswith(
        "at most. Measured 2026-02-01 · commit abc."
    )


def test_make_errors_measures_every_scene_with_a_reference() -> None:
    text = (Path(__file__).parents[2] / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ")
    scenes, left_out = (
        set(re.search(rf"^{name} := (.*)$", text, re.M)[1].split()) for name in ("SCENES", "NO_REFERENCE")
    )
    assert (scenes | {"round", "walker"}) - left_out == set(list_scenes()) - set(scene_error.scenes_without_reference())


def test_a_digest_changes_with_what_moves_the_cloth_only() -> None:
    digest = scene_error.digest_of(WINDY)
    assert {scene_error.digest_of(scene) for scene in WRONG.values()}.isdisjoint({digest})
    assert scene_error.digest_of(replace(WINDY, solver=replace(WINDY.solver, substeps=41))) != digest
    assert (
        scene_error.digest_of(replace(WINDY, name="other", title="other", camera=Camera(eye=(9.0, 9.0, 9.0)))) == digest
    )


def test_the_command_prints_and_writes_errors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(scene_error, "SETTINGS", {"explicit": ((1, 1),)})
    monkeypatch.setattr(scene_error, "FRAMES", 3)
    words = ["bench", "--error", "--scene", "drape15", "--csv", "o.csv", "--markdown", "o.md", "--json", "o.json"]
    assert main(words) == 0
    assert "drape15: Errors as shares of the longer side, over frames 1 to 3. " in capsys.readouterr().out
    assert "\n## drape15\n" in Path("o.md").read_text(encoding="utf-8")
    assert Path("o.md").read_text(encoding="utf-8") == scene_error.page(json.loads(Path("o.json").read_text()))
    rows = Path("o.csv").read_text(encoding="utf-8").splitlines()
    own = load_scene("drape15").solver
    assert [row.split(",")[:2] for row in rows[1:]] == [
        ["drape15", f"{own.name} {own.substeps}×{own.iterations}"],
        ["drape15", rows[2].split(",")[1]],
    ]
    assert np.isfinite([float(row.split(",")[4]) for row in rows[1:]]).all()
    assert main(words) == 2  # o.csv exists
    assert "o.csv" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--scene", "curtain"], "need --error"),
        (["--error", "--markdown", "o.md"], "needs --scene"),
        (["--error", "--scene", "curtain", "--all"], "not with --features, --filter, --all"),
        (["--error", "--scene", "curtian"], "curtain"),
    ],
)
def test_options_that_cannot_be_combined(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", *words]) == 2
    assert said in capsys.readouterr().err
