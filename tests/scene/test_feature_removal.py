"""Scenes with some of their sections removed."""

from __future__ import annotations

from dataclasses import replace

import pytest

from taichi_cloth.geometry.scene_loader import check_scene, load_scene
from taichi_cloth.scene import Scene, SceneError, scene_names
from taichi_cloth.scene.overrides import removable_sections, scene_without


@pytest.mark.parametrize("name", scene_names())
def test_removing_a_section_changes_nothing_else(name: str) -> None:
    scene = load_scene(name)
    for section in removable_sections(scene):
        reduced = scene_without(scene, [section])
        assert not getattr(reduced, section)
        assert replace(reduced, **{section: getattr(scene, section)}) == scene
        assert check_scene(reduced) == reduced
    assert removable_sections(scene_without(scene, removable_sections(scene))) == []


def test_attachments_are_not_removable() -> None:
    assert load_scene("twist").attachments
    assert removable_sections(load_scene("twist")) == ["self_collision"]


def test_section_names_may_be_written_with_dashes() -> None:
    assert scene_without(load_scene("twist"), ["self-collision"]).self_collision is None
    assert scene_without(Scene(), []) == Scene()


def test_a_missing_section_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(
        SceneError,
        match=r"strain_limits: net has no such .*: strain_limit, spheres, ground \(did you mean 'strain_limit'",
    ):
        scene_without(load_scene("net"), ["strain_limits"])
    with pytest.raises(SceneError, match="drape15 has no such feature"):
        scene_without(load_scene("drape15"), ["tethers"])
    with pytest.raises(SceneError, match="removable: none"):
        scene_without(Scene(), ["wind"])
