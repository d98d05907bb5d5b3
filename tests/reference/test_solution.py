"""Horizon and uncertainty of the reference solution."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taichi_cloth import load_scene
from taichi_cloth.evaluation.reference import solution as module
from taichi_cloth.evaluation.reference.solution import (
    Motion,
    Solution,
    max_frequency,
    reason_unsupported,
    run_to_horizon,
    solve,
    steps_per_frame,
)
from taichi_cloth.geometry.spring_model import spring_model
from taichi_cloth.scene.collider_schema import Attachment, Sphere
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Scene, Solver, StrainLimit, Tearing, Wind

SMALL = Scene(
    cloth=Cloth(rows=5, columns=5, width=1.0, height=1.0, rotation=(-60.0, 0.0, 0.0)),
    fabric=Fabric(warp=100.0, weft=100.0, shear=50.0, bend_spring=1.0),
    solver=Solver(damping=1.0),
    wind=Wind(x=1.0, turbulence=1.0),
)


def test_the_uncertainty_bounds_the_error() -> None:
    positions, coarser = solve(SMALL, 10)
    solution = Solution(positions, coarser, 1.0)
    finest = Motion(SMALL, 16 * steps_per_frame(SMALL))
    truth = np.array([finest.step_frame() for _ in range(10)])
    error = np.sqrt(((positions - truth) ** 2).sum(axis=2).mean())
    rms, most = solution.uncertainty
    assert 0 < error < rms < most < 1e-4
    assert rms / error == pytest.approx(3, rel=0.3)  # second order: at half the step, a third of the difference


def test_the_horizon_ends_where_a_disturbance_has_grown() -> None:
    """Two edges are pushed together: a flat sheet may buckle to either side."""
    attachments = tuple(
        Attachment(pins=(side,), center=(0.0, 2.2, 0.0), keyframes=((0, 0, 0, 0), (0.5, sign * 0.3, 0, 0)))
        for side, sign in (("left", 1), ("right", -1))
    )
    pushed = replace(
        SMALL, cloth=Cloth(rows=9, columns=9, width=1.0, height=1.0, pins=()), attachments=attachments, wind=None
    )
    assert len(run_to_horizon(pushed, 60, 60, 1.0)) < 40
    assert len(run_to_horizon(SMALL, 40, 30, 1.0)) == 30


def test_the_horizon_is_the_last_frame_before_a_disturbance_has_grown_a_hundredfold(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From 1e-9 of the side to 1e-7, here by 2 % in each frame."""
    growth, side = 1.02, 3.0
    first: list[float] = []

    class Growing:
        """A motion without strain, whose start grows."""

        strain = 0.0

        def __init__(self, scene: Scene, steps: int, shake: np.ndarray | float = 0.0) -> None:
            self.x = np.zeros((3, 25)) + shake
            first.append(float(np.sqrt((self.x**2).sum(axis=0).mean())))

        def step_frame(self) -> np.ndarray:
            self.x = growth * self.x
            return self.x.T

    monkeypatch.setattr(module, "Motion", Growing)
    horizon = len(run_to_horizon(SMALL, 1, 10_000, side))
    undisturbed, disturbed = first
    assert undisturbed == 0
    assert disturbed / side == pytest.approx(np.sqrt(3) * 1e-9, rel=0.2)  # 1e-9 along each axis
    assert disturbed * growth**horizon <= 1e-7 * side < disturbed * growth ** (horizon + 1)


@pytest.mark.parametrize("end", [{"strain_limit": StrainLimit(strain=0.05)}, {"tearing": Tearing(strain=0.05)}])
def test_the_horizon_ends_before_a_strain_limit_acts_or_a_spring_tears(end: dict[str, Any]) -> None:
    soft = replace(SMALL, fabric=replace(SMALL.fabric, warp=10.0), **end)
    horizon = len(run_to_horizon(soft, 60, 60, 1.0))
    run = Motion(soft, 60)
    strains = []
    for _ in range(horizon + 1):
        run.step_frame()
        strains.append(run.strain)
    assert strains[-1] > 0.05 >= max(strains[:-1])


def test_steps_are_short_against_the_fastest_vibration() -> None:
    """For a pair of springs: the bound is its only frequency, with twice the stiffness for the other end."""
    pair = Scene(
        cloth=Cloth(rows=2, columns=2, width=1, height=1), fabric=Fabric(warp=10.0, weft=0, shear=0, bend_spring=0)
    )
    model = spring_model(pair)
    assert max_frequency(model) == pytest.approx(np.sqrt(2 * 5.0 / model.mass[2:].min()))


@pytest.mark.parametrize(("distance", "supported"), [(0.21, False), (0.23, True)])
def test_cloth_that_starts_inside_a_margin_has_no_reference_solution(distance: float, supported: bool) -> None:
    """The ball and its margin have a radius of 0.22 m together."""
    upright = replace(SMALL.cloth, rotation=(0.0, 0.0, 0.0))
    ball = Sphere(center=(0.0, upright.center[1], distance), radius=0.2, margin=0.02, friction=0.0)
    reason = reason_unsupported(replace(SMALL, cloth=upright, spheres=(ball,)))
    assert ("starts inside" in reason) is not supported
    assert (reason == "") is supported


def test_scenes_without_a_reference_solution_give_the_reason() -> None:
    assert "self-collision" in reason_unsupported(load_scene("twist"))
    assert "clip" in reason_unsupported(load_scene("walker"))
    assert reason_unsupported(SMALL) == ""
    with pytest.raises(ValueError, match="stack: self-collision"):
        solve(load_scene("stack"), 1)
