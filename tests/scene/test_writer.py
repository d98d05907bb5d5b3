"""Scenes written as TOML are equal when read back; the table of keys."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import taichi_cloth as tc
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene import Scene, SceneError, key_table, scene_names, scene_to_toml
from taichi_cloth.scene.collider_schema import Mesh, RoundCollider
from taichi_cloth.scene.keys import MAX_POINTS, Curve, Key, Keyframes, Section, Vec3, Weights, keys_of, toml_value
from taichi_cloth.scene.schema import (
    COLLIDERS,
    GRID_KEYS,
    MAP_NAMES,
    Cloth,
    Maps,
    Region,
    SelfCollision,
    Wind,
    sections,
)

Write = Callable[[str | bytes], Path]


def values_of(hint: Any, key: Key) -> st.SearchStrategy[Any]:
    """Return a strategy for all valid values of a key."""
    if hint is bool:
        return st.booleans()
    if hint is str:
        return st.from_regex("#[0-9a-f]{6}", fullmatch=True) if key.color else st.sampled_from(key.choices or texts)
    if hint == Keyframes:
        row = st.lists(st.floats(-1e5, 1e5, allow_subnormal=False), min_size=3, max_size=3)
        times = st.lists(st.integers(0, 99), unique=True, max_size=3).map(sorted)
        return times.flatmap(lambda t: st.tuples(*(row.map(lambda r, t=one: (float(t), *r)) for one in t)))
    if hint == Curve:
        steps = st.lists(st.floats(0.01, 1e3), min_size=1, max_size=MAX_POINTS)
        return steps.map(lambda found: tuple(zip(np.cumsum(found).tolist(), np.cumsum(found).tolist(), strict=True)))
    if hint == Weights:
        row = st.lists(st.floats(0.0, 1.0) | st.booleans(), min_size=1, max_size=4).map(tuple)
        return row | row.map(lambda r: (r, r)) | st.just("")
    if hint not in (int, float, Vec3):
        return st.lists(st.sampled_from(["top", "bottom-left"]) | st.integers(0, 3), max_size=4).map(tuple)
    assert key.min is not None
    assert key.max is not None
    if hint is int:
        return st.integers(int(key.min), int(key.max))
    # Taichi sets the processor to flush subnormal numbers to zero.
    number = st.floats(key.min, key.max, exclude_min=key.exclusive_min, allow_subnormal=False)
    return number if hint is float else st.tuples(number, number, number)


texts = ("", "plain", 'quotes " and \\ both', "ß → 漢 🧵", "[cloth] # no comment", "non\u00a0breaking \u200d", "'''")


def tables(section: type, **more: Any) -> st.SearchStrategy[Any]:
    hints = get_type_hints(section)
    return st.builds(section, **({n: values_of(hints[n], key) for n, key in keys_of(section).items()} | more))


# The mesh file must exist, and its distance grid must fit into memory.
MESHES = {"file": st.just("bust"), "scale": st.just(1.5), "resolution": st.integers(4, 32), "margin": st.just(0.01)}
MESHES["clip"] = st.just("")  # a clip must exist too
FILES: dict[type, dict[str, Any]] = {
    Mesh: MESHES,
    Cloth: {"file": st.just("")},
    Maps: dict.fromkeys(MAP_NAMES, st.just("")),
}


def consistent_section(section: Any) -> Any:
    """Return the section without keys that its other keys do not allow.

    Continuous collision detection and triangle collision require projection, and static friction requires particles
    that may penetrate.
    """
    if isinstance(section, SelfCollision):
        allowed = section.primitives == "particles" and not section.penetration_free
        return replace(section, static_friction=section.static_friction and allowed)
    if getattr(section, "response", "projection") == "projection":
        return section
    changed: dict[str, Any] = {"continuous": False}
    if isinstance(section, RoundCollider):
        changed["collide_with"] = "particles"
    return replace(section, **changed)


def sections_of(part: Section) -> st.SearchStrategy[Any]:
    one = tables(part.cls, **FILES.get(part.cls, {})).map(consistent_section)
    if part.cls is Region:
        return st.lists(one, max_size=3, unique_by=lambda region: region.name).map(tuple)
    if part.is_array:
        return st.lists(one, max_size=3).map(tuple)
    return st.none() | one if part.optional else one


def consistent_scene(scene: Scene) -> Scene:
    """Return the scene, without keys that others of it refuse, and with a name for one collider only."""
    woven = scene.weave is not None
    if woven or scene.fabric.model == "weave":
        model = "weave" if woven else "springs"
        fabric = replace(scene.fabric, model=model, warp_angle=0.0, c11=0.0, c22=0.0, c12=0.0, c66=0.0)
        without = {"tearing": None, "strain_limit": None} if woven else {}
        scene = replace(scene, fabric=fabric, **without)
    elif scene.fabric.model == "membrane":
        fabric = replace(scene.fabric, c11=900.0, c22=400.0, c12=-500.0, c66=7.0)
        scene = replace(scene, fabric=fabric, tearing=None, strain_limit=None)
    else:
        scene = replace(scene, fabric=replace(scene.fabric, c11=0.0, c22=0.0, c12=0.0, c66=0.0))
    if scene.tearing is not None:
        scene = replace(scene, fabric=replace(scene.fabric, bending_stiffness=0.0, bending_weft=0.0))
    if scene.cloth.layer_spacing == 0 and scene.self_collision is not None:
        scene = replace(scene, self_collision=replace(scene.self_collision, penetration_free=False))
    colliders = {section: getattr(scene, section) for section in COLLIDERS}
    named = [one for section in colliders.values() for one in section if one.name][:1]
    unnamed = {
        section: tuple(one if any(one is first for first in named) else replace(one, name="") for one in found)
        for section, found in colliders.items()
    }
    return replace(scene, **unnamed)


scenes = tables(Scene, name=st.just("mine"), **{name: sections_of(part) for name, part in sections().items()}).map(
    consistent_scene
)


@given(scenes)
def test_a_random_scene_is_equal_when_read_back(write: Write, scene: Scene) -> None:
    (x, _, z), (tx, _, tz) = scene.camera.eye, scene.camera.target
    assume(abs(x - tx) + abs(z - tz) > 1)
    assume(scene.cloth.layers == 1 or scene.tethers is None)
    assert load_scene(write(scene_to_toml(scene))) == scene


@pytest.mark.parametrize("name", scene_names())
def test_shipped_scenes_are_equal_when_read_back(write: Write, name: str) -> None:
    scene = load_scene(name)
    assert replace(load_scene(write(scene_to_toml(scene))), name=name) == scene


def test_cloth_from_a_mesh_file_is_written_without_grid_keys(write: Write) -> None:
    scene = load_scene(write('[cloth]\nfile = "bust"\nscale = 2.0\npins = [7]\n'))
    text = scene_to_toml(scene)
    assert load_scene(write(text)) == scene
    assert '\nfile = "bust"\nscale = 2.0  # m\n' in text
    assert not any(f"\n{key} = " in text.partition("[verlet]")[0] for key in GRID_KEYS)


def test_every_key_is_written_with_its_unit() -> None:
    text = scene_to_toml(load_scene("table", wind_x=3))
    assert "\n[wind]\nx = 3.0  # m/s\n" in text
    assert text.count("[[boxes]]") == 3
    for part in sections().values():
        absent: tuple[str, ...] = ("weave", "strain_limit", "regions", "maps", "tethers", "tearing", "attachments")
        absent += ("capsules", "planes", "meshes", "self_collision")
        assert (f"[{part.name}]" in text) == (part.name not in absent)
        assert f"[{part.name}]" not in text or all(f"\n{key} = " in text for key in keys_of(part.cls))


# -- the table of keys -------------------------------------------------------------------------------------


def test_the_table_has_every_key_once_with_default_unit_range_and_help() -> None:
    rows = key_table()
    assert len({row[:2] for row in rows}) == len(rows)
    assert ("[wind]", "x", "0.0", "m/s", "-100 to 100 m/s", "wind velocity along x") in rows
    assert ("[[spheres]]", "radius", "0.5", "m", "above 0 to 1000 m", "radius, without the margin") in rows
    assert ("", "seed", "0", "", "0 to 2147483647", "random seed of the gusts") in rows
    assert ("[look]", "second_color", '"#e9dcc3"', "", "#rrggbb", "second color of the pattern") in rows
    assert (
        "[solver]",
        "name",
        '"verlet"',
        "",
        "verlet, xpbd, explicit, lines, rk4, implicit",
        "solver that advances the cloth",
    ) in rows


@pytest.mark.parametrize("section", [Scene, *(part.cls for part in sections().values())])
def test_every_key_has_help_and_every_number_a_range_that_contains_its_default(section: type) -> None:
    hints = get_type_hints(section)
    for field in fields(section):
        if field.name not in keys_of(section):
            assert section is Scene or "derived" in field.metadata, field.name
            continue
        key = keys_of(section)[field.name]
        assert key.help
        if hints[field.name] in (int, float, Vec3):
            assert key.min is not None
            assert key.max is not None
            numbers = field.default if isinstance(field.default, tuple) else (field.default,)
            assert all(key.min <= number <= key.max for number in numbers), field.name


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (np.float64(6), "6.0"),
        (np.float32(0.5), "0.5"),
        (np.int64(3), "3"),
        (np.bool_(True), "true"),
        (np.str_('a "b"'), '"a \\"b\\""'),
        ((1, np.float64(2)), "[1, 2.0]"),
        (np.array([1.5, 2.0]), "[1.5, 2.0]"),
    ],
)
def test_values_of_numpy_are_written_as_those_of_python(value: object, text: str) -> None:
    assert toml_value(value) == text


def test_a_scene_with_numbers_of_numpy_is_read_back(write: Write) -> None:
    scene = Scene(wind=Wind(z=np.float64(6)), cloth=Cloth(center=(np.float64(0), 2.0, np.float32(0))))
    again = load_scene(write(scene_to_toml(scene)))
    assert again.wind == Wind(z=6.0)
    assert again.cloth == scene.cloth


@pytest.mark.parametrize("name", scene_names())
def test_a_saved_scene_is_the_same_scene(tmp_path: Path, name: str) -> None:
    scene = load_scene(name)
    tc.save_scene(scene, tmp_path / "new" / "my scene.toml")
    again = load_scene(tmp_path / "new" / "my scene.toml")
    assert replace(again, name=name) == scene


def test_files_of_a_scene_that_is_saved_elsewhere_are_found(tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new" / "deeper"
    old.mkdir()
    (old / "flag.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n")
    solid = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (old / "solid.obj").write_text(solid)
    (old / "soft.csv").write_text("0.5\n1\n1\n1\n")
    keys = "[cloth]\nfile = 'flag.obj'\n[[meshes]]\nfile = 'solid.obj'\n[maps]\nstiffness = 'soft.csv'\n"
    (old / "scene.toml").write_text(keys)
    scene = load_scene(old / "scene.toml")
    tc.save_scene(scene, new / "scene.toml")
    again = load_scene(new / "scene.toml")
    assert again.maps is not None
    assert again.cloth.file == "../../old/flag.obj"
    for part, file in ((again.cloth, "flag.obj"), (again.meshes[0], "solid.obj")):
        assert (Path(part.folder) / part.file).resolve() == (old / file).resolve()
    assert (Path(again.maps.folder) / again.maps.stiffness).resolve() == (old / "soft.csv").resolve()
    tc.save_scene(again, old / "again.toml")
    assert replace(load_scene(old / "again.toml"), name=scene.name) == scene


def test_a_scene_that_cannot_be_saved_is_one_line_and_no_file(tmp_path: Path) -> None:
    with pytest.raises(tc.UsageError, match=r"scenes are saved as TOML files: the name must end in \.toml"):
        tc.save_scene(load_scene("curtain"), tmp_path / "curtain.json")
    with pytest.raises(SceneError, match=r"cloth\.rows"):
        tc.save_scene(Scene(cloth=Cloth(rows=1)), tmp_path / "curtain.toml")
    assert not list(tmp_path.iterdir())
