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
from taichi_cloth.geometry.tethers import tethers_of
from taichi_cloth.scene.collider_schema import Attachment, Sphere
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Forces, Scene, Solver, StrainLimit, Tearing, Tethers, Wind
from taichi_cloth.simulation.simulation import Simulation

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
    assert "weaves" in reason_unsupported(replace(SMALL, fabric=Fabric(model="weave"), solver=Solver("explicit")))
    assert reason_unsupported(load_scene("walker")) == ""
    assert reason_unsupported(SMALL) == ""
    with pytest.raises(ValueError, match="stack: self-collision"):
        solve(load_scene("stack"), 1)


def test_the_cloth_of_the_reference_is_that_of_a_sheet_typed_again() -> None:
    """Masses, energy of springs and bending, and tethers: the reference takes them from the code that builds cloth."""
    rows, columns, width, height = 4, 5, 0.8, 0.9
    dx, dy, density = width / (columns - 1), height / (rows - 1), 0.3
    cloth = Cloth(rows=rows, columns=columns, width=width, height=height, area_density=density, pins=("top",))
    fabric = Fabric(warp=90.0, weft=70.0, shear=40.0, bend_spring=2.0, bending_stiffness=0.3, bending_weft=0.2)
    model = spring_model(Scene(cloth=cloth, fabric=fabric, forces=Forces(gravity=0.0), tethers=Tethers()))
    x = model.start + 0.05 * np.random.default_rng(0).standard_normal(model.start.shape)
    at = x.T.reshape(rows, columns, 3)

    mass, energy = np.zeros((rows, columns)), 0.0
    for r, c in np.ndindex(rows - 1, columns - 1):
        halves = ((0, 0), (1, 0), (1, 1)), ((0, 0), (1, 1), (0, 1))
        if (r + c) % 2:
            halves = ((0, 0), (1, 0), (0, 1)), ((0, 1), (1, 0), (1, 1))
        for corner in (corner for half in halves for corner in half):
            mass[r + corner[0], c + corner[1]] += density * dx * dy / 6
        for a, b in (((r, c), (r + 1, c + 1)), ((r, c + 1), (r + 1, c))):
            energy += spring(40.0 * (dx / dy + dy / dx) / 2, at[a], at[b], np.hypot(dx, dy))
        twist = at[r, c] - at[r, c + 1] - at[r + 1, c] + at[r + 1, c + 1]
        energy += np.sqrt(0.3 * 0.2) * (twist @ twist) / (dx * dy)
    for r, c in np.ndindex(rows, columns):
        across = dx * (0.5 if c in (0, columns - 1) else 1.0)  # width that a thread along the column stands for [m]
        along = dy * (0.5 if r in (0, rows - 1) else 1.0)
        warp, weft = (
            90.0 + 40.0 * (1 - (dy / dx) ** 2),
            70.0 + 40.0 * (1 - (dx / dy) ** 2),
        )  # with the diagonals, C11, C22
        for step, constant in ((1, (warp, weft)), (2, (2.0, 2.0))):
            if r + step < rows:
                energy += spring(constant[0] * across / dy, at[r, c], at[r + step, c], step * dy)
            if c + step < columns:
                energy += spring(constant[1] * along / dx, at[r, c], at[r, c + step], step * dx)
        if 0 < r < rows - 1:
            energy += 0.5 * 0.3 * across * curvature(at[r - 1 : r + 2, c], dy) * dy
        if 0 < c < columns - 1:
            energy += 0.5 * 0.2 * along * curvature(at[r, c - 1 : c + 2], dx) * dx
    assert model.mass.reshape(rows, columns) == pytest.approx(mass, rel=1e-12)
    assert model.energy(x) == pytest.approx(energy, rel=1e-6)  # rest lengths are those of float32
    pins, reach = tethers_of(model.topology)
    assert pins[0].reshape(rows, columns) == pytest.approx(np.tile(np.arange(columns), (rows, 1)))
    assert reach[0].reshape(rows, columns) == pytest.approx(np.outer(np.arange(rows) * dy, np.ones(columns)))


def spring(constant: float, a: np.ndarray, b: np.ndarray, rest: float) -> float:
    return 0.5 * constant * (float(np.linalg.norm(b - a)) - rest) ** 2


def curvature(x: np.ndarray, distance: float) -> float:
    """Return the squared curvature [1/m²] of three points in a row, (3, 3), that are this far apart [m]."""
    second = (x[0] - 2 * x[1] + x[2]) / distance**2
    return float(second @ second)


# -- membranes ---------------------------------------------------------------------------------------------------------

MEMBRANE = Scene(
    cloth=Cloth(rows=7, columns=7, width=0.6, height=0.6, rotation=(-40.0, 0.0, 0.0)),
    fabric=Fabric(model="membrane", c11=300.0, c22=200.0, c12=60.0, c66=40.0, warp_angle=30.0, bending_stiffness=1e-4),
    solver=Solver("explicit", 200, 1, damping=0.5),
)


def test_a_membrane_without_damping_keeps_its_energy() -> None:
    free = replace(MEMBRANE, solver=replace(MEMBRANE.solver, damping=0.0))
    motion = Motion(free, 2 * steps_per_frame(free))
    model = motion._model
    energies = []
    for _ in range(30):
        motion.step_frame()
        energies.append(model.energy(motion.x) + 0.5 * float(model.mass @ (motion.v**2).sum(axis=0)))
    fallen = model.energy(model.start) - model.energy(motion.x)
    assert fallen > 0.1 * 9.81 * model.mass.sum() * 0.1
    assert np.ptp(energies) < 1e-3 * fallen


@pytest.mark.parametrize(
    ("damping_time", "solver"),
    [(0.0, Solver("explicit", 200, 1, damping=0.5)), (0.02, Solver("xpbd", 1000, 20, damping=0.5))],
)
def test_a_membrane_moves_as_with_a_fine_solver(damping_time: float, solver: Solver) -> None:
    """The solvers have forces of their own, in float32. `explicit` would reduce the damping."""
    scene = replace(MEMBRANE, fabric=replace(MEMBRANE.fabric, damping_time=damping_time), solver=solver)
    assert reason_unsupported(scene) == ""
    positions, _ = solve(scene, 20)
    with Simulation(scene, "serial") as simulation:
        for frame in positions:
            simulation.step()
            assert simulation.positions() == pytest.approx(frame, abs=2e-4)
        assert np.abs(simulation.positions() - simulation.topology.start).max() > 0.1
