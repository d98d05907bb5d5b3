"""A scene written as TOML is read back the same; the table of keys."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_type_hints

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from taichi_cloth.scene import Scene, key_table, load_scene, scene_names, scene_to_toml
from taichi_cloth.scene.model import (
    GRID_KEYS,
    MAP_NAMES,
    Cloth,
    Key,
    Keyframes,
    Maps,
    Mesh,
    Part,
    Region,
    Round,
    SelfCollision,
    Vec3,
    keys_of,
    parts,
)

Write = Callable[[str | bytes], Path]


def values_of(hint: Any, key: Key) -> st.SearchStrategy[Any]:
    """Everything that a key may hold."""
    if hint is bool:
        return st.booleans()
    if hint is str:
        return st.from_regex("#[0-9a-f]{6}", fullmatch=True) if key.colour else st.sampled_from(key.choices or texts)
    if hint == Keyframes:
        row = st.lists(st.floats(-1e5, 1e5, allow_subnormal=False), min_size=3, max_size=3)
        times = st.lists(st.integers(0, 99), unique=True, max_size=3).map(sorted)
        return times.flatmap(lambda t: st.tuples(*(row.map(lambda r, t=one: (float(t), *r)) for one in t)))
    if hint not in (int, float, Vec3):
        return st.lists(st.sampled_from(["top", "bottom-left"]) | st.integers(0, 3), max_size=4).map(tuple)
    assert key.low is not None
    assert key.high is not None
    if hint is int:
        return st.integers(int(key.low), int(key.high))
    # Taichi sets the processor to flush subnormal numbers to zero.
    number = st.floats(key.low, key.high, exclude_min=key.above_low, allow_subnormal=False)
    return number if hint is float else st.tuples(number, number, number)


texts = ("", "plain", 'quotes " and \\ both', "ß → 漢 🧵", "[cloth] # no comment", "non\u00a0breaking \u200d", "'''")


def tables(section: type, **more: Any) -> st.SearchStrategy[Any]:
    hints = get_type_hints(section)
    return st.builds(section, **({n: values_of(hints[n], key) for n, key in keys_of(section).items()} | more))


# A mesh must be there, and distances to it must fit into the memory.
MESHES = {"file": st.just("bust"), "scale": st.just(1.5), "resolution": st.integers(4, 32), "margin": st.just(0.01)}
FILES = {Mesh: MESHES, Cloth: {"file": st.just("")}, Maps: dict.fromkeys(MAP_NAMES, st.just(""))}


def possible(section: Any) -> Any:
    """The same section; of a body that does not project, without what only projection can do, and of a cloth whose
    triangles keep off each other, without what only particles can do.
    """
    if isinstance(section, SelfCollision):
        return replace(section, stick=section.stick and section.contacts == "particles")
    if getattr(section, "response", "projection") == "projection":
        return section
    return replace(section, swept=False, **({"against": "particles"} if isinstance(section, Round) else {}))


def sections(part: Part) -> st.SearchStrategy[Any]:
    one = tables(part.section, **FILES.get(part.section, {})).map(possible)
    if part.section is Region:
        return st.lists(one, max_size=3, unique_by=lambda region: region.name).map(tuple)
    if part.many:
        return st.lists(one, max_size=3).map(tuple)
    return st.none() | one if part.optional else one


def sewn(scene: Scene) -> Scene:
    """The same scene; of a cloth that tears, without the bending that it may not have."""
    return scene if scene.tear is None else replace(scene, fabric=replace(scene.fabric, bending=0.0))


scenes = tables(Scene, name=st.just("mine"), **{name: sections(part) for name, part in parts().items()}).map(sewn)


@given(scenes)
def test_a_scene_survives_being_written(write: Write, scene: Scene) -> None:
    (x, _, z), (tx, _, tz) = scene.camera.eye, scene.camera.target
    assume(abs(x - tx) + abs(z - tz) > 1)
    assume(scene.cloth.sheets == 1 or scene.tethers is None)
    assert load_scene(write(scene_to_toml(scene))) == scene


@pytest.mark.parametrize("name", scene_names())
def test_shipped_scenes_survive_being_written(write: Write, name: str) -> None:
    scene = load_scene(name)
    assert replace(load_scene(write(scene_to_toml(scene))), name=name) == scene


def test_a_cloth_from_a_file_is_written_without_the_keys_of_a_grid(write: Write) -> None:
    scene = load_scene(write('[cloth]\nfile = "bust"\nscale = 2.0\npins = [7]\n'))
    text = scene_to_toml(scene)
    assert load_scene(write(text)) == scene
    assert '\nfile = "bust"\nscale = 2.0  # m\n' in text
    assert not any(f"\n{key} = " in text.partition("[springs]")[0] for key in GRID_KEYS)


def test_every_key_is_written_with_its_unit() -> None:
    text = scene_to_toml(load_scene("table", wind_x=3))
    assert "\n[wind]\nx = 3.0  # m/s\n" in text
    assert text.count("[[boxes]]") == 3
    for part in parts().values():
        left_out = ("limit", "regions", "maps", "tethers", "tear", "grips", "capsules", "planes", "meshes")
        left_out += ("self_collision",)
        assert (f"[{part.name}]" in text) == (part.name not in left_out)
        assert f"[{part.name}]" not in text or all(f"\n{key} = " in text for key in keys_of(part.section))


# -- the table of keys -------------------------------------------------------------------------------------


def test_the_table_has_every_key_once_with_default_unit_range_and_help() -> None:
    rows = key_table()
    assert len({row[:2] for row in rows}) == len(rows)
    assert ("[wind]", "x", "0.0", "m/s", "-100 to 100 m/s", "wind along x") in rows
    assert ("[[spheres]]", "radius", "0.5", "m", "above 0 to 1000 m", "radius as drawn") in rows
    assert ("", "seed", "0", "", "0 to 2147483647", "seed of the gusts") in rows
    assert ("[look]", "check", '"#e9dcc3"', "", "#rrggbb", "second colour of the pattern") in rows
    assert (
        "[solver]",
        "name",
        '"verlet"',
        "",
        "verlet, xpbd, spring, lines, rk4, projective",
        "method that advances the cloth",
    ) in rows


@pytest.mark.parametrize("section", [Scene, *(part.section for part in parts().values())])
def test_every_key_has_help_and_every_number_a_range_that_holds_its_default(section: type) -> None:
    hints = get_type_hints(section)
    for field in fields(section):
        if field.name not in keys_of(section):
            assert section is Scene or "derived" in field.metadata, field.name
            continue
        key = keys_of(section)[field.name]
        assert key.help
        if hints[field.name] in (int, float, Vec3):
            assert key.low is not None
            assert key.high is not None
            numbers = field.default if isinstance(field.default, tuple) else (field.default,)
            assert all(key.low <= number <= key.high for number in numbers), field.name
