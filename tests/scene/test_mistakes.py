"""All mistakes of a scene at once, and nothing that follows from one of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from taichi_cloth.geometry.scene_loader import load_scene, load_with_mistakes
from taichi_cloth.scene import scene_names
from taichi_cloth.system.errors import MAX_NOTES, Mistakes, SceneError

Write = Callable[[str | bytes], Path]


def lines_of(path: Path) -> list[str]:
    """The mistakes of a file, without its name."""
    _, mistakes = load_with_mistakes(path)
    return [str(mistake).removeprefix(f"{path}: ") for mistake in mistakes]


BAD = """
tilte = "x"
[cloth]
row = 40
columns = 1
layers = 2
[wnd]
zz = 1
[[sphere]]
radius = "big"
[boxs]
size = 1
[tethers]
slack = 0.5
[solver]
name = "varlet"
iterations = 0
[[spheres]]
radius = -1
response = "reflection"
continuous = true
[[spheres]]
raduis = 2
[planes]
[[meshes]]
file = "bsut"
[[meshes]]
file = "none.obj"
[maps]
pin = "none"
[look]
check = "#ffffff"
"""


def test_every_element_of_a_list_has_a_line(write: Write) -> None:
    text = """[cloth]
    pins = ["tpo", 3, true]
    center = [0, "a", nan]
    [[spheres]]
    keyframes = [[0, 0, 0, 0], [1, "b", 0, "c"], [2, 0]]
    """
    keys = [line.partition(": ")[0] for line in lines_of(write(text))]
    assert keys == [
        "cloth.pins[0]",
        "cloth.pins[2]",
        "cloth.center[1]",
        "cloth.center[2]",
        "spheres[0].keyframes[1][1]",
        "spheres[0].keyframes[1][3]",
        "spheres[0].keyframes[2]",
    ]


def test_every_mistake_has_a_line(write: Write) -> None:
    found = lines_of(write(BAD))
    starts = [
        "tilte: unknown key (did you mean 'title'?)",
        "wnd: unknown key (did you mean 'wind'?)",
        "wnd.zz: unknown key (did you mean 'z'?)",
        "sphere: unknown key (did you mean 'spheres'?)",
        "sphere[0].radius: must be a number, got 'big'",
        "boxs: unknown key (did you mean 'boxes'?)",
        "cloth.row: unknown key (did you mean 'rows'?)",
        "cloth.columns: 1 is out of range: 2 to 2048",
        "solver.name: 'varlet' is not one of: ",
        "solver.iterations: 0 is out of range: 1 to 1000",
        "tethers.slack: 0.5 is out of range: 1 to 2",
        "spheres[0].radius: -1 is out of range: above 0 to 1000 m",
        "spheres[1].raduis: unknown key (did you mean 'radius'?)",
        "planes: write [[planes]] with two brackets",
        "meshes[0].file: 'bsut' is not a shipped mesh; use ",
        "look.check: was renamed to second_color",
        "tethers: require a single layer, but cloth.layers is 2",
        "spheres[0].continuous: requires projection, got reflection",
        "meshes[1].file: ",
    ]
    assert len(found) == len(starts)
    for start in starts:
        assert any(line.startswith(start) for line in found), start


def test_files_are_read_although_keys_are_wrong(write: Write) -> None:
    path = write('[maps]\npin = "none"\nstiffness = "gone.csv"\nmax_distances = 1\n[[meshes]]\nfile = "gone.obj"')
    keys = [line.split(":")[0] for line in lines_of(path)]
    assert keys == ["maps.max_distances", "meshes[0].file", "maps.pin", "maps.stiffness"]


def test_the_first_mistake_is_the_one_that_a_load_raises(write: Write) -> None:
    path = write(BAD)
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    first, *others = (str(mistake) for mistake in load_with_mistakes(path)[1])
    assert str(caught.value) == first
    # Files that a scene names are read once all keys are right.
    assert [str(other) for other in caught.value.others] == others[:-1]
    assert caught.value.__notes__ == [*others[:MAX_NOTES], f"and {len(others) - 1 - MAX_NOTES} more mistakes"]


@pytest.mark.parametrize(
    ("text", "only"),
    [
        # 900 would be no particle of the default sheet
        ("[cloth]\nrow = 40\npins = [900]", "cloth.row"),
        ("[cloth]\nrows = 4000\npins = [900]", "cloth.rows"),
        ("cloth = 3\n[[attachments]]\npins = [900]", "cloth"),
        ("[clot]\nrows = 40\n[[attachments]]\npins = [900]", "clot"),
        ('[cloth]\nfile = "bsut"\npins = ["group:a"]', "cloth.file"),
        ('[cloth]\nfile = 3\npins = ["group:a"]', "cloth.file"),
        ('[cloth]\nfile = "gone.obj"\npins = ["group:a", 900000]', "cloth.file"),
        ('[cloth]\npins = ["region:a"]\n[[regions]]\nnme = "a"', "regions[0].nme"),
        ("[[regions]]\nname = 1\n[[regions]]\nname = 2", "regions[0].name, regions[1].name"),
        ('[cloth]\ncenter = 3\npins = ["region:a"]\n[[regions]]\nname = "a"\nmin = [9, 9, 9]', "cloth.center"),
        ('[maps]\npin = "none.csv"\n[cloth]\nrows = 0', "cloth.rows"),
        ('[fabric]\npreset = "denim"\nbending = 0.0\n[tearing]', "fabric.bending"),
        ("[camera]\neye = 3\ntarget = [3.5, 2.6, 6.5]", "camera.eye"),
        ("[solver]\nname = 3\n[[boxes]]\nsize = 3", "solver.name, boxes[0].size"),
        ("solver = []\nfabric = 1", "solver, fabric"),
        ("[fabric]\npreset = 'denin'\n[look]\npole = 1", "fabric.preset, look.pole"),
    ],
)
def test_what_follows_from_a_mistake_is_not_another_one(write: Write, text: str, only: str) -> None:
    found = lines_of(write(text))
    assert sorted(line.split(":")[0] for line in found) == sorted(only.split(", ")), found


@pytest.mark.parametrize("text", ["[cloth\n", b"\xff\xfe", "a = 1\na = 2"])
def test_a_file_that_cannot_be_parsed_has_one_mistake(write: Write, text: str | bytes) -> None:
    scene, mistakes = load_with_mistakes(write(text))
    assert (scene, len(mistakes)) == (None, 1)


def test_a_recording_is_not_a_scene(write: Write) -> None:
    assert lines_of(write("[recording]\nformat = 3\n[scene]\n")) == [
        "is a recording, not a scene: open it with `taichi-cloth replay`"
    ]


@pytest.mark.parametrize("name", scene_names())
def test_a_valid_scene_has_no_mistakes_and_reads_the_same(name: str) -> None:
    scene, mistakes = load_with_mistakes(name)
    assert (scene, mistakes) == (load_scene(name), [])


def test_a_mistake_concerns_its_key_its_section_and_its_parts() -> None:
    mistakes = Mistakes("a.toml")
    mistakes.add("spheres[1].center", "must be three numbers")
    mistakes.add("cloth.row", "unknown key", "rows")
    for key in (
        "spheres",
        "spheres[1]",
        "spheres[1].center",
        "spheres[1].center[2]",
        "cloth",
        "cloth.rows",
        "cloth.row",
    ):
        assert mistakes.concern("wind", key), key
    for key in ("spheres[0]", "sphere", "spheres[1].centers", "cloth.columns", "rows"):
        assert not mistakes.concern(key), key
