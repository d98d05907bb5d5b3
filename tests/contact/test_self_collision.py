"""A cloth that keeps off itself."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from taichi_cloth.contact.crossings import crossings
from taichi_cloth.contact.self_collision import APART
from taichi_cloth.scene import load_scene
from taichi_cloth.scene.model import USUAL, Cloth, Forces, Ground, Scene, SelfCollision, Solver, Springs
from taichi_cloth.simulation import Simulation
from taichi_cloth.solvers import SOLVERS

Floats = NDArray[np.float64]
FREE = Solver(name="verlet", substeps=1, iterations=1, damping=0.0)
NO_SPRINGS = Springs(structural=0.0, shear=0.0, bend=0.0)


def loose(thickness: float = 0.1, **keys: object) -> Scene:
    """Two rows of nine particles 1 m apart that nothing joins, nor pulls."""
    return Scene(
        cloth=Cloth(rows=2, columns=9, width=8.0, height=1.0, lumping="equal", pins=()),
        springs=NO_SPRINGS,
        solver=FREE,
        forces=Forces(gravity=0.0),
        self_collision=SelfCollision(thickness=thickness, **keys),
    )


def far_apart(count: int) -> Floats:
    """Places of particles that touch nothing."""
    return np.array([[10.0 * k, 50.0, 0.0] for k in range(count)])


def test_two_particles_that_come_near_are_stopped_a_thickness_apart() -> None:
    x = far_apart(18)
    x[3], x[12] = (0.0, 0.0, 0.0), (0.11, 0.0, 0.0)
    v = np.zeros_like(x)
    v[3], v[12] = (3.0, 0.0, 0.0), (-3.0, 0.0, 0.0)  # 0.05 m each in a frame
    with Simulation(loose(friction=0.0), "list") as simulation:
        simulation.place(x, v)
        simulation.advance_frame()
        gap = simulation.positions()[12] - simulation.positions()[3]
        assert gap == pytest.approx([0.1, 0.0, 0.0], abs=1e-6)
        assert simulation.velocities()[[3, 12], 0].sum() == pytest.approx(0.0, abs=1e-5)
        simulation.advance_frame()
        assert np.linalg.norm(simulation.positions()[12] - simulation.positions()[3]) >= 0.1 - 1e-6


def test_what_went_through_is_brought_back_to_its_side() -> None:
    x = far_apart(18)
    x[3], x[12] = (0.0, 0.0, 0.0), (0.11, 0.0, 0.0)
    v = np.zeros_like(x)
    v[12, 0] = -9.0  # 0.15 m: 0.04 m past the other
    with Simulation(loose(friction=0.0), "list") as simulation:
        simulation.place(x, v)
        simulation.advance_frame()
        gap = simulation.positions()[12] - simulation.positions()[3]
    assert gap == pytest.approx([0.1, 0.0, 0.0], abs=1e-6)


def test_what_lies_too_near_at_the_start_is_parted_slowly() -> None:
    x = far_apart(18)
    x[3], x[12] = (0.0, 0.0, 0.0), (0.01, 0.0, 0.0)
    with Simulation(loose(), "list") as simulation:
        simulation.place(x)
        simulation.advance_frame()
        gap = simulation.positions()[12] - simulation.positions()[3]
        assert gap[0] == pytest.approx(0.01 + APART / 60, abs=1e-6)
        for _ in range(30):
            simulation.advance_frame()
        assert simulation.positions()[12, 0] - simulation.positions()[3, 0] > 0.1


def test_friction_stops_what_slides_along_a_contact() -> None:
    """Pressed by 0.05 m, friction 0.5 may take 0.025 m; it slides by 0.0033 m. Without, the push is nearly across."""
    x = far_apart(18)
    x[3], x[12] = (0.0, 0.0, 0.0), (0.1, 0.0, 0.0)
    v = np.zeros_like(x)
    v[12] = (-3.0, 0.0, 0.2)
    speeds = {}
    for friction in (0.0, 0.5):
        with Simulation(loose(friction=friction), "list") as simulation:
            simulation.place(x, v)
            simulation.advance_frame()
            speeds[friction] = simulation.velocities()[12, 2] - simulation.velocities()[3, 2]
    assert speeds[0.0] > 0.19
    assert speeds[0.5] == pytest.approx(0.0, abs=0.02)


@settings(max_examples=25)
@given(st.integers(0, 2**31), st.floats(0.2, 3.0))
def test_the_hash_finds_the_pairs_of_brute_force(seed: int, spread: float) -> None:
    """By depths, which are summed in 4096ths of the thickness. Some draws have more pairs than the list has rows."""
    random = np.random.default_rng(seed)
    scene = replace(loose(0.1), cloth=Cloth(rows=20, columns=30, width=29.0, height=19.0, pins=()))
    x = (random.uniform(-0.5, 0.5, (600, 3)) * spread).astype(np.float32).astype(np.float64)
    with Simulation(scene, "list") as simulation:
        simulation.place(x)
        simulation.advance_frame()
        near = simulation.cloth.near
        depths, deepest = near.depths.to_numpy()[:600], near.deepest.to_numpy()[:600]
    by_pair = np.maximum(0.1 - np.linalg.norm(x[:, None] - x[None], axis=2), 0) / 0.1 * 4096
    np.fill_diagonal(by_pair, 0)
    rounding = 1 + (by_pair > 0).sum(axis=1)
    assert (np.abs(depths - by_pair.sum(axis=1)) <= rounding).all()
    assert (np.abs(deepest - by_pair.max(axis=1)) <= 1.1).all()


def folded(contacts: str, solver: str = "verlet") -> Scene:
    """A strip that is dropped on its edge and lays itself in folds."""
    return Scene(
        cloth=Cloth(rows=30, columns=9, width=0.24, height=0.87, center=(0.0, 0.5, 0.0), rotation=(4, 0, 0), pins=()),
        springs=Springs(bend=0.05),
        solver=Solver(solver, *USUAL[solver]),
        self_collision=SelfCollision(thickness=0.03 if contacts == "particles" else 0.01, contacts=contacts),
        ground=Ground(),
    )


@pytest.mark.parametrize("contacts", [pytest.param("particles", marks=pytest.mark.long), "triangles"])
@pytest.mark.parametrize("path", ["lanes", "gather"])
def test_a_path_gives_the_folds_of_the_list(path: str, contacts: str) -> None:
    scene = folded(contacts)
    with Simulation(scene, "list") as plain, Simulation(scene, path) as other:
        start = plain.topology.start
        plain.place(start, np.tile([0.0, -3.0, 0.0], (len(start), 1)))  # fast: with checked indices a frame takes 5 s
        for _ in range(12):
            plain.advance_frame()
        for _ in range(2):
            for name in ("x", "x_prev"):
                getattr(other.cloth, name).copy_from(getattr(plain.cloth, name))
            for simulation in (plain, other):
                simulation.advance_frame()
            assert other.positions() == pytest.approx(plain.positions(), abs=1e-5)
        for simulation in (plain, other):
            near = simulation.solver.work.near
            assert (near.depths.to_numpy()[near.particle.to_numpy()[:270]] > 0).sum() > 20


def layer_gap(simulation: Simulation) -> float:
    """Least distance of two particles that are not neighbours on the flat sheet [m]."""
    x, flat = simulation.positions(), simulation.topology.flat
    distance = np.linalg.norm(x[:, None] - x[None], axis=2)
    apart = np.linalg.norm(flat[:, None] - flat[None], axis=2) > 2.5 * 0.03
    return float(distance[apart].min())


def least_gap(scene: Scene, frames: int) -> tuple[float, int]:
    """In all frames from the first touch on, and crossings at the end."""
    least = np.inf
    with Simulation(scene, "list") as simulation:
        for frame in range(frames):
            simulation.advance_frame()
            if frame > 20:
                least = min(least, layer_gap(simulation))
        return least, simulation.crossings()


@pytest.mark.parametrize(
    "solver", [pytest.param(s, marks=[pytest.mark.long] * (s not in ("verlet", "spring"))) for s in SOLVERS]
)
def test_folds_keep_off_each_other(solver: str) -> None:
    gap, crossed = least_gap(folded("particles", solver), 70)
    assert gap > 0.6 * 0.03
    assert crossed == 0


def test_without_it_folds_lie_in_each_other() -> None:
    gap, crossed = least_gap(replace(folded("particles"), self_collision=None), 70)
    assert gap < 0.1 * 0.03
    assert crossed > 10


def test_a_ball_on_a_stack_goes_through_no_sheet() -> None:
    """Parted too slowly, the ball of this scene presses a thousand edges through the sheets below within a second."""
    with Simulation(load_scene("stack")) as simulation:
        for _ in range(55):
            simulation.advance_frame()
        assert simulation.crossings() < 20


def test_crossings_are_counted() -> None:
    """A sheet of three rows whose last is led through the first: by hand, from the triangles' corners."""
    scene = Scene(cloth=Cloth(rows=2, columns=6, width=5.0, height=1.0, pins=()), self_collision=SelfCollision())
    with Simulation(scene) as simulation:
        x = simulation.topology.flat.copy()
        simulation.place(x)
        assert simulation.measure().crossings == 0
        # The last column's two particles to either side of the first cell: the edge between them goes through it.
        x[5], x[11] = x[0] + [0.3, -0.2, 0.5], x[0] + [0.35, -0.25, -0.5]
        simulation.place(x)
        brute = brute_crossings(x, simulation.topology.edges, simulation.topology.triangles)
        assert brute >= 1
        assert simulation.measure().crossings == simulation.crossings() == crossings(simulation.cloth) == brute


