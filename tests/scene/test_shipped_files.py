"""The shipped scenes: where they are stored, and what they contain."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from pathlib import Path

import pytest

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene import SceneError, presets, scene_names

Refuse = Callable[..., SceneError]


@pytest.mark.parametrize("name", ["curtain", "drape15", "table", *scene_names()])
def test_every_shipped_scene_loads_and_has_a_title(name: str) -> None:
    scene = load_scene(name)
    assert scene.name == name
    assert scene.title
    assert scene.title[:1].islower() or scene.title[:1].isdigit(), "titles are entries of a list"


def test_names_are_sorted() -> None:
    assert scene_names() == sorted(scene_names())


def test_the_curtain_has_the_settings_of_the_demo() -> None:
    scene = load_scene("curtain")
    assert (scene.cloth.rows, scene.cloth.columns, scene.cloth.pins) == (24, 30, ("top",))
    assert (scene.solver.name, scene.solver.substeps, scene.solver.iterations) == ("verlet", 5, 12)
    assert scene.spheres[0].margin == 0.15
    assert scene.spheres[0].oscillation != (0, 0, 0)
    assert scene.wind is not None
    assert scene.wind.turbulence > 0


def test_drape15_has_225_particles_and_five_iterations_per_frame() -> None:
    scene = load_scene("drape15")
    assert scene.cloth.rows * scene.cloth.columns == 225
    assert (scene.solver.substeps, scene.solver.iterations) == (1, 5)
    assert scene.cloth.pins == ("top-left", "top-right")


def test_the_table_has_a_free_sheet_above_boxes_and_spheres() -> None:
    scene = load_scene("table")
    assert scene.cloth.pins == ()
    assert scene.wind is None
    tops = [box.center[1] + box.size[1] / 2 for box in scene.boxes]
    tops += [sphere.center[1] + sphere.radius for sphere in scene.spheres]
    assert scene.cloth.center[1] > max(tops)
    assert scene.ground is not None


def test_an_unknown_name_is_refused_with_the_nearest_name(refuse: Refuse) -> None:
    error = refuse("curtian")
    assert error.hint == "curtain"
    assert ", ".join(scene_names()) in error.reason
    assert "no such scene" in str(refuse(""))


@pytest.mark.parametrize("path", ["curtain.toml", "./curtain", Path("curtain")])
def test_a_path_is_not_taken_for_a_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuse: Refuse, path: str | Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "No such file" in str(refuse(path))


def test_a_scene_has_the_name_of_its_file(tmp_path: Path) -> None:
    path = tmp_path / "my sheet.toml"
    path.write_text("seed = 2")
    assert load_scene(path) == load_scene(str(path))
    assert load_scene(path).name == "my sheet"


def test_an_installed_package_uses_its_own_scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "taichi_cloth"
    (package / "assets" / "scenes").mkdir(parents=True)
    (tmp_path / "assets" / "scenes").mkdir(parents=True)
    (package / "assets" / "scenes" / "inside.toml").write_text("")
    (tmp_path / "assets" / "scenes" / "outside.toml").write_text("")
    monkeypatch.setattr(presets, "_PACKAGE", package)
    assert scene_names() == ["inside"]
    (package / "assets" / "scenes" / "inside.toml").unlink()
    (package / "assets" / "scenes").rmdir()
    assert scene_names() == ["outside"]


MESHES = Path(__file__).parents[2] / "assets" / "meshes"
MAKE = runpy.run_path(str(MESHES / "make.py"))


@pytest.mark.parametrize("name", MAKE["MESHES"])
def test_the_script_writes_the_shipped_meshes(name: str) -> None:
    assert MAKE["obj"](name) == (MESHES / f"{name}.obj").read_text(encoding="utf-8")
