"""The bound that a cloth at rest is held against."""

from dataclasses import replace

import pytest
from walks import CELLS, few_cells, walk

from taichi_cloth.stress import springs
from taichi_cloth.stress.case import Variant
from taichi_cloth.stress.catalogue import CASES
from taichi_cloth.stress.rest import static_strain, taut_strain
from taichi_cloth.stress.scenes import sheet
from taichi_cloth.stress.trial import Trial

from .conftest import SMALL


def test_where_springs_differ_it_is_that_of_the_softest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(springs, "CELLS", CELLS)
    monkeypatch.setattr(Trial, "start", lambda trial: None)
    monkeypatch.setattr(Trial, "settle", lambda trial: trial.only_frames("a test"))
    for ratio in (1e4, 1e6):
        trial = Trial(SMALL, 0)
        springs.stiffness_ratio(trial, ratio)
        assert trial.most_strain == pytest.approx(static_strain(sheet(CELLS)) + 0.01, rel=1e-3)


def test_a_taut_sheet_of_threads_alone_is_strained_by_the_pull() -> None:
    threads = replace(sheet(CELLS, pins=("left", "right")).fabric, shear=0.0, bending=0.0)
    taut = sheet(CELLS, pins=("left", "right"), fabric=threads)
    assert taut_strain(taut, 0.02) == pytest.approx(0.02, rel=1e-3)


def test_a_taut_sheet_with_diagonals_is_strained_by_more_at_its_corners() -> None:
    """As `spring` comes to it in 20 seconds: 2.076 % on 33 × 33 particles that are pulled by 1 %."""
    assert taut_strain(sheet(32, pins=("left", "right")), 0.01) == pytest.approx(0.02076, rel=2e-3)


# Case 40 is large, and has a bound of its own.
OPENED = [pytest.param(one, id=f"{case.number}-{one.name}") for case in CASES[:39] for one in case.variants]


@pytest.mark.parametrize("variant", OPENED)
def test_whatever_a_case_opens_has_a_bound(variant: Variant, on_lists: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """A static strain is found for it, and a mesh that cannot be read is refused by name."""
    few_cells(monkeypatch)
    walk(variant.run)
