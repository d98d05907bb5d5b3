"""The parameters a slider may change."""

from __future__ import annotations

from typing import Any

import pytest

from taichi_cloth.scene import SceneError, check_live, live_keys, load_scene
from taichi_cloth.scene.model import keys_of, parts

ALL = ["gravity", "wind_x", "wind_z", "stiffness", "damping", "sphere_radius", "iterations", "substeps"]


def test_live_keys_are_in_the_panels_order() -> None:
    assert list(live_keys(load_scene("curtain"))) == ALL
    assert list(live_keys(load_scene("drape15"))) == [name for name in ALL if name != "sphere_radius"]
    assert list(live_keys(load_scene("table"))) == [name for name in ALL if not name.startswith("wind")]


def test_every_key_with_a_slider_is_live() -> None:
    declared = [key for part in parts().values() for key in keys_of(part.section).values() if key.slider]
    assert len(declared) == len([*ALL, "limit_strain", "tethers_slack", "tear_strain", "self_collision_thickness"])
    assert [*live_keys(load_scene("curtain", limit_strain=0.2))] == [*ALL, "limit_strain"]


def test_a_live_key_says_what_it_is() -> None:
    wind = live_keys(load_scene("curtain", wind_x=3))["wind_x"]
    assert (wind.name, wind.label, wind.unit, wind.help) == ("wind_x", "Wind X", "m/s", "wind along x")
    assert (wind.low, wind.high, wind.key.low, wind.key.high) == (-12.0, 12.0, -100.0, 100.0)
    assert wind.value == 3.0
    assert not wind.is_int
    assert live_keys(load_scene("curtain"))["iterations"].is_int


@pytest.mark.parametrize("name", ["curtain", "drape15", "table"])
def test_sliders_hold_the_value_they_start_from(name: str) -> None:
    for key in live_keys(load_scene(name)).values():
        assert key.low <= key.value <= key.high
        assert check_live(key, key.value) == key.value
        assert check_live(key, key.low) == key.low
        assert check_live(key, key.high) == key.high


def test_a_checked_value_has_the_keys_type() -> None:
    keys = live_keys(load_scene("curtain"))
    assert isinstance(check_live(keys["gravity"], 3), float)
    assert isinstance(check_live(keys["iterations"], 3), int)


@pytest.mark.parametrize(
    ("name", "value", "line"),
    [
        ("iterations", True, "iterations: a whole number is needed, not true"),
        ("iterations", 2.5, "iterations: a whole number is needed, not 2.5"),
        ("iterations", 0, "iterations: 0 is out of range: 1 to 1000"),
        ("gravity", "3", "gravity: a number is needed, not '3'"),
        ("gravity", None, "gravity: a number is needed, not None"),
        ("gravity", [1], "gravity: a number is needed, not [1]"),
        ("gravity", float("nan"), "gravity: a finite number is needed, not nan"),
        ("gravity", float("-inf"), "gravity: a finite number is needed, not -inf"),
        ("gravity", 1e9, "gravity: 1000000000.0 is out of range: -100000 to 100000 m/s²"),
        ("sphere_radius", 0.0, "sphere_radius: 0.0 is out of range: above 0 to 1000 m"),
    ],
)
def test_a_live_value_is_checked_like_a_files(name: str, value: Any, line: str) -> None:
    with pytest.raises(SceneError) as caught:
        check_live(live_keys(load_scene("curtain"))[name], value)
    assert str(caught.value) == line
