"""Patterns by hand on a sheet of few cells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.mesh.from_scene import topology_of
from taichi_cloth.scene import load_scene
from taichi_cloth.scene.model import PATTERN_NAMES, PRESET_NAMES, Cloth, Look, Scene
from taichi_cloth.view.patterns import BLEACHED, PATTERNS, WALE, pattern_colours

BLACK_WHITE = Look(cloth="#000000", check="#ffffff", check_cells=1)
SHEET = topology_of(Scene(cloth=Cloth(rows=5, columns=7)), "springs")


def shares(pattern: str, check_cells: int = 1) -> np.ndarray:
    """Grey of every corner, (T, 3): with black and white, the share of the second colour."""
    colours = pattern_colours(SHEET, replace(BLACK_WHITE, pattern=pattern, check_cells=check_cells))
    assert colours.shape == (3 * SHEET.triangle_count, 3)
    return colours[:, 0].reshape(-1, 3)


def test_every_pattern_that_a_scene_may_name_is_there() -> None:
    assert tuple(PATTERNS) == PATTERN_NAMES


@pytest.mark.parametrize(
    ("pattern", "of_cell"),
    [
        ("plain", lambda row, column: 0),
        ("check", lambda row, column: (row + column) % 2),
        ("stripe", lambda row, column: column % 2),
        ("gingham", lambda row, column: (0, BLEACHED, 1)[row % 2 + column % 2]),
    ],
)
def test_patterns_of_cells(pattern: str, of_cell) -> None:
    expected = [of_cell(row, column) for row, column in SHEET.cells]
    assert shares(pattern) == pytest.approx(np.repeat(np.array(expected)[:, None], 3, axis=1))


@pytest.mark.parametrize(
    ("pattern", "of_particle"),
    [
        ("twill", lambda row, column: WALE * (1, 0.5, 0, 0.5)[(row + column) % 4]),
        ("ring", lambda row, column: float(row % 2 == 0 and column % 2 == 0)),
    ],
)
def test_patterns_of_particles(pattern: str, of_particle) -> None:
    expected = [[of_particle(*divmod(i, 7)) for i in triangle] for triangle in SHEET.triangles]
    assert shares(pattern, check_cells=2) == pytest.approx(np.array(expected))


def test_a_repeat_is_as_many_cells_as_the_scene_says() -> None:
    assert shares("stripe", check_cells=3)[:, 0].tolist() == [float(c // 3 % 2) for _, c in SHEET.cells]


@pytest.mark.parametrize("name", PRESET_NAMES)
def test_a_fabric_brings_its_look_and_the_scene_may_say_another(name: str) -> None:
    dressed = load_scene("drape15", fabric=name).look
    assert dressed.pattern in PATTERN_NAMES
    assert dressed != load_scene("drape15").look
    assert load_scene("drape15", fabric=name, pattern="stripe", sheen=0.9).look.pattern == "stripe"
