"""Patterns on a small sheet, against values computed by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.geometry.cloth_builder import build_topology
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.render.colors import HALF_DYED_FRACTION, PATTERNS, TWILL_VALLEY_FRACTION, pattern_colors
from taichi_cloth.scene.fabric_schema import PATTERN_NAMES, PRESET_NAMES, Look
from taichi_cloth.scene.schema import Cloth, Scene

BLACK_WHITE = Look(color="#000000", second_color="#ffffff", pattern_scale=1)
SHEET = build_topology(Scene(cloth=Cloth(rows=5, columns=7)), "verlet")


def shares(pattern: str, pattern_scale: int = 1) -> np.ndarray:
    """Return the gray value of every corner, (T, 3): with black and white, the share of the second color."""
    colors = pattern_colors(SHEET, replace(BLACK_WHITE, pattern=pattern, pattern_scale=pattern_scale))
    assert colors.shape == (3 * SHEET.triangle_count, 3)
    return colors[:, 0].reshape(-1, 3)


def test_every_pattern_name_of_the_schema_has_a_pattern() -> None:
    assert tuple(PATTERNS) == PATTERN_NAMES


@pytest.mark.parametrize(
    ("pattern", "of_cell"),
    [
        ("plain", lambda row, column: 0),
        ("check", lambda row, column: (row + column) % 2),
        ("stripe", lambda row, column: column % 2),
        ("gingham", lambda row, column: (0, HALF_DYED_FRACTION, 1)[row % 2 + column % 2]),
    ],
)
def test_patterns_defined_on_cells(pattern: str, of_cell) -> None:
    expected = [of_cell(row, column) for row, column in SHEET.cells]
    assert shares(pattern) == pytest.approx(np.repeat(np.array(expected)[:, None], 3, axis=1))


@pytest.mark.parametrize(
    ("pattern", "of_particle"),
    [
        ("twill", lambda row, column: TWILL_VALLEY_FRACTION * (1, 0.5, 0, 0.5)[(row + column) % 4]),
        ("ring", lambda row, column: float(row % 2 == 0 and column % 2 == 0)),
    ],
)
def test_patterns_defined_on_particles(pattern: str, of_particle) -> None:
    expected = [[of_particle(*divmod(i, 7)) for i in triangle] for triangle in SHEET.triangles]
    assert shares(pattern, pattern_scale=2) == pytest.approx(np.array(expected))


def test_pattern_scale_is_the_number_of_cells_in_a_repeat() -> None:
    assert shares("stripe", pattern_scale=3)[:, 0].tolist() == [float(c // 3 % 2) for _, c in SHEET.cells]


@pytest.mark.parametrize("name", PRESET_NAMES)
def test_a_fabric_sets_the_look_and_the_scene_may_override_it(name: str) -> None:
    look = load_scene("drape15", fabric=name).look
    assert look.pattern in PATTERN_NAMES
    assert look != load_scene("drape15").look
    assert load_scene("drape15", fabric=name, pattern="stripe", sheen=0.9).look.pattern == "stripe"
