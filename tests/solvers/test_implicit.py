"""`implicit` compared with its steps solved in float64, and with closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.geometry.cloth_builder import spring_stiffness
from taichi_cloth.geometry.topology import Topology
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.presets import with_fabric
from taichi_cloth.scene.schema import Cloth, Ground, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers import LAYOUTS
from taichi_cloth.solvers.two_stage import GAMMA


def soft(iterations: int) -> Scene:
    return Scene(
        cloth=Cloth(rows=6, columns=9, width=0.8, height=0.5, center=(0.0, 0.0, 0.0), pins=("top-left", "top-right")),
        fabric=Fabric(warp=60.0, weft=40.0, shear=20.0, bend_spring=1.0),
        solver=Solver(name="implicit", substeps=1, iterations=iterations, damping=0.0),
    )


def residual(topology: Topology, stiffness: np.ndarray, x: np.ndarray, y: np.ndarray, h: float) -> np.ndarray:
    """Return h²·f(x) − M·(x − y) [kg·m]."""
    a, b = topology.ends.T
    gap = x[b] - x[a]
    norm = np.linalg.norm(gap, axis=1)
    pull = (stiffness * (norm - topology.rest) / norm)[:, None] * gap
    result = topology.mass[:, None] * (y - x)
    np.add.at(result, a, h**2 * pull)
    np.add.at(result, b, -(h**2) * pull)
    return result


def matrix(topology: Topology, stiffness: np.ndarray, x: np.ndarray, h: float) -> np.ndarray:
    """Return M + h²K [kg] at positions x, (3·particles, 3·particles). A shortened spring has no stiffness across."""
    a, b = topology.ends.T
    gap = x[b] - x[a]
    norm = np.linalg.norm(gap, axis=1)
    n = gap / norm[:, None]
    outer = n[:, :, None] * n[:, None, :]
    across = np.maximum(0.0, 1 - topology.rest / norm)[:, None, None]
    blocks = h**2 * stiffness[:, None, None] * (outer + across * (np.eye(3) - outer))
    hessian = np.zeros((len(x), len(x), 3, 3))
    for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
        np.add.at(hessian, (i, j), sign * blocks)
    return hessian.transpose(0, 2, 1, 3).reshape(3 * len(x), -1) + np.diag(np.repeat(topology.mass, 3))


def backward_euler(
    topology: Topology, stiffness: np.ndarray, x: np.ndarray, v: np.ndarray, h: float, driven: dict[int, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and velocities after one step, M·(x − y) = h²·f(x). `driven`: positions of driven particles."""
    free = ~topology.pinned
    y = x + h * v + h**2 * np.array([0, -9.81, 0])
    y[~free] = x[~free]
    for i, position in driven.items():
        free[i], y[i] = False, position
    new = y.copy()
    loose = np.repeat(free, 3)
    for _ in range(50):
        left = residual(topology, stiffness, new, y, h).reshape(-1)[loose]
        way = np.zeros(3 * len(new))
        way[loose] = np.linalg.solve(matrix(topology, stiffness, new, h)[np.ix_(loose, loose)], left)
        new = new + way.reshape(-1, 3)
        if np.abs(way).max() < 1e-12:
            return new, (new - x) / h
    raise AssertionError("Newton's method did not converge")


def two_stage_step(
    simulation: Simulation, x0: np.ndarray, v0: np.ndarray, targets: dict[int, np.ndarray]
) -> np.ndarray:
    """Return the positions after a frame of one substep (Alexander 1977). `targets`: of grabbed particles."""
    topology, h = simulation.topology, 1 / 60
    stiffness = spring_stiffness(simulation.scene, "fabric", topology)

    def driven(fraction: float) -> dict[int, np.ndarray]:
        return {i: x0[i] + (target - x0[i]) * fraction for i, target in targets.items()}

    _, v1 = backward_euler(topology, stiffness, x0, v0, GAMMA * h, driven(GAMMA))
    middle = x0 + (1 - GAMMA) * h * v1
    velocities = v0 + (v1 - v0) * (1 - GAMMA) / GAMMA
    return backward_euler(topology, stiffness, middle, velocities, GAMMA * h, driven(1.0))[0]


