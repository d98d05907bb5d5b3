"""The error of a frame: it has the order of the solver, counts all that acts on the cloth, and changes no bit of it."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taichi_cloth.scene.collider_schema import Ground, Sphere
from taichi_cloth.scene.fabric_schema import Fabric, VerletSprings
from taichi_cloth.scene.schema import Cloth, Scene, SelfCollision, Solver, Tearing, Wind
from taichi_cloth.simulation import copies
from taichi_cloth.simulation.copies import Copy, FrameErrorMeter, FrameStart
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import UsageError

pytestmark = pytest.mark.usefixtures("serial_layout")

CLOTH = Cloth(rows=8, columns=9, width=0.8, height=0.7, center=(0.0, 3.0, 0.0), pins=("top-left", "top-right"))
FABRIC = Fabric(warp=100.0, weft=100.0, shear=30.0, bend_spring=1.0)


def scene(name: str, substeps: int, iterations: int = 10, damping: float = 0.5, **parts: Any) -> Scene:
    solver = Solver(name=name, substeps=substeps, iterations=iterations, damping=damping)
    return Scene(**({"cloth": CLOTH, "fabric": FABRIC, "solver": solver, "wind": Wind(z=4.0)} | parts))


@contextmanager
def swinging(scene: Scene, frames: int = 20) -> Iterator[tuple[Simulation, FrameErrorMeter]]:
    with Simulation(scene) as simulation, closing(FrameErrorMeter(scene)) as meter:
        simulation.step(frames)
        yield simulation, meter


@pytest.mark.parametrize(
    ("error", "motion", "reference_error", "converged"),
    [  # [mm]
        (10.0, 20.0, 1e-3, True),
        (10.0, 20.0, 4.9, True),  # the error is more than twice that of the reference
        (10.0, 20.0, 5.1, False),
        (650.0, 20.0, 651.0, False),
        (1.0, 20.0, 0.99, True),  # lost in that of the reference, but small against the motion
        (1.0, 20.0, 1.01, False),
        (0.01, 0.01, 0.049, True),  # so small that nobody sees it
        (0.01, 0.01, 0.051, False),
        (0.01, 0.01, np.nan, False),
    ],
)
def test_a_reference_has_converged_if_it_tells_the_error(
    error: float, motion: float, reference_error: float, converged: bool
) -> None:
    lengths = (1e-3 * length for length in (error, motion, reference_error))
    found = copies.FrameError(1, *lengths, None, 0.0, np.zeros(1), 0.0)
    assert found.reference_has_converged is converged
    assert found.parts["reference_has_converged"] is converged


def error_of(name: str, substeps: int) -> copies.FrameError:
    """Return the error of the first frame of a sheet that starts 5 % too long, without wind and damping."""
    with swinging(scene(name, substeps, 100, wind=None, damping=0.0), 0) as (simulation, meter):
        x = simulation.positions()
        x += [0, 0.05, 0] * (x - x[0])
        for _ in range(3):  # the reference is refined
            simulation.set_state(x)
            found = meter.measure_frame(simulation)
        return found


@pytest.mark.parametrize("name", ["explicit", "lines"])
def test_twice_the_substeps_make_a_quarter_of_the_error_of_a_second_order_solver(name: str) -> None:
    coarse, fine = error_of(name, 10), error_of(name, 20)
    assert coarse.error / fine.error == pytest.approx(4, rel=0.15)
    assert fine.reference_error < fine.error / 4


def test_ten_times_the_substeps_make_a_small_part_of_the_error_of_other_orders() -> None:
    coarse, fine = error_of("rk4", 6), error_of("rk4", 60)
    assert fine.error < coarse.error / 100
    coarse, fine = error_of("xpbd", 8), error_of("xpbd", 80)
    assert coarse.error / 10 < fine.error < coarse.error / 3  # of first order, once its springs are resolved


@pytest.mark.parametrize(("name", "coarse"), [("lines", 3), ("implicit", 3), ("explicit", 20)])
def test_the_reference_has_the_damping_that_the_solver_applies(name: str, coarse: int) -> None:
    """`lines` applies all of it, `implicit` none, `explicit` a part: of each the error falls with the substeps."""
    errors = []
    for substeps in (coarse, 4 * coarse):
        damped = scene(name, substeps, 100, wind=None, fabric=replace(FABRIC, damping_time=3e-3))
        with swinging(damped, 0) as (simulation, meter):
            x = simulation.positions()
            simulation.set_state(x + [0, 0.05, 0] * (x - x[0]))
            errors.append(meter.measure_frame(simulation))
    assert errors[0].is_resolved
    assert errors[1].error < errors[0].error / 3


def test_a_fabric_with_too_much_damping_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    damped = scene("lines", 10, fabric=replace(FABRIC, warp=1e4, damping_time=0.2))
    with pytest.raises(UsageError, match=r"its reference would need [\d,]+ substeps, more than 5,000"):
        FrameErrorMeter(damped)
    with closing(FrameErrorMeter(replace(damped, solver=Solver("implicit", 10)))):
        pass


def test_the_error_is_that_of_each_particle_and_their_root_mean_square() -> None:
    found = error_of("xpbd", 5)
    assert found.by_particle.shape == (72,)
    assert found.error == pytest.approx(np.sqrt(np.mean(found.by_particle**2)))
    assert found.by_particle[[0, 8]].max() < 1e-7  # pins
    assert found.motion > found.error > found.reference_error


def test_stretched_cloth_has_a_larger_error() -> None:
    """Iterations that do not converge leave cloth longer than its springs would."""
    errors = []
    for stretch in (1.0, 1.3):
        with swinging(scene("verlet", 5, 3), 0) as (simulation, meter):
            x = simulation.positions()
            simulation.set_state(x + [0, (stretch - 1), 0] * (x - x[0]))
            errors.append(meter.measure_frame(simulation).error)
    assert errors[1] > 10 * errors[0]


def test_grabs_wind_parameters_pins_and_moving_colliders_act_on_the_reference() -> None:
    """If one of them did not, a fine setting would have an error like the motion."""
    sphere = Sphere(center=(0.0, 2.7, 0.1), radius=0.2, oscillation=(0.0, 0.0, 0.3), margin=0.15, friction=0.0)
    parts = {"spheres": (sphere,), "ground": Ground(height=2.2)}
    with swinging(scene("explicit", 60, **parts), 10) as (simulation, meter):
        simulation.params["wind_z"] = -8.0
        simulation.params["gravity"] = 3.0
        simulation.params["sphere_radius"] = 0.25
        simulation.pin(40)
        grab = simulation.grab(66, radius=0.11)
        x = simulation.positions()[66]
        for k in range(1, 7):
            grab.move_to(x + [0.0, 0.0, 0.02 * k])
            found = meter.measure_frame(simulation)
            assert found.error < 0.02 * found.motion
        simulation.params["wind"] = False
        found = meter.measure_frame(simulation)
        assert found.error < 0.02 * found.motion


@pytest.mark.parametrize("name", ["verlet", "xpbd", "lines"])
def test_measuring_changes_no_bit_of_the_cloth(name: str) -> None:
    parts = {"self_collision": SelfCollision(thickness=0.05, static_friction=True), "ground": Ground(height=2.4)}
    ends = []
    for measured in (False, True):
        with swinging(scene(name, 5, 3, **parts), 5) as (simulation, meter):
            grab = simulation.grab(66)
            grab.move_to((0.2, 2.6, 0.3))
            for _ in range(12):
                if measured:
                    meter.measure_frame(simulation)
                else:
                    simulation.step()
            ends.append((simulation.positions(), simulation.velocities(), simulation.frame))
    for before, after in zip(*ends, strict=True):
        np.testing.assert_array_equal(before, after)


def test_residual_and_step_error_are_apart() -> None:
    """With four times the iterations the residual falls and the step error stays; finer substeps make that smaller."""

    def parts(substeps: int, iterations: int) -> copies.FrameError:
        with swinging(scene("xpbd", substeps, iterations, wind=None, damping=0.0), 0) as (simulation, meter):
            x = simulation.positions()
            simulation.set_state(x + [0, 0.05, 0] * (x - x[0]))
            return meter.measure_frame(simulation)

    few, many, fine, rough = parts(4, 4), parts(4, 16), parts(16, 16), parts(16, 1)
    assert few.residual is not None
    assert many.residual is not None
    assert many.residual < few.residual / 3
    assert many.step_error == pytest.approx(few.step_error, rel=0.1)
    assert fine.step_error < many.step_error / 2
    assert many.error == pytest.approx(many.step_error, rel=0.1)
    assert rough.residual is not None
    assert fine.residual is not None
    assert rough.residual > 1000 * fine.residual
    assert rough.step_error == pytest.approx(fine.step_error, rel=1e-3)
    assert rough.error > 1.15 * rough.step_error


@pytest.mark.parametrize("name", ["explicit", "rk4"])
def test_solvers_that_do_not_iterate_have_no_residual(name: str) -> None:
    with swinging(scene(name, 10), 2) as (simulation, meter):
        found = meter.measure_frame(simulation)
    assert found.residual is None
    assert found.step_error == found.error


def test_converged_iterations_have_no_residual() -> None:
    with swinging(scene("xpbd", 4, 200), 5) as (simulation, meter):
        found = meter.measure_frame(simulation)
    assert found.residual is not None
    assert found.residual < 1e-3 * found.motion


def test_the_growth_is_the_distance_after_a_second_with_grabs_at_rest() -> None:
    setting = scene("xpbd", 5, 1)
    with swinging(setting, 10) as (simulation, meter), Simulation(scene("explicit", 100)) as fine:
        grab = simulation.grab(66)
        grab.move_to((0.1, 2.5, 0.4))
        start = copies.FrameStart.of(simulation)
        growth = meter.growth(start)
        grab.move_to(start.grabs[0].start)
        fine.set_state(simulation.positions(), simulation.velocities())
        fine.grab(66)
        fine.set_frame(simulation.frame)  # gusts depend on time
        for one in (simulation, fine):
            one.step(60)
        distance = copies.rms_distance(simulation.positions(), fine.positions())
    assert growth == pytest.approx(distance, rel=0.05)
    assert growth > 1e-4


def test_the_start_of_a_frame_does_not_change_with_the_cloth(monkeypatch: pytest.MonkeyPatch) -> None:
    """It may wait until the process that measures it is ready."""
    monkeypatch.setattr(copies, "GOAL_SECONDS", 0.0)  # the reference is not refined between the measurements
    with swinging(scene("explicit", 10), 3) as (simulation, meter):
        grab = simulation.grab(66)
        simulation.pin(40)
        start = copies.FrameStart.of(simulation)
        found = meter.measure_frame(simulation)
        after = copies.FrameStart.of(simulation)
        grab.move_to((0.3, 2.0, 0.5))
        simulation.unpin(40)
        simulation.params["gravity"] = 1.0
        simulation.step(5)
        again = meter.measure(pickle.loads(pickle.dumps(start)), after.positions)
    assert again.error == pytest.approx(found.error, rel=1e-6)
    np.testing.assert_array_equal(again.by_particle, found.by_particle)


def test_a_copy_with_other_springs_has_the_same_torn_ones() -> None:
    torn_scene = scene("verlet", 5, verlet=VerletSprings(bend=0.0, structural=0.0), tearing=Tearing(strain=0.5))
    other = replace(torn_scene, solver=Solver(name="explicit", substeps=1, iterations=1))
    with Simulation(torn_scene) as simulation, Copy(other) as copy:
        torn = np.zeros(len(simulation.torn), bool)
        torn[[3, 40, -1]] = True
        simulation.set_torn(torn)
        assert len(copy.torn) != len(torn)
        copy.start_from(FrameStart.of(simulation))
        ends = [one.built.topology.ends[one.torn].tolist() for one in (simulation, copy)]
        assert {frozenset(pair) for pair in ends[0]} == {frozenset(pair) for pair in ends[1]}
        assert len(ends[0]) == 3
        simulation.untear()
        copy.start_from(FrameStart.of(simulation))
        assert not copy.torn.any()


def test_a_copy_takes_over_cloth_that_intersects_itself_although_its_scene_forbids_it() -> None:
    contact = SelfCollision(thickness=0.02, penetration_free=True)
    with Simulation(scene("xpbd", 5)) as simulation, Copy(scene("xpbd", 5, self_collision=contact)) as copy:
        x = simulation.positions()
        x[30:] += np.random.default_rng(1).normal(0.0, 0.1, x[30:].shape)
        simulation.set_state(x)
        assert simulation.intersections()
        copy.start_from(FrameStart.of(simulation))
        np.testing.assert_array_equal(copy.positions(), simulation.positions())
        assert copy.penetration_free_since is None


def test_a_copy_takes_over_all_pins_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    built = []
    rebuild = Copy.rebuild
    monkeypatch.setattr(Copy, "rebuild", lambda self, *arguments: built.append(1) or rebuild(self, *arguments))
    with Simulation(scene("explicit", 5)) as simulation, Copy(scene("explicit", 5)) as copy:
        simulation.pin(40, radius=0.3)
        simulation.unpin(0)
        copy.start_from(FrameStart.of(simulation))
        np.testing.assert_array_equal(copy.topology.pinned, simulation.topology.pinned)
        assert len(built) == 1
