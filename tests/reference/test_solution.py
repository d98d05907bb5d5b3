"""What the reference says of itself: its horizon and its uncertainty."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taichi_cloth import load_scene
from taichi_cloth.reference.dynamics import Motion
from taichi_cloth.reference.solution import Solution, fastest, solve, steps_of, until_horizon, without_solution
from taichi_cloth.reference.springs import spring_model
from taichi_cloth.scene.model import Cloth, Fabric, Grip, Limit, Scene, Solver, Tear, Wind

SMALL = Scene(
    cloth=Cloth(rows=5, columns=5, width=1.0, height=1.0, rotation=(-60.0, 0.0, 0.0)),
    fabric=Fabric(warp=100.0, weft=100.0, shear=50.0, bend=1.0),
    solver=Solver(damping=1.0),
    wind=Wind(x=1.0, turbulence=1.0),
)


def test_the_uncertainty_bounds_the_error() -> None:
    places, coarser = solve(SMALL, 10)
    solution = Solution(places, coarser, 1.0)
    finest = Motion(SMALL, 16 * steps_of(SMALL))
    truth = np.array([finest.frame() for _ in range(10)])
    error = np.sqrt(((places - truth) ** 2).sum(axis=2).mean())
    rms, most = solution.uncertainty
    assert 0 < error < rms < most < 1e-4
    assert rms / error == pytest.approx(3, rel=0.3)  # second order: of half the step a third of the difference is left


def test_the_horizon_ends_where_a_disturbance_has_grown() -> None:
    """Two edges pushed together: a flat sheet buckles any way."""
    grips = tuple(
        Grip(pins=(side,), center=(0.0, 2.2, 0.0), path=((0, 0, 0, 0), (0.5, way * 0.3, 0, 0)))
        for side, way in (("left", 1), ("right", -1))
    )
    pushed = replace(SMALL, cloth=Cloth(rows=9, columns=9, width=1.0, height=1.0, pins=()), grips=grips, wind=None)
    assert len(until_horizon(pushed, 60, 60, 1.0)) < 40
    assert len(until_horizon(SMALL, 40, 30, 1.0)) == 30


@pytest.mark.parametrize("end", [{"limit": Limit(strain=0.05)}, {"tear": Tear(strain=0.05)}])
def test_it_ends_before_a_strain_limit_acts_or_a_spring_tears(end: dict[str, Any]) -> None:
    soft = replace(SMALL, fabric=replace(SMALL.fabric, warp=10.0), **end)
    told = len(until_horizon(soft, 60, 60, 1.0))
    run = Motion(soft, 60)
    strains = []
    for _ in range(told + 1):
        run.frame()
        strains.append(run.strain)
    assert strains[-1] > 0.05 >= max(strains[:-1])


def test_steps_are_short_against_the_fastest_vibration() -> None:
    """A pair of threads: the bound is that of its only vibration, twice its square for the other end's stiffness."""
    pair = Scene(cloth=Cloth(rows=2, columns=2, width=1, height=1), fabric=Fabric(warp=10.0, weft=0, shear=0, bend=0))
    model = spring_model(pair)
    assert fastest(model) == pytest.approx(np.sqrt(2 * 5.0 / model.mass[2:].min()))


def test_what_has_none_says_why() -> None:
    assert "self-collision" in without_solution(load_scene("twist"))
    assert without_solution(SMALL) == ""
    with pytest.raises(ValueError, match="stack: self-collision"):
        solve(load_scene("stack"), 1)