def thrown(simulation: Simulation, speed: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Set random velocities [m/s]. Return positions and velocities as the simulation has them."""
    x0 = simulation.positions()
    v0 = np.random.default_rng(2).normal(0.0, speed, x0.shape).astype(np.float32).astype(np.float64)
    v0[simulation.topology.pinned] = 0
    simulation.solver.set_velocities(v0, 1 / 60)
    return x0, v0


@pytest.mark.parametrize("grabbed", [False, True])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_many_iterations_converge_to_the_two_stage_step(layout: str, grabbed: bool) -> None:
    with Simulation(soft(50), layout) as simulation:
        x0, v0 = thrown(simulation)
        targets = {22: x0[22] + [0.01, -0.02, 0.05]} if grabbed else {}
        for i, target in targets.items():
            simulation.grab(i).move_to(target)
        simulation.step()
        expected = two_stage_step(simulation, x0, v0, targets)
        assert np.abs(expected - x0).max() > 0.01
        assert simulation.positions() == pytest.approx(expected, abs=2e-6 * simulation.scene.cloth.width)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_second_iteration_is_much_closer_to_the_solution(layout: str) -> None:
    distances = []
    for iterations in (1, 2):
        with Simulation(soft(iterations), layout) as simulation:
            x0, v0 = thrown(simulation)
            simulation.step()
            distances.append(np.abs(simulation.positions() - two_stage_step(simulation, x0, v0, {})).mean())
    assert distances[1] < 0.25 * distances[0]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_an_iteration_takes_more_steps_where_particles_move_far(layout: str) -> None:
    """In a substep particles move by more than the 0.1 m of a spring. One step alone is off by 27 % of that."""
    with Simulation(soft(1), layout) as simulation:
        x0, v0 = thrown(simulation, 6.0)
        simulation.step()
        expected = two_stage_step(simulation, x0, v0, {})
        moved = np.abs(expected - x0).max()
        assert moved > 0.1
        assert np.abs(simulation.positions() - expected).max() < 0.1 * moved


def solution_of_a_stage(simulation: Simulation, x0: np.ndarray, v0: np.ndarray) -> tuple[float, np.ndarray]:
    """Run a frame of one substep and one iteration, and look at its second stage, which moves particles from y by δ.

    Return the norm of h²·f(y) − (M + h²K)·δ relative to that of h²·f(y), for free particles, and δ [m]. The norm is
    that of conjugate gradients: squares over mass.
    """
    topology, frame = simulation.topology, 1 / 60
    h, free = GAMMA * frame, ~topology.pinned
    simulation.step()
    x, v = simulation.positions(), simulation.velocities()
    middle = x - h * v  # where the second stage begins
    v1 = (middle - x0) / ((1 - GAMMA) * frame)
    before = v0 + (v1 - v0) * (1 - GAMMA) / GAMMA
    y = middle + (h * before + h**2 * np.array([0, -9.81, 0])) * free[:, None]
    stiffness = spring_stiffness(simulation.scene, "fabric", topology)
    right = residual(topology, stiffness, y, y, h)
    way = x - y
    left = right - (matrix(topology, stiffness, y, h) @ way.reshape(-1)).reshape(-1, 3)

    def norm(residual: np.ndarray) -> float:
        return float(np.sqrt((residual[free] ** 2 / topology.mass[free, None]).sum()))

    return norm(left) / norm(right), way


@pytest.mark.parametrize("pins", [("top-left", "top-right"), ()])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_an_iteration_solves_its_linear_system_and_conserves_momentum(layout: str, pins: tuple[str, ...]) -> None:
    scene = soft(1)
    with Simulation(replace(scene, cloth=replace(scene.cloth, pins=pins)), layout) as simulation:
        left, way = solution_of_a_stage(simulation, *thrown(simulation))
        assert left < 1.1 * 0.01
        if not pins:
            mass = simulation.topology.mass
            assert np.abs(mass @ way).max() < 1e-5 * (mass @ np.abs(way)).max()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_shortened_springs_have_no_stiffness_across_their_direction(layout: str) -> None:
    """The sheet shrinks to half its size, in one step of Newton's method. Negative stiffness would leave 1.9 %."""
    scene = soft(1)
    softer = replace(scene.fabric, warp=1.0, weft=1.0, shear=1.0, bend_spring=0.2)
    with Simulation(replace(scene, fabric=softer), layout) as simulation:
        x0, v0 = thrown(simulation, 0.05)
        v0 -= 25.0 * (x0 - x0.mean(axis=0)) * ~simulation.topology.pinned[:, None]
        simulation.solver.set_velocities(v0, 1 / 60)
        simulation.solver.layout.cg.linear_range[None] = 1e3
        left, _ = solution_of_a_stage(simulation, x0, v0)
        assert left < 1.1 * 0.01


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_error_falls_with_the_square_of_the_substep_in_short_steps_too(layout: str) -> None:
    """With one iteration: what conjugate gradients leave must fall as fast. Left at 1 %, the error would stay."""
    cloth = Cloth(12, 12, 0.8, 0.8, rotation=(-90.0, 0.0, 0.0), area_density=0.2, pins=("top-left", "top-right"))
    fabric = Fabric(warp=300.0, weft=300.0, shear=100.0, bend_spring=0.0, bending_stiffness=1e-4)

    def after_half_a_second(solver: Solver, layout: str) -> np.ndarray:
        with Simulation(Scene(cloth=cloth, fabric=fabric, solver=solver), layout) as simulation:
            simulation.step(30)
            return simulation.positions()

    exact = after_half_a_second(Solver("rk4", 100, 1, damping=0.0), "serial")
    found = [after_half_a_second(Solver("implicit", substeps, 1, damping=0.0), layout) for substeps in (20, 40)]
    errors = [np.sqrt(((x - exact) ** 2).mean()) for x in found]
    assert errors[1] < errors[0] / 3


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_strip_that_is_folded_back_comes_to_rest(layout: str) -> None:
    """A few stiff cells go around the fold. Newton's method must not end too early there."""
    cells, length, radius = 40, 0.2, 0.01
    cloth = Cloth(3, cells + 1, length, 0.02, rotation=(-90.0, 0.0, 0.0), area_density=0.2, pins=())
    scene = Scene(
        cloth=cloth,
        solver=Solver("implicit", 20, 1, damping=3.0),
        ground=Ground(height=0.0, margin=0.002, friction=1.0),
    )
    scene = with_fabric(scene, "cotton", scene)
    along = np.linspace(0.0, length, cells + 1)
    straight = (length - np.pi * radius) / 2
    angle = np.clip((along - straight) / radius, 0.0, np.pi)
    beyond = np.maximum(along - straight - np.pi * radius, 0.0)
    with Simulation(scene, layout) as simulation:
        x = simulation.positions().reshape(3, cells + 1, 3)
        x[..., 0] = np.minimum(along, straight) + radius * np.sin(angle) - beyond
        x[..., 1] = 0.003 + radius * (1 - np.cos(angle))
        simulation.set_state(x.reshape(-1, 3))
        simulation.step(60)
        assert np.linalg.norm(simulation.velocities(), axis=1).max() < 0.2
