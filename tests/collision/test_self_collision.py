"""Self-collision."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from taichi_cloth.collision.self_collision import DEPTH_UNITS, MAX_SEPARATION_SPEED, count_intersections
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene.collider_schema import Ground
from taichi_cloth.scene.fabric_schema import VerletSprings
from taichi_cloth.scene.schema import Cloth, Forces, Scene, SelfCollision, Solver
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers import SOLVERS

Floats = NDArray[np.float64]
FREE = Solver(name="verlet", substeps=1, iterations=1, damping=0.0)
NO_SPRINGS = VerletSprings(structural=0.0, shear=0.0, bend=0.0)


def loose(thickness: float = 0.1, **keys: Any) -> Scene:
    """Return two rows of nine particles 1 m apart, without spring forces and gravity."""
    return Scene(
        cloth=Cloth(rows=2, columns=9, width=8.0, height=1.0, mass_lumping="uniform", pins=()),
        verlet=NO_SPRINGS,
        solver=FREE,
        forces=Forces(gravity=0.0),
        self_collision=SelfCollision(thickness=thickness, **keys),
    )


def far_apart(count: int) -> Floats:
    """Return positions of particles that touch nothing."""
    return np.array([[10.0 * k, 50.0, 0.0] for k in range(count)])


def test_approaching_particles_stop_a_thickness_apart() -> None:
    x = far_apart(18)
    x[3], x[12] = (0.0, 0.0, 0.0), (0.11, 0.0, 0.0)
    v = np.zeros_like(x)
    v[3], v[12] = (3.0, 0.0, 0.0), (-3.0, 0.0, 0.0)  # 0.05 m each in a frame
    with Simulation(loose(friction=0.0), "serial") as simulation:
        simulation.set_state(x, v)
        simulation.step()
        gap = simulation.positions()[12] - simulation.positions()[3]
        assert gap == pytest.approx([0.1, 0.0, 0.0], abs=1e-6)
        assert simulation.velocities()[[3, 12], 0].sum() == pytest.approx(0.0, abs=1e-5)
        simulation.step()
        assert np.linalg.norm(simulation.positions()[12] - simulation.positions()[3]) >= 0.1 - 1e-6


def test_a_particle_that_passed_through_another_is_moved_back() -> None:
    x = far_apart(18)
    x[3], x[12] = (0.0, 0.0, 0.0), (0.11, 0.0, 0.0)
    v = np.zeros_like(x)
    v[12, 0] = -9.0  # 0.15 m: 0.04 m past the other
    with Simulation(loose(friction=0.0), "serial") as simulation:
        simulation.set_state(x, v)
        simulation.step()
        gap = simulation.positions()[12] - simulation.positions()[3]
    assert gap == pytest.approx([0.1, 0.0, 0.0], abs=1e-6)


def test_particles_too_close_at_the_start_are_separated_slowly() -> None:
    x = far_apart(18)
    x[3], x[12] = (0.0, 0.0, 0.0), (0.01, 0.0, 0.0)
    with Simulation(loose(), "serial") as simulation:
        simulation.set_state(x)
        simulation.step()
        gap = simulation.positions()[12] - simulation.positions()[3]
        assert gap[0] == pytest.approx(0.01 + MAX_SEPARATION_SPEED / 60, abs=1e-6)
        for _ in range(30):
            simulation.step()
        assert simulation.positions()[12, 0] - simulation.positions()[3, 0] > 0.1


def test_friction_stops_sliding_along_a_contact() -> None:
    """With a correction of 0.05 m and friction 0.5, up to 0.025 m of sliding is removed; it slides by 0.0033 m."""
    x = far_apart(18)
    x[3], x[12] = (0.0, 0.0, 0.0), (0.1, 0.0, 0.0)
    v = np.zeros_like(x)
    v[12] = (-3.0, 0.0, 0.2)
    speeds = {}
    for friction in (0.0, 0.5):
        with Simulation(loose(friction=friction), "serial") as simulation:
            simulation.set_state(x, v)
            simulation.step()
            speeds[friction] = simulation.velocities()[12, 2] - simulation.velocities()[3, 2]
    assert speeds[0.0] > 0.19
    assert speeds[0.5] == pytest.approx(0.0, abs=0.02)


@pytest.mark.bounds
@settings(max_examples=25)
@given(st.integers(0, 2**31), st.floats(0.2, 3.0))
def test_the_broad_phase_finds_all_pairs(seed: int, spread: float) -> None:
    """Compare depths, summed in units of the thickness. Some examples overflow the candidate list."""
    random = np.random.default_rng(seed)
    scene = replace(loose(0.1), cloth=Cloth(rows=20, columns=30, width=29.0, height=19.0, pins=()))
    x = (random.uniform(-0.5, 0.5, (600, 3)) * spread).astype(np.float32).astype(np.float64)
    with Simulation(scene, "serial") as simulation:
        simulation.set_state(x)
        simulation.step()
        data = simulation.cloth.self_contact
        assert data is not None
        depths, deepest = data.depth_sum.to_numpy()[:600], data.max_depth.to_numpy()[:600]
    by_pair = np.maximum(0.1 - np.linalg.norm(x[:, None] - x[None], axis=2), 0) / 0.1 * DEPTH_UNITS
    np.fill_diagonal(by_pair, 0)
    unit = 1 + 5e-7 / 0.1 * DEPTH_UNITS  # whole units, of float32 distances between points within 3 m
    rounding = 1 + unit * (by_pair > 0).sum(axis=1)
    assert (np.abs(depths - by_pair.sum(axis=1)) <= rounding).all()
    assert (np.abs(deepest - by_pair.max(axis=1)) <= unit).all()


def folded(primitives: str, solver: str = "verlet") -> Scene:
    """Return a strip that is dropped on its edge and folds."""
    return Scene(
        cloth=Cloth(rows=30, columns=9, width=0.24, height=0.87, center=(0.0, 0.5, 0.0), rotation=(4, 0, 0), pins=()),
        verlet=VerletSprings(bend=0.05),
        solver=Solver(solver, *SOLVER_CATALOG[solver].defaults),
        self_collision=SelfCollision(thickness=0.03 if primitives == "particles" else 0.01, primitives=primitives),
        ground=Ground(),
    )


@pytest.mark.parametrize("primitives", [pytest.param("particles", marks=pytest.mark.long), "triangles"])
@pytest.mark.parametrize("layout", [pytest.param("simd", marks=pytest.mark.bounds), "parallel"])
def test_folds_in_a_layout_match_the_serial_layout(layout: str, primitives: str) -> None:
    scene = folded(primitives)
    with Simulation(scene, "serial") as serial, Simulation(scene, layout) as other:
        start = serial.topology.start
        serial.set_state(start, (0.0, -3.0, 0.0))  # fast: with index checks a frame takes 5 s
        for _ in range(12):
            serial.step()
        for _ in range(2):
            for name in ("x", "x_prev"):
                getattr(other.cloth, name).copy_from(getattr(serial.cloth, name))
            # Self-contact pushed particles below the margin of the ground: a new simulation lets them out slowly.
            other.depenetration.reduction = serial.depenetration.reduction.copy()
            for simulation in (serial, other):
                simulation.step()
            assert other.positions() == pytest.approx(serial.positions(), abs=1e-5)
        for simulation in (serial, other):
            data = simulation.solver.layout.self_contact
            assert data is not None
            assert (data.depth_sum.to_numpy()[data.particle.to_numpy()[:270]] > 0).sum() > 20


def layer_gap(simulation: Simulation) -> float:
    """Return the smallest distance of two particles that are not neighbors on the flat sheet [m]."""
    x, flat = simulation.positions(), simulation.topology.flat
    distance = np.linalg.norm(x[:, None] - x[None], axis=2)
    apart = np.linalg.norm(flat[:, None] - flat[None], axis=2) > 2.5 * 0.03
    return float(distance[apart].min())


def least_gap(scene: Scene, frames: int) -> tuple[float, int]:
    """Return the smallest gap in all frames after first contact [m], and the intersections at the end."""
    least = np.inf
    with Simulation(scene, "serial") as simulation:
        for frame in range(frames):
            simulation.step()
            if frame > 20:
                least = min(least, layer_gap(simulation))
        return least, simulation.intersections()


@pytest.mark.parametrize(
    "solver",
    [pytest.param("explicit", marks=pytest.mark.bounds), "verlet"]
    + [pytest.param(s, marks=pytest.mark.long) for s in SOLVERS if s not in ("verlet", "explicit")],
)
def test_folds_do_not_penetrate_each_other(solver: str) -> None:
    gap, intersections = least_gap(folded("particles", solver), 70)
    assert gap > 0.6 * 0.03
    assert intersections == 0


def test_folds_penetrate_each_other_without_self_collision() -> None:
    gap, intersections = least_gap(replace(folded("particles"), self_collision=None), 70)
    assert gap < 0.1 * 0.03
    assert intersections > 10


def test_a_ball_on_a_stack_does_not_pass_through_the_sheets() -> None:
    """If particles are separated too slowly, a thousand edges pass through the sheets below within a second."""
    with Simulation(load_scene("stack")) as simulation:
        for _ in range(55):
            simulation.step()
        assert simulation.intersections() < 20


def test_intersections_are_counted() -> None:
    """A sheet whose last column passes through its first cell."""
    scene = Scene(cloth=Cloth(rows=2, columns=6, width=5.0, height=1.0, pins=()), self_collision=SelfCollision())
    with Simulation(scene) as simulation:
        x = simulation.topology.flat.copy()
        simulation.set_state(x)
        assert simulation.metrics().intersections == 0
        # The last column's two particles are on either side of the first cell: the edge between them passes through it.
        x[5], x[11] = x[0] + [0.3, -0.2, 0.5], x[0] + [0.35, -0.25, -0.5]
        simulation.set_state(x)
        brute = brute_force_intersections(x, simulation.topology.edges, simulation.topology.triangles)
        assert brute >= 1
        assert (
            simulation.metrics().intersections
            == simulation.intersections()
            == count_intersections(simulation.cloth)
            == brute
        )


def brute_force_intersections(x: Floats, edges: NDArray[np.int32], triangles: NDArray[np.int32]) -> int:
    """By solving p + s·(q − p) = a + u·(b − a) + v·(c − a) for each pair."""
    count = 0
    for i, j in edges:
        for triangle in triangles:
            if i in triangle or j in triangle:
                continue
            a, b, c = x[triangle]
            matrix = np.column_stack([x[j] - x[i], a - b, a - c])
            if abs(np.linalg.det(matrix)) < 1e-12:
                continue
            s, u, v = np.linalg.solve(matrix, a - x[i])
            count += bool(0 < s < 1 and u > 0 and v > 0 and u + v < 1)
    return count


@pytest.mark.bounds
@settings(max_examples=20)
@given(st.integers(0, 2**31))
def test_intersections_match_brute_force(seed: int) -> None:
    """A crumpled sheet whose edges are no longer than at rest."""
    random = np.random.default_rng(seed)
    scene = Scene(cloth=Cloth(rows=6, columns=6, width=1.0, height=1.0, pins=()), self_collision=SelfCollision())
    with Simulation(scene) as simulation:
        x = random.uniform(-0.08, 0.08, (36, 3)).astype(np.float32).astype(np.float64)
        simulation.set_state(x)
        assert simulation.intersections() == brute_force_intersections(
            x, simulation.topology.edges, simulation.topology.triangles
        )


def test_metrics_loading_and_reset_do_not_change_the_simulation(tmp_path: Path) -> None:
    """Candidate lists and hashes are not part of the state of a cloth."""
    with Simulation(folded("particles"), "serial") as simulation:
        seen = []
        for again in range(3):
            for frame in range(45):
                simulation.step()
                if again == 1:
                    simulation.metrics()
                if again == 2 and frame == 30:
                    simulation.save(tmp_path / "save.npz")
                    simulation.reset()
                    simulation.step()
                    simulation.load(tmp_path / "save.npz")
            seen.append(simulation.positions().tobytes())
            simulation.reset()
    assert seen[0] == seen[1] == seen[2]
