"""Scenes whose cloth is a mesh file: what they may say beside it, and their pins."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.mesh.from_scene import topology_of
from taichi_cloth.scene import SceneError, check_scene, load_scene
from taichi_cloth.scene.model import GRID_KEYS, Cloth, Scene

Write = Callable[[str | bytes], Path]
Refuse = Callable[..., SceneError]

TRIANGLES = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\ng hem\nf 1 2 3\ng top\nf 1 3 4\n"
FILE = "[cloth]\nfile = 'flag.obj'\n"


@pytest.fixture
def beside(write: Write) -> Write:
    """Writes a scene with `flag.obj` beside it."""

    def to_file(text: str | bytes) -> Path:
        path = write(text)
        (path.parent / "flag.obj").write_text(TRIANGLES)
        return path

    return to_file


def pinned(path: Path) -> list[int]:
    scene = load_scene(path)
    return np.flatnonzero(topology_of(scene, "springs").pinned).tolist()


def test_a_file_stands_for_the_grid(beside: Write) -> None:
    scene = load_scene(beside(FILE + "scale = 2.0\nrotation = [90.0, 0.0, 0.0]\n"))
    assert (scene.cloth.pins, topology_of(scene, "springs").pinned.any()) == ((), False)
    places = topology_of(scene, "springs").start
    assert places.round(6).tolist() == [[-1, 2.2, -1], [1, 2.2, -1], [1, 2.2, 1], [-1, 2.2, 1]]


@pytest.mark.parametrize("key", GRID_KEYS)
def test_keys_of_a_grid_beside_a_file(beside: Write, refuse: Refuse, key: str) -> None:
    value = {"lumping": "'area'", "weight_at": "'top-left'"}.get(key, 2)
    error = refuse(beside(FILE + f"{key} = {value}\n"))
    assert (error.key, error.reason.split(",")[0]) == (f"cloth.{key}", "is for a sheet")
    if isinstance(value, int):
        with pytest.raises(SceneError, match=f"cloth.{key}: is for a sheet"):
            check_scene(Scene(cloth=Cloth(file="round", **{key: 3})))


def test_a_scene_made_in_python_needs_no_more_than_the_file() -> None:
    assert check_scene(Scene(cloth=Cloth(file="round"))).cloth.pins == ()


@pytest.mark.parametrize(
    ("pins", "held"),
    [
        ("[]", []),
        ("[3]", [3]),
        ("['group:hem']", [0, 1, 2]),
        ("['group:top', 1]", [0, 1, 2, 3]),
        ("['region:left']", [0, 3]),
    ],
)
def test_pins_of_a_file(beside: Write, pins: str, held: list[int]) -> None:
    region = "[[regions]]\nname = 'left'\nlow = [-9, -9, -9]\nhigh = [0, 9, 9]\n"
    assert pinned(beside(FILE + f"pins = {pins}\n" + region)) == held


def test_regions_of_a_sheet_and_of_a_grip(write: Write) -> None:
    region = "[[regions]]\nname = 'a'\nlow = [-9, 0.49, -9]\nhigh = [-0.2, 9, 9]\n"
    sheet = "[cloth]\nrows = 3\ncolumns = 5\nwidth = 1\nheight = 1\ncenter = [0, 0, 0]\n"
    assert pinned(write(sheet + "pins = ['region:a', 'bottom-right']\n" + region)) == [0, 1, 14]
    assert pinned(write(sheet + "pins = []\n" + region + "[[grips]]\npins = ['region:a']\n")) == [0, 1]


@pytest.mark.parametrize(
    ("text", "key", "reason", "hint"),
    [
        (FILE + "pins = [4]", "cloth.pins[0]", "4 is no particle: indices run from 0 to 3", ""),
        (FILE + "pins = ['top']", "cloth.pins[0]", "'top' is of a sheet, and flag.obj has no rows", ""),
        (FILE + "pins = ['group:tp']", "cloth.pins[0]", "flag.obj has no group 'tp'; it has hem, top", "top"),
        ("[cloth]\npins = ['group:a']", "cloth.pins[0]", "'group:a' is of a mesh file, and the cloth is a sheet", ""),
        ("[cloth]\npins = ['region:a']", "cloth.pins[0]", "there is no region 'a' in [[regions]]; there is none", ""),
        (
            "[cloth]\npins = ['region:a']\n[[regions]]\nname = 'a'",
            "cloth.pins[0]",
            "no particle starts in region 'a': the cloth is from [-2.175, 0.475, 0] to [2.175, 3.925, 0] m",
            "",
        ),
        (
            "[[regions]]\nname = 'a'\n[[regions]]\nname = 'a'",
            "regions[1].name",
            "another region is called 'a', too",
            "",
        ),
        ("[cloth]\nfile = 'rund'", "cloth.file", "'rund' is no shipped mesh", "round"),
        ("[cloth]\nfile = 'none.obj'", "cloth.file", "cannot be read: No such file or directory", ""),
        (FILE + "scale = 1e-4", "cloth.file", "the cloth would be 0.0001 m large, not 0.001 to 1000 m", ""),
        (FILE + "[look]\npole = true", "look.pole", "is drawn along the top edge of a sheet", ""),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    beside: Write, refuse: Refuse, text: str, key: str, reason: str, hint: str
) -> None:
    error = refuse(beside(text))
    assert (error.key, error.hint) == (key, hint)
    assert reason in error.reason
    assert str(error).isprintable()
