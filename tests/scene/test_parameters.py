"""Runtime parameters: their names, sliders and checks."""

from __future__ import annotations

from typing import Any

import pytest

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene import SceneError, check_parameter, parameters_of
from taichi_cloth.scene.keys import keys_of
from taichi_cloth.scene.schema import sections

ALL = ["gravity", "wind_x", "wind_z", "stiffness", "damping", "sphere_radius", "iterations", "substeps"]


def test_parameters_are_in_the_order_of_the_panel() -> None:
    assert list(parameters_of(load_scene("curtain"))) == ALL
    assert list(parameters_of(load_scene("drape15"))) == [name for name in ALL if name != "sphere_radius"]
    assert list(parameters_of(load_scene("table"))) == [name for name in ALL if not name.startswith("wind")]


def test_every_key_with_a_slider_is_a_parameter() -> None:
    declared = [key for part in sections().values() for key in keys_of(part.cls).values() if key.slider]
    assert len(declared) == len([*ALL, "strain_limit", "tethers_slack", "tearing_strain", "self_collision_thickness"])
    assert [*parameters_of(load_scene("curtain", strain_limit_strain=0.2))] == [*ALL, "strain_limit"]


def test_a_parameter_has_name_label_unit_and_range() -> None:
    wind = parameters_of(load_scene("curtain", wind_x=3))["wind_x"]
    assert (wind.name, wind.label, wind.unit, wind.help) == ("wind_x", "Wind X", "m/s", "wind velocity along x")
    assert (wind.slider_min, wind.slider_max, wind.key.min, wind.key.max) == (-12.0, 12.0, -100.0, 100.0)
    assert wind.value == 3.0
    assert not wind.is_int
    assert parameters_of(load_scene("curtain"))["iterations"].is_int


@pytest.mark.parametrize("name", ["curtain", "drape15", "table"])
def test_slider_ranges_contain_the_initial_value(name: str) -> None:
    for parameter in parameters_of(load_scene(name)).values():
        assert parameter.slider_min <= parameter.value <= parameter.slider_max
        assert check_parameter(parameter, parameter.value) == parameter.value
        assert check_parameter(parameter, parameter.slider_min) == parameter.slider_min
        assert check_parameter(parameter, parameter.slider_max) == parameter.slider_max


def test_a_checked_value_has_the_type_of_the_parameter() -> None:
    parameters = parameters_of(load_scene("curtain"))
    assert isinstance(check_parameter(parameters["gravity"], 3), float)
    assert isinstance(check_parameter(parameters["iterations"], 3), int)


@pytest.mark.parametrize(
    ("name", "value", "line"),
    [
        ("iterations", True, "iterations: must be an integer, got true"),
        ("iterations", 2.5, "iterations: must be an integer, got 2.5"),
        ("iterations", 0, "iterations: 0 is out of range: 1 to 1000"),
        ("gravity", "3", "gravity: must be a number, got '3'"),
        ("gravity", None, "gravity: must be a number, got None"),
        ("gravity", [1], "gravity: must be a number, got [1]"),
        ("gravity", float("nan"), "gravity: must be a finite number, got nan"),
        ("gravity", float("-inf"), "gravity: must be a finite number, got -inf"),
        ("gravity", 1e9, "gravity: 1000000000.0 is out of range: -100000 to 100000 m/s²"),
        ("sphere_radius", 0.0, "sphere_radius: 0.0 is out of range: above 0 to 1000 m"),
    ],
)
def test_a_parameter_value_is_checked_like_a_key_of_a_file(name: str, value: Any, line: str) -> None:
    with pytest.raises(SceneError) as caught:
        check_parameter(parameters_of(load_scene("curtain"))[name], value)
    assert str(caught.value) == line


def test_info_has_the_allowed_range_beside_that_of_the_slider() -> None:
    wind = parameters_of(load_scene("curtain"))["wind_z"]
    assert (wind.min, wind.slider_min, wind.slider_max, wind.max) == (-100.0, -12.0, 12.0, 100.0)
