"""The bound that a cloth at rest is held against."""

import pytest
from walks import CELLS

from taichi_cloth.stress import springs
from taichi_cloth.stress.rest import static_strain
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
