"""The bound on the strain of a cloth at rest."""

from dataclasses import replace

import pytest
from walks import CELLS, few_cells, walk

from taichi_cloth.evaluation.stress import extremes
from taichi_cloth.evaluation.stress.case_catalog import CASES
from taichi_cloth.evaluation.stress.setup import sheet, static_strain, taut_strain
from taichi_cloth.evaluation.stress.trial import Trial
from taichi_cloth.evaluation.stress.unit import Variant
from taichi_cloth.scene.collider_schema import Ground, Plane, Sphere

from .conftest import SMALL


def test_the_strain_at_rest_of_a_half_stiff_sheet_is_that_of_its_own_springs(monkeypatch: pytest.MonkeyPatch) -> None:
    """The soft half is strained a little more than in a soft sheet: the stiff half leaves more of the weight to it."""
    monkeypatch.setattr(extremes, "CELLS", CELLS)
    monkeypatch.setattr(Trial, "start", lambda trial: None)
    monkeypatch.setattr(Trial, "settle", lambda trial: trial.skip_rest_check("a test"))
    soft, stiff = static_strain(sheet(CELLS)), static_strain(sheet(CELLS, constant=1e7))
    for ratio in (1e4, 1e6):
        trial = Trial(SMALL, 0)
        extremes.stiffness_ratio(trial, ratio)
        found = trial.max_rest_strain - 0.01
        assert 10 * stiff < found
        assert found == pytest.approx(soft, rel=0.05)
        assert abs(found / soft - 1) > 2e-3


def test_cloth_that_falls_or_lies_on_planes_is_not_strained() -> None:
    free = sheet(CELLS, pins=())
    assert static_strain(free) == static_strain(replace(free, planes=(Plane(),), ground=Ground())) == 0


def test_cloth_that_lies_on_a_ball_is_judged_by_the_hung_one() -> None:
    free = sheet(CELLS, pins=())
    assert static_strain(replace(free, spheres=(Sphere(),), ground=Ground())) == static_strain(sheet(CELLS)) > 0


def test_a_taut_sheet_without_shear_springs_is_strained_by_the_pull() -> None:
    fabric = replace(sheet(CELLS, pins=("left", "right")).fabric, shear=0.0, bending_stiffness=0.0)
    taut = sheet(CELLS, pins=("left", "right"), fabric=fabric)
    assert taut_strain(taut, 0.02) == pytest.approx(0.02, rel=1e-3)


def test_a_taut_sheet_with_shear_springs_is_strained_more_at_its_corners() -> None:
    """`explicit` gives 2.076 % after 20 seconds, on 33 × 33 particles pulled by 1 %."""
    assert taut_strain(sheet(32, pins=("left", "right")), 0.01) == pytest.approx(0.02076, rel=2e-3)


# Case 40 is large, and has a bound of its own.
OPENED = [pytest.param(one, id=f"{case.number}-{one.name}") for case in CASES[:39] for one in case.variants]


@pytest.mark.parametrize("variant", OPENED)
def test_every_scene_of_a_case_has_a_bound(
    variant: Variant, serial_layout: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has a static strain; a mesh that cannot be read is refused by name."""
    few_cells(monkeypatch)
    walk(variant.run)
