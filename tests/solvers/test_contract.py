"""What every solver must satisfy in every layout. A new solver is tested once it is in SOLVERS."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taichi_cloth.geometry.topology import FAR
from taichi_cloth.scene.collider_schema import Box, Ground, Sphere
from taichi_cloth.scene.fabric_schema import Fabric, VerletSprings
from taichi_cloth.scene.schema import Cloth, Forces, Scene, Solver, Wind
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG
from taichi_cloth.simulation.events import GrabHandle
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers import LAYOUTS, SOLVERS

EVERY = [pytest.param(name, layout, id=f"{name}-{layout}") for name, kind in SOLVERS.items() for layout in LAYOUTS]
pytestmark = pytest.mark.parametrize(("solver", "layout"), EVERY)

SHEET = Cloth(rows=8, columns=9, width=0.8, height=0.7, center=(0.0, 3.0, 0.0), pins=())


SPHERE = Sphere(
    center=(0.0, 2.7, -0.4), radius=0.2, margin=0.05, oscillation=(0.1, 0.0, 0.5), period=(1.0, 1.0, 2.0), friction=0.0
)
BOX = Box(center=(0.3, 2.4, 0.3), size=(0.2, 0.2, 0.2))


# The usual ones are slow in the parallel layout: every pass over a color is a launch.
FEWER: dict[str, dict[str, Any]] = {
    "verlet": {"substeps": 5, "iterations": 4},
    "xpbd": {"substeps": 5, "iterations": 4},
    "lines": {"substeps": 5, "iterations": 1},
    "implicit": {"substeps": 5, "iterations": 2},
}


def scene(solver: str, cloth: Cloth = SHEET, *, damping: float = 0.0, **parts: Any) -> Scene:
    """Air without density, and colliders far away: the features of `busy`, whose kernel takes seconds to compile."""
    around: dict[str, Any] = {
        "wind": Wind(air_density=0.0),
        "spheres": (replace(SPHERE, center=(0.0, 0.0, -9.0)),),
        "boxes": (replace(BOX, center=(0.0, 0.0, 9.0)),),
        "ground": Ground(height=-9.0),
    }
    return Scene(cloth=cloth, solver=Solver(name=solver, damping=damping, **FEWER.get(solver, {})), **(around | parts))


def busy(solver: str) -> Scene:
    """All features at once."""
    return scene(
        solver,
        replace(SHEET, pins=("top-left", "top-right")),
        damping=1.0,
        wind=Wind(x=1.0, z=4.0),
        spheres=(SPHERE,),
        boxes=(BOX,),
        ground=Ground(height=2.2),
    )


def run(simulation: Simulation, frames: int) -> np.ndarray:
    for _ in range(frames):
        simulation.step()
    return simulation.positions()


def mean_velocity(simulation: Simulation) -> float:
    """Velocity of the center of mass along y [m/s], which springs cannot change."""
    return float(np.average(simulation.velocities()[:, 1], weights=simulation.topology.mass))


def test_pins_do_not_move(solver: str, layout: str) -> None:
    with Simulation(busy(solver), layout) as simulation:
        before, pins = simulation.positions(), simulation.topology.pinned
        assert np.linalg.norm(run(simulation, 20) - before, axis=1)[~pins].min() > 1e-3
        assert (run(simulation, 30)[pins] == before[pins]).all()


def test_after_a_reset_the_cloth_moves_as_if_no_number_had_been_lost(solver: str, layout: str) -> None:
    """No field keeps a NaN that the next frame does not write before it reads it."""
    with Simulation(busy(solver), layout) as simulation:
        expected = run(simulation, 3)
        x = simulation.positions()
        x[40] = np.nan
        simulation.place(x)  # `set_state` refuses it
        assert not np.isfinite(run(simulation, 1)).all()
        simulation.reset()
        assert (run(simulation, 3) == expected).all()


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0), (-37.0, 20.0, 5.0)])
def test_a_sheet_without_forces_does_not_move(solver: str, layout: str, rotation: tuple[float, float, float]) -> None:
    cloth = replace(SHEET, rotation=rotation)
    with Simulation(scene(solver, cloth, forces=Forces(gravity=0.0)), layout) as simulation:
        before = simulation.positions()
        assert (run(simulation, 30) == before).all()


def test_free_fall_follows_its_discrete_closed_form(solver: str, layout: str) -> None:
    # n steps of h from rest: −g·h²·n(n+1)/2 (accuracy reference A1.1), and −g·(n·h)²/2 at second order.
    frames = 30
    with Simulation(scene(solver), layout) as simulation:
        before = simulation.positions()
        fall = run(simulation, frames) - before
        n = frames * simulation.substeps
        step = 1 / 60 / simulation.substeps
        euler = SOLVER_CATALOG[solver].euler_steps  # uses the velocity at the end of the substep
        expected = -9.81 * step**2 * n * (n + euler) / 2
        assert fall[:, 1] == pytest.approx(expected, rel=1e-3)  # float32 at y = 3 m rounds 0.04 % of g·h² off each step
        assert np.abs(fall[:, [0, 2]]).max() < 1e-5
        assert simulation.metrics().max_strain < 1e-4
        assert mean_velocity(simulation) == pytest.approx(-9.81 * n * step, rel=1e-3)
        # Each particle is rounded separately, and undamped springs vibrate with it: by some roundings of a position.
        farthest = np.abs(simulation.positions() - simulation.topology.origin).max()
        rounding = np.spacing(np.float32(farthest)) / step  # [m/s]
        assert np.ptp(simulation.velocities()[:, 1]) < (20 * rounding if euler else 0.02)


def test_the_origin_follows_a_cloth_that_flies_away_and_moves_no_particle(solver: str, layout: str) -> None:
    with Simulation(scene(solver), layout) as simulation:
        start = simulation.positions()
        simulation.set_state(start, (20.0, 0.0, 0.0))
        moves = 0
        for _ in range(40):
            simulation.step()
            x, v, origin = simulation.positions(), simulation.velocities(), simulation.origin
            simulation._follow_cloth()
            moves += not np.array_equal(simulation.origin, origin)
            assert (simulation.positions() == x).all()
            assert (simulation.velocities() == v).all()
        assert moves >= 2
        assert np.abs(simulation.positions() - simulation.origin).max() < FAR + 1.5
        assert simulation.positions().mean(axis=0)[0] == pytest.approx(20.0 * 40 / 60, rel=1e-4)
        simulation.set_state(start)
        assert (simulation.origin == simulation.topology.origin).all()


def test_a_dropped_sheet_does_not_bounce(solver: str, layout: str) -> None:
    """Contact stops particles that move into it; only stored spring energy is returned."""
    flat = replace(SHEET, center=(0.0, 0.6, 0.0), rotation=(-90.0, 0.0, 0.0))
    dropped = scene(solver, flat, ground=Ground(height=0.0, friction=0.3))
    with Simulation(dropped, layout) as simulation:
        run(simulation, 40)  # it takes 20 to fall
        lying = simulation.positions()[:, 1].max()
        for _ in range(30):
            simulation.step()
            assert simulation.positions()[:, 1].max() < lying + 1e-3
        assert lying < 0.05


def test_damping_reduces_velocity_exponentially(solver: str, layout: str) -> None:
    with Simulation(scene(solver, damping=2.0, forces=Forces(gravity=0.0)), layout) as simulation:
        simulation.params["gravity"] = 10.0
        run(simulation, 6)
        simulation.params["gravity"] = 0.0
        before = mean_velocity(simulation)
        run(simulation, 30)
        assert mean_velocity(simulation) / before == pytest.approx(np.exp(-2.0 * 0.5), rel=1e-3)


def test_runs_of_the_same_scene_are_bit_equal(solver: str, layout: str) -> None:
    runs = []
    for _ in range(2):
        with Simulation(busy(solver), layout) as simulation:
            runs.append(run(simulation, 40))
    assert (runs[0] == runs[1]).all()


def test_held_particles_have_the_velocity_of_their_grab(solver: str, layout: str) -> None:
    with Simulation(busy(solver), layout) as simulation:
        start, grab = simulation.positions()[40], simulation.grab(40)
        for frame in range(1, 4):
            grab.move_to(start + np.array([0.02, 0.01, 0.0]) * frame)
            simulation.step()
            assert simulation.velocities()[40] == pytest.approx((1.2, 0.6, 0.0), abs=1e-3)
        simulation.step()
        assert np.abs(simulation.velocities()[40]).max() < 1e-3  # the grab is at rest


def test_reset_restores_the_start_bit_for_bit(solver: str, layout: str) -> None:
    with Simulation(busy(solver), layout) as simulation:
        start, first = simulation.positions(), run(simulation, 30)
        simulation.grab(40).move_to((1.0, 3.0, 1.0))
        run(simulation, 5)
        simulation.reset()
        assert (simulation.positions() == start).all()
        assert (simulation.velocities() == 0).all()
        assert (run(simulation, 30) == first).all()


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
def test_a_changed_parameter_applies_to_the_next_frame(solver: str, layout: str, name: str, value: float) -> None:
    if name == "iterations" and SOLVERS[solver].info.is_explicit:
        pytest.skip("this method does not iterate")
    with Simulation(busy(solver), layout) as simulation:
        before = run(simulation, 15)
        same = run(simulation, 3)
        simulation.reset()
        assert (run(simulation, 15) == before).all()
        assert simulation.params[name] != value
        simulation.params[name] = value
        assert simulation.params[name] == value
        assert (simulation.positions() == before).all()  # nothing jumps
        least = 0.0 if (solver, name) == ("rk4", "substeps") else 1e-6  # a step of fourth order changes the last bits
        assert np.abs(run(simulation, 3) - same).max() > least  # a sphere that grew in the cloth moves it out slowly


def test_changing_the_substeps_keeps_velocities(solver: str, layout: str) -> None:
    with Simulation(scene(solver), layout) as simulation:
        run(simulation, 10)
        before = simulation.velocities()
        simulation.params["substeps"] = 13
        assert simulation.velocities() == pytest.approx(before, rel=1e-3, abs=1e-3)


def test_cloth_stays_out_of_colliders(solver: str, layout: str) -> None:
    with Simulation(busy(solver), layout) as simulation:
        deepest = 0.0
        for _ in range(90):
            simulation.step()
            deepest = max(deepest, simulation.metrics().penetration)
        assert deepest == 0.0


def test_grabbed_particles_follow_the_grab_exactly(solver: str, layout: str) -> None:
    with Simulation(busy(solver), layout) as simulation:
        before = run(simulation, 3)
        grab = simulation.grab(30, radius=0.21)  # two cells of 0.1 m: thirteen particles
        grab.move_to(before[30])
        grabbed = simulation.grabbed
        assert len(grabbed) == 13
        assert (run(simulation, 1)[grabbed] == before[grabbed]).all(), "the cloth jumped when it was grabbed"
        for k in range(20):
            target = (0.02 * k, 3.1, 0.01 * k)
            grab.move_to(target)
            simulation.step()
            assert simulation.positions()[30] == pytest.approx(target, abs=1e-6)
            assert simulation.positions()[grabbed] == pytest.approx(before[grabbed] - before[30] + target, abs=1e-6)
        assert grab.active
        assert grab.particles[0] == simulation.grabbed[0] == 30


def test_released_particles_regain_their_mass_and_get_the_velocity_of_the_grab(solver: str, layout: str) -> None:
    none = (
        1e-12,
        1e-12,
        1e-12,
    )  # not 0: without springs the fields would differ, and all kernels would be compiled again
    free = scene(
        solver, forces=Forces(gravity=0.0), verlet=VerletSprings(*none), fabric=Fabric(*none, bend_spring=1e-12)
    )
    with Simulation(free, layout) as simulation:
        start = simulation.positions()[10]
        masses = simulation.cloth.inverse_mass.to_numpy()
        grab = simulation.grab(10, radius=0.11)
        for k in range(1, 7):
            grab.move_to(start + [0.02 * k, 0, 0])
            simulation.step()
        released = simulation.grabbed
        assert released.tolist() == [10, 1, 9, 11, 19]
        grab.release()
        assert (grab.active, len(simulation.grabs), len(simulation.grabbed)) == (False, 0, 0)
        assert (simulation.cloth.inverse_mass.to_numpy() == masses).all()
        assert simulation.velocities()[released] == pytest.approx(
            np.tile([1.2, 0, 0], (5, 1)), abs=1e-3
        )  # 0.02 m/frame
        before = simulation.positions()
        assert run(simulation, 20)[released] == pytest.approx(before[released] + [0.4, 0, 0], abs=3e-3)
    with Simulation(scene(solver), layout) as simulation:
        grab = simulation.grab(10)
        grab.move_to(simulation.positions()[10])
        run(simulation, 5)
        grab.release()
        before = simulation.positions()[10]
        assert run(simulation, 30)[10][1] < before[1] - 0.1  # it falls again


def test_a_released_pin_stays_pinned(solver: str, layout: str) -> None:
    with Simulation(busy(solver), layout) as simulation:
        grab = simulation.grab(0)
        grab.move_to((-0.5, 3.3, 0.1))
        run(simulation, 3)
        grab.release()
        assert (simulation.velocities()[0] == 0).all()
        assert run(simulation, 10)[0] == pytest.approx((-0.5, 3.3, 0.1), abs=1e-6)


def test_a_loaded_checkpoint_continues_bit_for_bit(solver: str, layout: str, tmp_path: Path) -> None:
    file = tmp_path / "half.npz"
    with Simulation(busy(solver), layout) as whole:
        whole.params["wind_z"] = 6.0
        grab = whole.grab(33, radius=0.15)
        grab.move_to((0.1, 2.9, 0.2))
        whole.pin(60)
        run(whole, 15)
        whole.save(file)
        grabbed, pinned = whole.grabbed, whole.topology.pinned
        grab.release()
        end = run(whole, 15)
    with Simulation(busy(solver), layout) as half:
        half.load(file)
        assert half.frame == 15
        assert half.params["wind_z"] == 6.0
        assert (half.grabbed == grabbed).all()
        assert (half.topology.pinned == pinned).all()
        [number] = half.grabs
        GrabHandle(half, number).release()
        assert (run(half, 15) == end).all()
