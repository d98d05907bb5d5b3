"""Scenes whose cloth is a mesh file: the keys they may set, and their pins."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taichi_cloth.geometry.cloth_builder import build_topology
from taichi_cloth.geometry.scene_loader import check_scene, files_of, load_scene
from taichi_cloth.scene.collider_schema import Mesh
from taichi_cloth.scene.schema import GRID_KEYS, Cloth, Maps, Scene
from taichi_cloth.system.errors import SceneError

Write = Callable[[str | bytes], Path]
Refuse = Callable[..., SceneError]

TRIANGLES = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\ng hem\nf 1 2 3\ng top\nf 1 3 4\n"
FILE = "[cloth]\nfile = 'flag.obj'\n"


@pytest.fixture
def write_with_mesh(write: Write) -> Write:
    """Return a function that writes a scene, with `flag.obj` in the same folder."""

    def to_file(text: str | bytes) -> Path:
        path = write(text)
        (path.parent / "flag.obj").write_text(TRIANGLES)
        return path

    return to_file


def pinned(path: Path) -> list[int]:
    scene = load_scene(path)
    return np.flatnonzero(build_topology(scene, "verlet").pinned).tolist()


def test_a_mesh_file_replaces_the_grid(write_with_mesh: Write) -> None:
    scene = load_scene(write_with_mesh(FILE + "scale = 2.0\nrotation = [90.0, 0.0, 0.0]\n"))
    assert (scene.cloth.pins, build_topology(scene, "verlet").pinned.any()) == ((), False)
    positions = build_topology(scene, "verlet").start
    assert positions.round(6).tolist() == [[-1, 2.2, -1], [1, 2.2, -1], [1, 2.2, 1], [-1, 2.2, 1]]


@pytest.mark.parametrize("key", GRID_KEYS)
def test_grid_keys_with_a_mesh_file_are_refused(write_with_mesh: Write, refuse: Refuse, key: str) -> None:
    value = {"mass_lumping": "'area'", "corner_mass_at": "'top-left'"}.get(key, 2)
    error = refuse(write_with_mesh(FILE + f"{key} = {value}\n"))
    assert (error.key, error.reason.split(",")[0]) == (f"cloth.{key}", "applies to grids only")
    if isinstance(value, int):
        keys: dict[str, Any] = {key: 3}
        with pytest.raises(SceneError, match=f"cloth.{key}: applies to grids only"):
            check_scene(Scene(cloth=Cloth(file="round", **keys)))


def test_a_scene_made_in_python_needs_only_the_mesh_file() -> None:
    assert check_scene(Scene(cloth=Cloth(file="round"))).cloth.pins == ()


@pytest.mark.parametrize(
    ("pins", "pinned_particles"),
    [
        ("[]", []),
        ("[3]", [3]),
        ("['group:hem']", [0, 1, 2]),
        ("['group:top', 1]", [0, 1, 2, 3]),
        ("['region:left']", [0, 3]),
    ],
)
def test_pins_of_a_mesh_file(write_with_mesh: Write, pins: str, pinned_particles: list[int]) -> None:
    region = "[[regions]]\nname = 'left'\nmin = [-9, -9, -9]\nmax = [0, 9, 9]\n"
    assert pinned(write_with_mesh(FILE + f"pins = {pins}\n" + region)) == pinned_particles


def test_regions_pin_a_sheet_and_an_attachment(write: Write) -> None:
    region = "[[regions]]\nname = 'a'\nmin = [-9, 0.49, -9]\nmax = [-0.2, 9, 9]\n"
    sheet = "[cloth]\nrows = 3\ncolumns = 5\nwidth = 1\nheight = 1\ncenter = [0, 0, 0]\n"
    assert pinned(write(sheet + "pins = ['region:a', 'bottom-right']\n" + region)) == [0, 1, 14]
    assert pinned(write(sheet + "pins = []\n" + region + "[[attachments]]\npins = ['region:a']\n")) == [0, 1]


@pytest.mark.parametrize(
    ("text", "key", "reason", "hint"),
    [
        (FILE + "pins = [4]", "cloth.pins[0]", "4 is not a particle: indices run from 0 to 3", ""),
        (FILE + "pins = ['top']", "cloth.pins[0]", "'top' needs a sheet, but the cloth is flag.obj", ""),
        (FILE + "pins = ['group:tp']", "cloth.pins[0]", "flag.obj has no group 'tp'; it has hem, top", "top"),
        ("[cloth]\npins = ['group:a']", "cloth.pins[0]", "'group:a' needs a mesh file, but the cloth is a sheet", ""),
        ("[cloth]\npins = ['region:a']", "cloth.pins[0]", "[[regions]] has no region 'a'; it has none", ""),
        (
            "[cloth]\npins = ['region:a']\n[[regions]]\nname = 'a'",
            "cloth.pins[0]",
            "no particle starts in region 'a': the cloth extends from [-2.175, 0.475, 0] to [2.175, 3.925, 0] m",
            "",
        ),
        (
            "[[regions]]\nname = 'a'\n[[regions]]\nname = 'a'",
            "regions[1].name",
            "'a' is the name of another region",
            "",
        ),
        (
            "[cloth]\npins = ['region:a']\n[[regions]]\nname = 'a'\nmin = [0, 2, 0]\nmax = [1, 1, 1]",
            "cloth.pins[0]",
            "the min of region 'a' exceeds its max: (0.0, 2.0, 0.0), (1.0, 1.0, 1.0) m",
            "",
        ),
        (
            "[[boxes]]\nname = 'a'\n[[spheres]]\nname = 'a'\n[[spheres]]\n[[spheres]]",
            "boxes[0].name",
            "'a' is the name of another collider",
            "",
        ),
        ("[cloth]\nfile = 'rund'", "cloth.file", "'rund' is not a shipped mesh", "round"),
        ("[cloth]\nfile = 'none.obj'", "cloth.file", "cannot be read: No such file or directory", ""),
        (FILE + "scale = 1e-4", "cloth.file", "the cloth would be 0.0001 m in size, not 0.001 to 1000 m", ""),
        (FILE + "[look]\npole = true", "look.pole", "is drawn along the top edge of a grid", ""),
    ],
)
def test_an_invalid_scene_is_refused_in_one_line(
    write_with_mesh: Write, refuse: Refuse, text: str, key: str, reason: str, hint: str
) -> None:
    error = refuse(write_with_mesh(text))
    assert (error.key, error.hint) == (key, hint)
    assert reason in error.reason
    assert str(error).isprintable()


@pytest.mark.parametrize("scene", [Scene(cloth=Cloth(file="disk")), Scene(meshes=(Mesh(file="disk.stl"),))])
def test_the_name_of_a_mesh_is_checked_in_a_scene_made_in_python_too(scene: Scene) -> None:
    with pytest.raises(SceneError, match=r"file: 'disk(\.stl)?' is not a shipped mesh; use bust, disc, knot, round"):
        check_scene(scene)


def test_the_files_of_a_scene_are_its_meshes_clips_and_maps(tmp_path: Path) -> None:
    for name in ("walk_2.obj", "walk_1.obj", "run_1.obj"):
        (tmp_path / name).touch()
    here = str(tmp_path)
    walker = Mesh(file="body.obj", folder=here, clip="walk_*.obj")
    maps = Maps(pin="pins.png", stiffness=(0.5, 1.0), folder=here)
    scene = Scene(cloth=Cloth(file="flag.obj", folder=here), meshes=(Mesh(), walker), maps=maps)
    names = ["flag.obj", "bust.obj", "body.obj", "walk_1.obj", "walk_2.obj", "pins.png"]
    assert [path.name for path in files_of(scene)] == names
    assert files_of(scene)[1].exists()
    assert {path.parent for path in files_of(scene)[2:]} == {tmp_path}
    assert files_of(Scene()) == files_of(Scene(maps=Maps())) == []