def brute_crossings(x: Floats, edges: NDArray[np.int32], triangles: NDArray[np.int32]) -> int:
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


@settings(max_examples=20)
@given(st.integers(0, 2**31))
def test_crossings_are_those_of_brute_force(seed: int) -> None:
    """A crumpled net of edges no longer than at rest."""
    random = np.random.default_rng(seed)
    scene = Scene(cloth=Cloth(rows=6, columns=6, width=1.0, height=1.0, pins=()), self_collision=SelfCollision())
    with Simulation(scene) as simulation:
        x = random.uniform(-0.08, 0.08, (36, 3)).astype(np.float32).astype(np.float64)
        simulation.place(x)
        assert simulation.crossings() == brute_crossings(x, simulation.topology.edges, simulation.topology.triangles)


def test_a_run_that_is_measured_loaded_and_reset_gives_the_same_bits(tmp_path: Path) -> None:
    """What is listed and sorted is no part of a cloth's state."""
    with Simulation(folded("particles"), "list") as simulation:
        seen = []
        for again in range(3):
            for frame in range(45):
                simulation.advance_frame()
                if again == 1:
                    simulation.measure()
                if again == 2 and frame == 30:
                    simulation.save(tmp_path / "save.npz")
                    simulation.reset()
                    simulation.advance_frame()
                    simulation.load(tmp_path / "save.npz")
            seen.append(simulation.positions().tobytes())
            simulation.reset()
    assert seen[0] == seen[1] == seen[2]
