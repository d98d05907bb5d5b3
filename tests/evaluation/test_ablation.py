"""The cost of each feature, and the change without it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth import load_scene
from taichi_cloth.__main__ import main
from taichi_cloth.evaluation import ablation
from taichi_cloth.evaluation.ablation import ablate, ablated_scenes, horizon, motion, outlines
from taichi_cloth.evaluation.bench.scene_error import digest_of
from taichi_cloth.geometry.grid import triangles
from taichi_cloth.scene import scene_names
from taichi_cloth.scene.collider_schema import Ground
from taichi_cloth.scene.fabric_schema import VerletSprings
from taichi_cloth.scene.overrides import scene_without
from taichi_cloth.scene.schema import Cloth, Scene, Solver, Wind
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.console import commit_of, machine

pytestmark = pytest.mark.usefixtures("running", "serial_layout")

HANGING = Scene(cloth=Cloth(rows=8, columns=8, width=1.0, height=1.0), verlet=VerletSprings(shear=0.0, bend=0.0))


def test_each_feature_is_removed_once() -> None:
    scene = load_scene("curtain")
    assert scene.ground is not None
    variants = ablated_scenes(scene)
    assert list(variants) == [
        *("shear", "bend", "damping", "wind", "gusts", "lift", "spheres", "ground", "friction"),
    ]
    assert variants["wind"].wind is None
    assert variants["spheres"].spheres == ()
    assert variants["shear"].verlet.shear == 0
    assert variants["friction"].ground == replace(scene.ground, friction=0.0)
    assert {"tethers", "spring_damping", "bending"} <= set(ablated_scenes(load_scene("denim")))
    assert "strain_limit" in ablated_scenes(load_scene("net"))
    assert not ablated_scenes(load_scene("fast-ball"))["continuous"].spheres[0].continuous
    assert ablated_scenes(replace(HANGING, solver=Solver(damping=0.0))) == {}


def test_ground_far_below_changes_nothing_and_wind_does() -> None:
    scene = replace(HANGING, ground=Ground(height=-5.0, friction=0.0), wind=Wind(z=5.0, turbulence=0.0, lift=0.0))
    found = {row.feature: row for row in ablate(scene, 20).rows}
    assert list(found) == ["damping", "wind", "ground"]
    assert found["ground"].change == 0.0
    assert found["ground"].kinetic == 0.0
    assert found["wind"].change > 0.01
    assert found["wind"].kinetic < -0.1


def test_the_outline_is_the_area_inside_the_edge_from_above() -> None:
    x, z = np.meshgrid(np.linspace(0.0, 3.0, 7), np.linspace(0.0, 2.0, 5))
    flat = np.stack([x, 0.0 * x, z], axis=-1).reshape(1, -1, 3)
    hanging = flat[..., [0, 2, 1]]
    positions = np.concatenate([flat, hanging, flat * [1.0, 1.0, -0.5]])
    assert outlines(positions, triangles(5, 7)[0])[:, 0] == pytest.approx([6.0, 0.0, 3.0])


def compared_frames(scene: Scene, frames: int) -> int:
    with Simulation(scene) as simulation:
        return horizon(simulation, motion(simulation, frames)[0])


def test_the_horizon_ends_where_a_perturbation_has_grown() -> None:
    assert compared_frames(HANGING, 20) == 20
    assert 1 <= compared_frames(load_scene("denim", rows=16, columns=16, fabric="silk"), 120) < 120


def test_the_command_prints_and_writes_tables(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(
        "[cloth]\nrows = 6\ncolumns = 6\n[verlet]\nshear = 0.0\nbend = 0.0\n[wind]\nturbulence = 0.0\nlift = 0.0\n"
    )
    words = ["ablate", "small.toml", "--frames", "3", "--json", "o.json", "--markdown", "o.md"]
    assert main(words) == 0
    assert "small: " in capsys.readouterr().out
    text = Path("o.md").read_text(encoding="utf-8")
    run = read(Path("o.json"))
    ablation.write_markdown(Path("again.md"), run)
    assert Path("again.md").read_text(encoding="utf-8") == text
    assert run.commit == commit_of()
    assert " · ".join([*machine().values(), run.date, f"commit {run.commit[:8]}"]) in text
    assert "\n## small\n" in text
    assert [line.split("|")[1].strip() for line in text.splitlines() if line.startswith("| ")] == [
        *("without", "damping", "wind"),
    ]
    assert main(words) == 2
    Path("o.json").unlink()
    assert main(words) == 2  # the page exists
    assert main(["ablate", "curtian"]) == 2
    assert "curtain" in capsys.readouterr().err


def read(path: Path) -> ablation.Run:
    """Return a run that the command wrote."""
    words = json.loads(path.read_text(encoding="utf-8"))
    scenes = [
        ablation.Ablations(**one | {"rows": [ablation.Ablation(**row) for row in one["rows"]]})
        for one in words["scenes"]
    ]
    return ablation.Run(**words | {"scenes": scenes})


def test_the_page_matches_the_stored_run(tmp_path: Path) -> None:
    top = Path(__file__).parents[2]
    run = read(min((top / "benchmarks" / "results").glob("*/ablation.json")))
    ablation.write_markdown(tmp_path / "page.md", run)
    assert (top / "docs" / "scenes_rows.md").read_text(encoding="utf-8") == (tmp_path / "page.md").read_text("utf-8")
    assert {one.scene for one in run.scenes} == {*scene_names()} - {"walker", "bias", "skirt", "trellis"}, (
        "run: make validate"
    )
    digests = {one.scene: digest_of(load_scene(one.scene)) for one in run.scenes}
    assert {one.scene: one.digest for one in run.scenes} == digests, "a scene was changed; run: make validate"


def test_each_layer_has_its_own_outline() -> None:
    flat = np.array([[[x, 0.0, z] for z in (0.0, 1.0, 2.0) for x in (0.0, 1.0)]])  # 3 rows of 2: 2 m²
    layers = np.concatenate([flat, 2 * flat + [0.0, 1.0, 0.0]], axis=1)
    one = triangles(3, 2)[0]
    both = np.concatenate([one, one + 6])
    assert outlines(np.concatenate([layers, layers]), both, 2).tolist() == [[2.0, 8.0], [2.0, 8.0]]


def test_a_mesh_cloth_has_an_outline(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only two of its ten features are removed, because each variant is compiled."""
    few = {name: scene_without(load_scene("round"), [name]) for name in ("meshes", "ground")}
    monkeypatch.setattr("taichi_cloth.evaluation.ablation.ablated_scenes", lambda scene: few)
    found = {row.feature: row for row in ablate(load_scene("round"), 50).rows}
    assert found["ground"].change == 0.0
    assert found["meshes"].outline < 0.1
    assert found["meshes"].change > 0.01
