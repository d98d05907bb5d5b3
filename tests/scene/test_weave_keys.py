"""`[weave]`: curves as they are written and read, and one line for each mistake."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene import SceneError, scene_to_toml
from taichi_cloth.scene.fabric_schema import Fabric, Weave
from taichi_cloth.scene.keys import MAX_POINTS
from taichi_cloth.scene.overrides import removable_sections
from taichi_cloth.scene.schema import Scene, Solver

Write = Callable[[str | bytes], Path]
Refuse = Callable[..., SceneError]

MODEL = "[solver]\nname = 'explicit'\n[fabric]\nmodel = 'weave'\n"
CURVES = {"warp": "[[0.02, 10], [0.05, 100]]", "weft": "[[0.04, 12]]", "shear": "[[1, 0.5], [8, 1.6]]"}


def text(model: str = MODEL, **curves: str) -> str:
    """Return a scene whose curves are those of `CURVES` or those given; "" leaves one out."""
    return f"{model}[weave]\n" + "".join(f"{name} = {value}\n" for name, value in (CURVES | curves).items() if value)


def test_curves_are_read_and_written(write: Write) -> None:
    scene = load_scene(write(text(bending_weft="[[50, 2e-4]]")))
    assert scene.weave == Weave(
        ((0.02, 10.0), (0.05, 100.0)), ((0.04, 12.0),), ((1.0, 0.5), (8.0, 1.6)), (), ((50.0, 2e-4),)
    )
    assert load_scene(write(scene_to_toml(scene))) == scene
    assert load_scene(scene) == scene


def test_the_origin_may_be_written_or_not(write: Write) -> None:
    scenes = [load_scene(write(text(warp=warp))) for warp in ("[[0, 0], [0.1, 5]]", "[[0.1, 5]]")]
    assert scenes[0] == scenes[1]
    assert scenes[0].weave is not None
    assert scenes[0].weave.warp == ((0.1, 5.0),)


@pytest.mark.parametrize(
    ("name", "value", "key", "reason"),
    [
        ("warp", "[[0.03, 10], [0.02, 20]]", "weave.warp", "strain 0.02 is not greater than 0.03"),
        ("weft", "[[0.0, 10]]", "weave.weft", "strain 0 is not greater than 0"),
        ("warp", "[[0.03, 20], [0.04, 20]]", "weave.warp", "tension 20 is not greater than 20"),
        ("shear", "[[1, 0.5], [1, 2]]", "weave.shear", "angle 1 is not greater than 1"),
        ("bending_warp", "[[9, 2], [8, 3]]", "weave.bending_warp", "curvature 8 is not greater than 9"),
        ("bending_weft", "[[9, 2], [10, 1]]", "weave.bending_weft", "moment 1 is not greater than 2"),
        ("warp", "[[-0.1, 2]]", "weave.warp[0][0]", "-0.1 is out of range: 0 to 1000000000"),
        ("warp", "[[0.1, nan]]", "weave.warp[0][1]", "must be a finite number, got nan"),
        ("warp", "[[0.1, 'a']]", "weave.warp[0][1]", "must be a number, got 'a'"),
        ("warp", "[[0.1, 2, 3]]", "weave.warp[0]", "must be a pair of numbers, got [0.1, 2, 3]"),
        ("warp", "[0.1, 2]", "weave.warp[0]", "must be a pair of numbers, got 0.1"),
        ("warp", "3.0", "weave.warp", "must be pairs, as in [[0.02, 5], [0.1, 50]], got 3.0"),
        ("warp", "[[0, 0]]", "weave.warp", f"must have 1 to {MAX_POINTS} points besides [0, 0], got 0"),
        ("warp", "[]", "weave.warp", "is missing: a weave needs the curves warp, weft and shear"),
        ("shear", "", "weave.shear", "is missing: a weave needs the curves warp, weft and shear"),
        ("warp", "[[1e-9, 100]]", "weave.warp", "rises by more than 1e+09 per strain after 0"),
    ],
)
def test_a_wrong_curve_is_one_line(write: Write, refuse: Refuse, name: str, value: str, key: str, reason: str) -> None:
    error = refuse(write(text(**{name: value})))
    assert (error.key, error.reason) == (key, reason)


def test_a_curve_has_a_few_points(write: Write, refuse: Refuse) -> None:
    points = [[k, k] for k in range(1, MAX_POINTS + 2)]
    assert load_scene(write(text(warp=str(points[:-1])))).weave is not None
    assert load_scene(write(text(warp=str([[0, 0], *points[:-1]])))).weave is not None
    assert refuse(write(text(warp=str(points)))).reason.endswith(f"besides [0, 0], got {MAX_POINTS + 1}")


@pytest.mark.parametrize(
    ("model", "key", "reason"),
    [
        ("", "weave", 'belongs to a weave: set fabric.model = "weave"'),
        ("[fabric]\nmodel = 'membrane'\n", "weave", 'belongs to a weave: set fabric.model = "weave"'),
        (MODEL + "c11 = 5.0\n", "fabric.c11", 'belongs to a membrane: set fabric.model = "membrane"'),
        (
            MODEL + "warp_angle = 45\n",
            "fabric.warp_angle",
            "must be 0 for a weave, whose threads are the grid's, got 45",
        ),
        (MODEL + "[strain_limit]\n", "strain_limit", 'needs springs, but fabric.model is "weave"'),
        (MODEL + "[tearing]\n", "tearing", 'needs springs, but fabric.model is "weave"'),
        ("[cloth]\nfile = 'bust'\n" + MODEL, "fabric.model", "a weave needs a grid, but cloth.file names a mesh"),
    ],
)
def test_what_does_not_go_with_a_weave_is_one_line(
    write: Write, refuse: Refuse, model: str, key: str, reason: str
) -> None:
    error = refuse(write(text(model)))
    assert (error.key, error.reason) == (key, reason)


def test_a_weave_needs_its_section(write: Write, refuse: Refuse) -> None:
    error = refuse(write(MODEL))
    assert (error.key, error.reason.split(":")[0]) == ("weave", "is missing")


def test_objects_are_checked_as_files_are() -> None:
    with pytest.raises(SceneError, match=r"weave\.warp: strain 0\.02 is not greater than 0\.03"):
        Scene(fabric=Fabric(model="weave"), weave=Weave(((0.03, 1.0), (0.02, 2.0))))
    with pytest.raises(SceneError, match=r"weave\.weft: is missing"):
        load_scene(Scene(fabric=Fabric(model="weave"), weave=Weave(((0.03, 1.0),)), solver=Solver("rk4")))


def test_a_weave_is_no_feature_that_can_be_removed(write: Write) -> None:
    scene = load_scene(write(text() + "[wind]\n"))
    assert removable_sections(scene) == ["wind"]
