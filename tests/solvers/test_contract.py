"""What every solver must keep on every path, whatever its method. A new solver joins by standing in SOLVERS."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.scene.model import Box, Cloth, Fabric, Forces, Ground, Scene, Solver, Sphere, Springs, Wind
from taichi_cloth.simulation import Simulation
from taichi_cloth.solvers import SOLVERS

EVERY = [pytest.param(name, path, id=f"{name}-{path}") for name, kind in SOLVERS.items() for path in kind.paths]
pytestmark = pytest.mark.parametrize(("solver", "path"), EVERY)

SECOND_ORDER = ("spring", "rk4", "lines")  # free fall is exact; the others' velocity is that of the substep's end

SHEET = Cloth(rows=8, columns=9, width=0.8, height=0.7, center=(0.0, 3.0, 0.0), pins=())


BALL = Sphere(center=(0.0, 2.7, -0.4), radius=0.2, margin=0.05, sway=(0.1, 0.0, 0.5), period=(1.0, 1.0, 2.0))
BLOCK = Box(center=(0.3, 2.4, 0.3), size=(0.2, 0.2, 0.2))


# A round of `projective` on `gather` is some hundred launches, which take longer than all else here does together.
FEWER = {"projective": {"substeps": 5, "iterations": 4}}


def scene(solver: str, cloth: Cloth = SHEET, *, damping: float = 0.0, **parts: object) -> Scene:
    """In air of no density and far from all bodies: the stages of `busy`, whose kernel takes seconds to compile."""
    around: dict[str, object] = {
        "wind": Wind(air_density=0.0),
        "spheres": (replace(BALL, center=(0.0, 0.0, -9.0)),),
        "boxes": (replace(BLOCK, center=(0.0, 0.0, 9.0)),),
        "ground": Ground(height=-9.0),
    }
    return Scene(cloth=cloth, solver=Solver(name=solver, damping=damping, **FEWER.get(solver, {})), **(around | parts))


def busy(solver: str) -> Scene:
    """Everything on at once."""
    return scene(
        solver,
        replace(SHEET, pins=("top-left", "top-right")),
        damping=1.0,
        wind=Wind(x=1.0, z=4.0),
        spheres=(BALL,),
        boxes=(BLOCK,),
        ground=Ground(height=2.2),
    )


def run(simulation: Simulation, frames: int) -> np.ndarray:
    for _ in range(frames):
        simulation.advance_frame()
    return simulation.positions()


def mean_velocity(simulation: Simulation) -> float:
    """Of the centre of mass along y [m/s]: springs cannot change it."""
    return float(np.average(simulation.velocities()[:, 1], weights=simulation.topology.mass))


def test_pins_do_not_move_by_a_bit(solver: str, path: str) -> None:
    with Simulation(busy(solver), path) as simulation:
        before, pins = simulation.positions(), simulation.topology.pinned
        assert np.linalg.norm(run(simulation, 30) - before, axis=1)[~pins].min() > 1e-3
        assert (run(simulation, 90)[pins] == before[pins]).all()


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0), (-37.0, 20.0, 5.0)])
def test_a_sheet_without_forces_stays_where_it_is_to_the_last_bit(
    solver: str, path: str, rotation: tuple[float, float, float]
) -> None:
    cloth = replace(SHEET, rotation=rotation)
    with Simulation(scene(solver, cloth, forces=Forces(gravity=0.0)), path) as simulation:
        before = simulation.positions()
        assert (run(simulation, 100) == before).all()


def test_free_fall_follows_its_discrete_closed_form(solver: str, path: str) -> None:
    # n steps of h from rest: −g·h²·n(n+1)/2 (accuracy reference A1.1), and −g·(n·h)²/2 at second order.
    frames = 30
    with Simulation(scene(solver), path) as simulation:
        before = simulation.positions()
        fall = run(simulation, frames) - before
        n = frames * simulation.substeps
        step = 1 / 60 / simulation.substeps
        expected = -9.81 * step**2 * n * (n if solver in SECOND_ORDER else n + 1) / 2
        assert fall[:, 1] == pytest.approx(expected, rel=1e-3)  # float32 at y = 3 m loses 0.04 % of g·h² a step
        assert np.abs(fall[:, [0, 2]]).max() < 1e-5
        assert simulation.measure().max_strain < 1e-4
        assert mean_velocity(simulation) == pytest.approx(-9.81 * n * step, rel=1e-3)
        # Particles are rounded each for itself, and undamped springs shake with it: by some roundings of a place.
        farthest = np.abs(simulation.positions() - simulation.topology.origin).max()
        rounding = np.spacing(np.float32(farthest)) / step  # [m/s]
        assert np.ptp(simulation.velocities()[:, 1]) < (0.02 if solver in SECOND_ORDER else 20 * rounding)


def test_a_dropped_sheet_does_not_bounce(solver: str, path: str) -> None:
    """Contact stops what moves into it; nothing throws back more than springs had stored."""
    flat = replace(SHEET, center=(0.0, 0.6, 0.0), rotation=(-90.0, 0.0, 0.0))
    dropped = scene(solver, flat, ground=Ground(height=0.0, friction=0.3))
    with Simulation(dropped, path) as simulation:
        run(simulation, 40)  # it takes 20 to fall
        lying = simulation.positions()[:, 1].max()
        for _ in range(30):
            simulation.advance_frame()
            assert simulation.positions()[:, 1].max() < lying + 1e-3
        assert lying < 0.05


def test_damping_takes_its_share_of_velocity_every_second(solver: str, path: str) -> None:
    with Simulation(scene(solver, damping=2.0, forces=Forces(gravity=0.0)), path) as simulation:
        simulation.set("gravity", 10.0)
        run(simulation, 6)
        simulation.set("gravity", 0.0)
        before = mean_velocity(simulation)
        run(simulation, 30)
        assert mean_velocity(simulation) / before == pytest.approx(np.exp(-2.0 * 0.5), rel=1e-3)


def test_the_same_scene_twice_gives_the_same_bits(solver: str, path: str) -> None:
    runs = []
    for _ in range(2):
        with Simulation(busy(solver), path) as simulation:
            runs.append(run(simulation, 90))
    assert (runs[0] == runs[1]).all()


def test_reset_is_the_start_bit_for_bit(solver: str, path: str) -> None:
    with Simulation(busy(solver), path) as simulation:
        start, first = simulation.positions(), run(simulation, 60)
        simulation.grab(40, (1.0, 3.0, 1.0))
        run(simulation, 5)
        simulation.reset()
        assert (simulation.positions() == start).all()
        assert (simulation.velocities() == 0).all()
        assert (run(simulation, 60) == first).all()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gravity", 3.0),
        ("wind_x", -5.0),
        ("wind_z", 9.0),
        ("stiffness", 0.3),
        ("damping", 8.0),
        ("sphere_radius", 1.4),
        ("iterations", 3),
        ("substeps", 90),
        ("wind", False),
    ],
)
def test_a_changed_parameter_counts_at_once(solver: str, path: str, name: str, value: float) -> None:
    if name == "iterations" and not SOLVERS[solver].iterates:
        pytest.skip("this method does not iterate")
    with Simulation(busy(solver), path) as simulation:
        before = run(simulation, 20)
        same = run(simulation, 3)
        simulation.reset()
        assert (run(simulation, 20) == before).all()
        assert simulation.get(name) != value
        simulation.set(name, value)
        assert simulation.get(name) == value
        assert (simulation.positions() == before).all()  # nothing jumps
        assert np.abs(run(simulation, 3) - same).max() > 1e-6  # a ball that grew pushes from within, and slowly


def test_changing_the_substeps_keeps_every_velocity(solver: str, path: str) -> None:
    with Simulation(scene(solver), path) as simulation:
        run(simulation, 10)
        before = simulation.velocities()
        simulation.set("substeps", 13)
        assert simulation.velocities() == pytest.approx(before, rel=1e-3, abs=1e-3)


def test_the_cloth_stays_out_of_colliders(solver: str, path: str) -> None:
    with Simulation(busy(solver), path) as simulation:
        deepest = 0.0
        for _ in range(120):
            simulation.advance_frame()
            deepest = max(deepest, simulation.measure().penetration)
        assert deepest == 0.0


def test_what_is_held_goes_exactly_where_the_hand_is(solver: str, path: str) -> None:
    with Simulation(busy(solver), path) as simulation:
        before = run(simulation, 3)
        simulation.grab(30, before[30], radius=0.21)  # two cells of 0.1 m: thirteen particles
        held = simulation.held
        assert len(held) == 13
        assert (run(simulation, 1)[held] == before[held]).all(), "the cloth jumped when it was taken"
        for k in range(20):
            target = (0.02 * k, 3.1, 0.01 * k)
            simulation.grab(30, target)
            simulation.advance_frame()
            assert simulation.positions()[30] == pytest.approx(target, abs=1e-6)
            assert simulation.positions()[held] == pytest.approx(before[held] - before[30] + target, abs=1e-6)
        assert simulation.grabbed == 30


def test_what_was_held_has_its_mass_again_and_the_hands_velocity(solver: str, path: str) -> None:
    none = (1e-12, 1e-12, 1e-12)  # not 0: without springs there would be other fields, and all kernels anew
    free = scene(solver, forces=Forces(gravity=0.0), springs=Springs(*none), fabric=Fabric(*none, bend=1e-12))
    with Simulation(free, path) as simulation:
        start = simulation.positions()[10]
        masses = simulation.cloth.taken(simulation.cloth.inverse_mass)
        for k in range(1, 7):
            simulation.grab(10, start + [0.02 * k, 0, 0], radius=0.11)
            simulation.advance_frame()
        held = simulation.held
        assert held.tolist() == [10, 1, 9, 11, 19]
        simulation.release()
        assert (simulation.grabbed, len(simulation.held)) == (None, 0)
        assert (simulation.cloth.taken(simulation.cloth.inverse_mass) == masses).all()
        assert simulation.velocities()[held] == pytest.approx(np.tile([1.2, 0, 0], (5, 1)), abs=1e-3)  # 0.02 m a frame
        there = simulation.positions()
        assert run(simulation, 60)[held] == pytest.approx(there[held] + [1.2, 0, 0], abs=1e-2)
    with Simulation(scene(solver), path) as simulation:
        simulation.grab(10, simulation.positions()[10])
        run(simulation, 5)
        simulation.release()
        before = simulation.positions()[10]
        assert run(simulation, 30)[10][1] < before[1] - 0.1  # it falls again


def test_a_pin_that_was_grabbed_stays_a_pin(solver: str, path: str) -> None:
    with Simulation(busy(solver), path) as simulation:
        simulation.grab(0, (-0.5, 3.3, 0.1))
        run(simulation, 3)
        simulation.release()
        assert (simulation.velocities()[0] == 0).all()
        assert run(simulation, 30)[0] == pytest.approx((-0.5, 3.3, 0.1), abs=1e-6)


def test_a_save_goes_on_bit_for_bit(solver: str, path: str, tmp_path: object) -> None:
    file = tmp_path / "half.npz"
    with Simulation(busy(solver), path) as whole:
        whole.set("wind_z", 6.0)
        whole.grab(33, (0.1, 2.9, 0.2), radius=0.15)
        whole.pin(60)
        run(whole, 25)
        whole.save(file)
        whole_held, whole_pinned = whole.held, whole.topology.pinned
        whole.release()
        end = run(whole, 25)
    with Simulation(busy(solver), path) as half:
        half.load(file)
        assert half.frame == 25
        assert half.get("wind_z") == 6.0
        assert (half.held == whole_held).all()
        assert (half.topology.pinned == whole_pinned).all()
        half.release()
        assert (run(half, 25) == end).all()
