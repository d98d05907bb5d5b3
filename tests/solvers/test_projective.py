"""`projective` compared with backward Euler solved by Newton's method in float64, and with closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.geometry.cloth_builder import spring_stiffness
from taichi_cloth.scene.schema import Cloth, Fabric, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers import LAYOUTS


def soft(iterations: int) -> Scene:
    return Scene(
        cloth=Cloth(rows=6, columns=9, width=0.8, height=0.5, center=(0.0, 0.0, 0.0), pins=("top-left", "top-right")),
        fabric=Fabric(warp=60.0, weft=40.0, shear=20.0, bend_spring=1.0),
        solver=Solver(name="projective", substeps=1, iterations=iterations, damping=0.0),
    )


def backward_euler(
    simulation: Simulation, x0: np.ndarray, v0: np.ndarray, targets: dict[int, np.ndarray]
) -> np.ndarray:
    """Return the positions a frame later, M·(x − y) = h²·f(x), by Newton's method. `targets`: of grabbed particles."""
    topology, h = simulation.topology, 1 / 60
    stiffness = spring_stiffness(simulation.scene, "fabric", topology)
    a, b = topology.ends.T
    free = ~topology.pinned
    y = x0 + h * v0 + h**2 * np.array([0, -9.81, 0])
    y[~free] = x0[~free]
    for i, target in targets.items():
        free[i], y[i] = False, target
    x = y.copy()
    loose = np.repeat(free, 3)
    for _ in range(50):
        gap = x[b] - x[a]
        long = np.linalg.norm(gap, axis=1)
        n = gap / long[:, None]
        pull = (stiffness * (long - topology.rest))[:, None] * n
        left = topology.mass[:, None] * (y - x)
        np.add.at(left, a, h**2 * pull)
        np.add.at(left, b, -(h**2) * pull)
        # Without the transverse stiffness of shortened springs, which could make the matrix indefinite.
        slack = np.maximum(0.0, 1 - topology.rest / long)[:, None, None]
        outer = n[:, :, None] * n[:, None, :]
        blocks = h**2 * stiffness[:, None, None] * (outer + slack * (np.eye(3) - outer))
        hessian = np.zeros((len(x), len(x), 3, 3))
        for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
            np.add.at(hessian, (i, j), sign * blocks)
        matrix = hessian.transpose(0, 2, 1, 3).reshape(3 * len(x), -1) + np.diag(np.repeat(topology.mass, 3))
        way = np.zeros(3 * len(x))
        way[loose] = np.linalg.solve(matrix[np.ix_(loose, loose)], left.reshape(-1)[loose])
        x = x + way.reshape(-1, 3)
        if np.abs(way).max() < 1e-12:
            return x
    raise AssertionError("Newton's method did not converge")


@pytest.mark.parametrize("grabbed", [False, True])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_many_iterations_converge_to_backward_euler(layout: str, grabbed: bool) -> None:
    with Simulation(soft(600), layout) as simulation:
        x0 = simulation.positions()
        v0 = np.random.default_rng(2).normal(0.0, 0.5, x0.shape).astype(np.float32).astype(np.float64)
        v0[simulation.topology.pinned] = 0
        simulation.solver.set_velocities(v0, 1 / 60)
        targets = {22: x0[22] + [0.01, -0.02, 0.05]} if grabbed else {}
        for i, target in targets.items():
            simulation.grab(i).move_to(target)
        simulation.step()
        expected = backward_euler(simulation, x0, v0, targets)
        assert np.abs(expected - x0).max() > 0.01
        assert simulation.positions() == pytest.approx(expected, abs=1e-4 * simulation.scene.cloth.width)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_ten_iterations_are_closer_to_backward_euler_than_one(layout: str) -> None:
    distances = []
    for iterations in (1, 10):
        with Simulation(soft(iterations), layout) as simulation:
            x0 = simulation.positions()
            v0 = np.random.default_rng(2).normal(0.0, 0.5, x0.shape)
            v0[simulation.topology.pinned] = 0
            simulation.solver.set_velocities(v0, 1 / 60)
            simulation.step()
            distances.append(np.abs(simulation.positions() - backward_euler(simulation, x0, v0, {})).mean())
    assert distances[1] < 0.25 * distances[0]


@pytest.mark.parametrize("pins", [("top-left", "top-right"), ()])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_an_iteration_solves_its_linear_system_and_conserves_momentum(layout: str, pins: tuple[str, ...]) -> None:
    """(M + h²L)·δ = h²·f(y) to a hundredth, in the norm of the conjugate gradient method: squares over mass."""
    scene = soft(1)
    with Simulation(replace(scene, cloth=replace(scene.cloth, pins=pins)), layout) as simulation:
        topology, h = simulation.topology, 1 / 60
        a, b = topology.ends.T
        x0, free = simulation.positions(), ~topology.pinned
        v0 = np.random.default_rng(2).normal(0.0, 0.5, x0.shape) * free[:, None]
        simulation.solver.set_velocities(v0, h)
        simulation.step()
        stiffness = spring_stiffness(simulation.scene, "fabric", topology)
        y = x0 + (h * v0 + h**2 * np.array([0, -9.81, 0])) * free[:, None]
        gap = y[b] - y[a]
        long = np.linalg.norm(gap, axis=1)
        pull = (stiffness * (long - topology.rest) / long)[:, None] * gap
        right = np.zeros_like(y)
        np.add.at(right, a, h**2 * pull)
        np.add.at(right, b, -(h**2) * pull)
        matrix = np.diag(topology.mass)
        for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
            np.add.at(matrix, (i, j), sign * h**2 * stiffness)
        way = simulation.positions() - y
        left = (right - matrix @ way)[free]

        def norm(residual: np.ndarray) -> float:
            return float(np.sqrt((residual**2 / topology.mass[free, None]).sum()))

        assert norm(left) < 0.011 * norm(right[free])
        if not pins:
            moved = topology.mass @ way
            assert np.abs(moved).max() < 1e-6 * (topology.mass @ np.abs(way)).max()
