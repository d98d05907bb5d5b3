"""Scenes without some of what they name."""

from __future__ import annotations

from dataclasses import replace

import pytest

from taichi_cloth.scene import Scene, SceneError, check_scene, load_scene, scene_names
from taichi_cloth.scene.leave_out import may_do_without, scene_without


@pytest.mark.parametrize("name", scene_names())
def test_each_stage_goes_and_the_rest_stays(name: str) -> None:
    scene = load_scene(name)
    for stage in may_do_without(scene):
        less = scene_without(scene, [stage])
        assert not getattr(less, stage)
        assert replace(less, **{stage: getattr(scene, stage)}) == scene
        assert check_scene(less) == less
    assert may_do_without(scene_without(scene, may_do_without(scene))) == []


def test_pins_that_move_are_no_stage_to_leave_out() -> None:
    assert load_scene("twist").grips
    assert may_do_without(load_scene("twist")) == ["self_collision"]


def test_words_of_a_command_line_are_taken() -> None:
    assert scene_without(load_scene("twist"), ["self-collision"]).self_collision is None
    assert scene_without(Scene(), []) == Scene()


def test_what_is_not_there_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(SceneError, match=r"limits: net has no such .*limit, spheres, ground \(did you mean 'limit'"):
        scene_without(load_scene("net"), ["limits"])
    with pytest.raises(SceneError, match="drape15 has no such stage"):
        scene_without(load_scene("drape15"), ["tethers"])
    with pytest.raises(SceneError, match="can do without none"):
        scene_without(Scene(), ["wind"])
