"""The converged motion: two methods agree, printed numbers are met, energy is kept."""

import numpy as np
import pytest

from taichi_cloth.accuracy.truth import GRAVITY, Curtain, extrapolated, truth
from taichi_cloth.validate.swing import CURTAIN


@pytest.mark.parametrize("cells", CURTAIN)
def test_the_printed_numbers_of_the_curtain(cells: int) -> None:
    bottom = truth(Curtain(cells))[[14, 29, 59], -1]
    assert bottom == pytest.approx(np.array(CURTAIN[cells]), abs=1e-8)


@pytest.mark.parametrize(
    "curtain", [Curtain(32), Curtain(12, degrees=80.0), Curtain(20, constant=5e3, area_density=0.5)]
)
def test_another_method_gives_the_same(curtain: Curtain) -> None:
    assert extrapolated(curtain, 30) == pytest.approx(truth(curtain, 30), abs=1e-8)


def test_one_link_is_an_elastic_pendulum_that_keeps_its_energy() -> None:
    curtain = Curtain(1, constant=200.0)
    x = truth(curtain, 60)[:, 1]
    v = (x[2:] - x[:-2]) * 30  # central, exact to second order
    spring = 0.5 * curtain.constant * (np.linalg.norm(x, axis=1) - 1) ** 2
    energy = 0.5 * curtain.mass * (v**2).sum(axis=1) + curtain.mass * GRAVITY * x[1:-1, 1] + spring[1:-1]
    start = curtain.mass * GRAVITY * curtain.start[1, 1]
    assert energy == pytest.approx(np.full(58, start), abs=0.02 * abs(start))
