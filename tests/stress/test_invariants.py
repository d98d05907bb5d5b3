"""The monitor finds each kind of violation, and none in a cloth that is alive."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from taichi_cloth.evaluation.stress.invariants import Extremes, InvariantMonitor, Violation
from taichi_cloth.evaluation.stress.setup import SETTINGS, Setting, sheet
from taichi_cloth.evaluation.stress.trial import Trial, close
from taichi_cloth.scene.collider_schema import Attachment, Plane, Sphere
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.keys import Keyframes
from taichi_cloth.scene.schema import Forces, Solver, Wind
from taichi_cloth.simulation.events import GrabHandle

SETTING = Setting("xpbd", Solver("xpbd", 20, 4, damping=0.0))
PUSHED: Keyframes = ((0.0, 0, 0, 0), (1.0, 0, 0, 0.3))


@pytest.fixture(autouse=True)
def closed_simulation() -> Iterator[None]:
    yield
    close()


def running(**sections: Any) -> Trial:
    """Return a trial of a hanging sheet, ten frames after its start."""
    trial = Trial(SETTING, 0)
    trial.open(sheet(8, **sections), rest_strain=0.1)
    trial.start()
    trial.run(1 / 6)
    return trial


def unreported(trial: Trial, change: Callable[[np.ndarray, np.ndarray], object]) -> None:
    """Change positions [m] or velocities [m/s] without the trial, which does not count the work."""
    x, v = trial.simulation.positions(), trial.simulation.velocities()
    change(x, v)
    trial.simulation.set_state(x, v)


def faster(x: np.ndarray, v: np.ndarray) -> None:
    v += [0.0, 0.0, 1.0]  # ½·0.2 kg·(1 m/s)² = 0.1 J, of 3.9 J available


def grabbed(trial: Trial, particle: int) -> GrabHandle:
    """Grab a particle where it is, between two frames."""
    found: list[GrabHandle] = []
    trial.change(lambda: found.append(trial.simulation.grab(particle)))
    return found[0]


def test_a_hanging_cloth_is_alive() -> None:
    trial = running()
    trial.settle()
    assert trial.frame == 310
    assert trial.worst.energy <= 0.001
    assert 0 < trial.worst.speed < 5
    assert 0 < trial.worst.strain < 0.1


def test_added_kinetic_energy_is_a_violation() -> None:
    trial = running()
    unreported(trial, faster)
    with pytest.raises(Violation, match="energy") as found:
        trial.one_frame()
    assert found.value.bound == pytest.approx(0.01 * 2 * 0.2 * 9.81, rel=0.02)
    assert 0.04 < found.value.value < 0.1


def test_added_kinetic_energy_is_a_violation_ten_kilometers_away() -> None:
    """Kernels store positions relative to a point near the sheet, so rounding is the same anywhere."""
    trial = running(center=(1e4, 1e4, 0.0))
    unreported(trial, faster)
    with pytest.raises(Violation, match="energy") as found:
        trial.one_frame()
    assert 0.04 < found.value.value < 0.1


def far_ball() -> Sphere:
    return Sphere(center=(0.0, 0.0, -3.0), radius=0.3, margin=0.01, keyframes=PUSHED, friction=0.0)


def slow_ball() -> Sphere:
    """Return a ball that touches the sheet and moves by a millimeter per second."""
    slow: Keyframes = ((0.0, 0, 0, 0), (10.0, 0, 0, 0.01))
    return Sphere(center=(0.0, 0.0, -0.31), radius=0.3, margin=0.01, keyframes=slow, friction=0.0)


def plane_alongside() -> Plane:
    """Return a plane 8 cm behind the sheet, which slides along itself by 2 cm in each frame."""
    sliding: Keyframes = ((0.0, 0, 0, 0), (1.0, 60 * 0.02, 0, 0))
    return Plane(center=(0.0, 0.0, -0.09), rotation=(90.0, 0.0, 0.0), margin=0.01, keyframes=sliding, friction=0.0)


def ball_around_a_part() -> Sphere:
    return Sphere(center=(0.0, -0.2, 0.2), radius=0.25, margin=0.01, friction=0.0)


@pytest.mark.parametrize(
    "sections",
    [
        {"wind": Wind(z=1.0, turbulence=0.0)},
        {"spheres": (far_ball(),)},
        {"spheres": (slow_ball(),)},
        {"spheres": (ball_around_a_part(),)},
        {"planes": (plane_alongside(),)},
    ],
    ids=["wind", "a distant ball", "a touching ball", "a ball around a part", "a plane alongside"],
)
def test_wind_and_colliders_excuse_no_more_than_the_work_that_they_can_do(sections: dict[str, Any]) -> None:
    trial = running(**sections)
    unreported(trial, lambda x, v: v.__iadd__([0.0, 0.0, 3.0]))
    with pytest.raises(Violation, match="energy"):
        trial.one_frame()


def test_a_grab_that_does_not_move_does_no_work() -> None:
    trial = running()
    corner = trial.simulation.topology.particle_count - 1
    grabbed(trial, corner)
    trial.one_frame(driven=True)
    v = trial.simulation.velocities() + [0.0, 0.0, 2.0]
    trial.simulation.solver.set_velocities(v, trial.simulation.h)
    with pytest.raises(Violation, match="energy"):
        trial.one_frame(driven=True)


def test_the_work_of_a_grab_is_force_times_displacement() -> None:
    """The end of a spring is pulled by 1 cm: the work is ½·k·d², and no more than k·d²."""
    trial = Trial(SETTING, 0)
    x = trial.open(sheet((1, 1), pins=("left",), forces=Forces(gravity=0.0), constant=100.0), rest_strain=0.1)
    trial.start(shake=0.0)
    corner = int(np.flatnonzero(~trial.simulation.topology.pinned)[0])
    grab = grabbed(trial, corner)
    trial.one_frame(driven=True)
    grab.move_to(x[corner] + [0.01, 0.0, 0.0])
    seen: list[float] = []
    trial.one_frame(driven=True, look=lambda share: seen.append(trial.watch._grab_work))
    stored = 0.5 * 100.0 * 0.01**2  # [J] of the spring along the displacement; others store a part
    assert seen == sorted(seen)
    assert stored < seen[-1] < 6 * stored


def test_the_work_of_a_grab_and_of_a_ball_is_no_violation() -> None:
    trial = running()
    middle = trial.simulation.topology.particle_count // 2
    grab = grabbed(trial, middle)
    for z in (0.0, 0.2, 0.4, 0.2):
        target = trial.simulation.topology.start[middle] + [0.0, 0.0, z]
        trial.change(partial(grab.move_to, target))
        trial.one_frame(driven=True)
    trial.change(grab.release)
    trial.settle()
    fast: Keyframes = ((0.2, 0, 0, 0), (0.3, 0, 0, 1.0), (0.4, 0, 0, 0))
    ball = Sphere(center=(0.0, 0.0, -0.7), radius=0.2, margin=0.01, keyframes=fast, continuous=True, friction=0.0)
    trial = running(spheres=(ball,), damping=0.0)
    trial.run(0.5)
    assert trial.worst.speed > 5
    trial.skip_rest_check("it swings")


def test_energy_added_by_a_change_is_counted_as_work() -> None:
    trial = running()
    x, v = trial.simulation.positions(), trial.simulation.velocities()
    before = trial.energy()
    trial.change(lambda: trial.simulation.set_state(x, v + [0.0, 0.0, 1.0]))
    assert trial.energy() - before == pytest.approx(0.1, rel=0.1)
    trial.run(0.1)


def test_energy_removed_by_a_change_is_no_longer_available() -> None:
    """Springs are softened while they are stretched, and may not release the energy that they had before."""
    trial = Trial(SETTING, 0)
    x = trial.open(sheet(8, forces=Forces(gravity=0.0)), rest_strain=0.1)
    trial.start(x * [1.2, 1.0, 1.0], shake=0.0)
    allowed = trial.watch._allowed
    trial.change(lambda: trial.simulation.params.update({"stiffness": 0.1}))
    assert trial.watch._allowed == pytest.approx(0.1 * allowed, rel=0.05)


def test_elastic_energy_is_computed_from_the_fabric() -> None:
    """A sheet of 8 × 8 cells, stretched to twice its width, has 8·8 springs of 1000 N/m along its rows, and diagonals.

    The energy is the same for a solver without spring constants, because it is the same cloth.
    """
    for name in ("explicit", "verlet"):
        trial = Trial(Setting(name, Solver(name, 400, 1)), 0)
        x = trial.open(sheet(8, forces=Forces(gravity=0.0), constant=1000.0), rest_strain=0.1)
        trial.start(x * [2.0, 1.0, 1.0], shake=0.0)
        along, cell = 8 * 8, 1 / 8
        diagonal = cell * (np.sqrt(5) - np.sqrt(2))
        expected = 500 * (along * cell**2 + 2 * 8 * 8 * diagonal**2)
        assert trial.energy() == pytest.approx(expected, rel=2e-3)
        trial.skip_rest_check("not run")
        close()


def test_a_bent_sheet_stores_bending_energy() -> None:
    """A parabola of curvature κ stores ½·B·κ² per area: all but half a cell at each of the edges that it raises."""
    bending, curvature = 1e-2, 0.5  # [N·m], [1/m]
    fabric = Fabric(warp=0.0, weft=0.0, shear=0.0, bend_spring=0.0, bending_stiffness=bending)
    trial = Trial(SETTING, 0)
    x = trial.open(sheet(8, fabric=fabric, forces=Forces(gravity=0.0)), rest_strain=0.1)
    x[:, 2] = curvature * x[:, 0] ** 2 / 2
    trial.start(x, shake=0.0)
    assert trial.energy() == pytest.approx(bending * curvature**2 / 2 * 7 / 8, rel=1e-4)
    trial.skip_rest_check("not run")


def test_an_implicit_solver_releases_less_energy_of_very_stiff_springs() -> None:
    """At least V / (1 + h²ω²) of the slowest mode along the sheet, and no more than the energy of the spring."""
    trial = Trial(SETTING, 0)
    trial.open(sheet(8, constant=1e9), rest_strain=0.1)
    trial.start()
    h, mass = 1 / 60 / 20, trial.simulation.topology.mass.max()
    kept = trial.watch._constants() / 1e9
    slowest = (np.pi / 16) ** 2 * 1e9 / mass  # ω² of 8 springs in a row, fixed at one end
    assert kept[np.isfinite(kept)].max() <= 1
    inside = np.isclose(trial.simulation.topology.mass[trial.simulation.topology.ends], mass).all(axis=1)
    assert kept[inside] == pytest.approx(1 / (1 + h**2 * slowest), rel=1e-6)


def test_shortened_springs_store_energy_by_their_compression() -> None:
    """The sheet has half its width and twice its height: only springs along its columns are stretched."""
    for compression in (0.0, 0.25, 1.0):
        trial = Trial(replace(SETTING, compression=compression, solver=Solver("explicit", 1)), 0)
        x = trial.open(sheet(8, forces=Forces(gravity=0.0), constant=1000.0), rest_strain=0.1)
        trial.start(x * [0.5, 2.0, 1.0], shake=0.0)
        cell = 1 / 8
        diagonal = cell * (np.sqrt(4.25) - np.sqrt(2))
        expected = 500 * (8 * 8 * cell**2 + 2 * 8 * 8 * diagonal**2 + compression * 8 * 8 * (cell / 2) ** 2)
        assert trial.energy() == pytest.approx(expected, rel=1e-4)
        close()


def test_positions_that_are_not_finite_are_a_violation() -> None:
    trial = running()
    trial.simulation.cloth.x[40] = [np.nan, 0.0, 0.0]
    with pytest.raises(Violation, match="positions are not finite"):
        trial.watch.check_frame()


def test_velocities_that_are_not_finite_are_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    trial = running()
    v = trial.simulation.velocities()
    v[40, 2] = np.inf
    monkeypatch.setattr(trial.simulation, "velocities", lambda: v)
    with pytest.raises(Violation, match="velocities are not finite"):
        trial.watch.check_frame()


def test_a_pin_that_moves_is_a_violation() -> None:
    trial = running()
    trial.simulation.cloth.x[0] = [-0.5, 0.5, 1e-6]
    with pytest.raises(Violation, match="pin"):
        trial.watch.check_frame()


def pulled(seconds: float, distance: float, pins: tuple[str, ...] = (), setting: Setting = SETTING) -> Trial:
    """Return a trial of a weightless sheet whose left edge a hand pulls away, by `distance` [m] in `seconds` [s]."""
    left = tuple(range(0, 81, 9))
    hand = Attachment(pins=left, keyframes=((0.0, 0, 0, 0), (seconds, -distance, 0, 0)))
    trial = Trial(setting, 0)
    trial.open(sheet(8, pins=pins, attachments=(hand,), forces=Forces(gravity=0.0), damping=0.0), rest_strain=0.1)
    trial.start(shake=0.0)
    return trial


def test_attached_pins_follow_their_attachment() -> None:
    trial = pulled(0.5, 0.5)
    trial.run(0.6)
    assert trial.simulation.positions()[0, 0] == pytest.approx(-1.0, abs=1e-6)
    trial.simulation.cloth.x[0] = [-1.0 + 4e-6, 0.5, 0.0]  # 4 roundings of 1 m are 4.8e-7 m
    with pytest.raises(Violation, match="pin") as found:
        trial.watch.check_frame()
    assert found.value.bound == pytest.approx(4 * 2.0**-23, rel=0.01)


def test_a_pin_that_its_attachment_leaves_behind_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    trial = pulled(0.5, 0.5)
    trial.run(0.1)
    still = trial.simulation.positions()
    monkeypatch.setattr(trial.simulation, "positions", lambda: still)
    with pytest.raises(Violation, match="pin"):
        trial.one_frame()


def test_the_work_of_an_attachment_that_starts_to_pull_is_no_violation() -> None:
    """The sheet is accelerated to 1 m/s within a frame, at the end of which its springs have little tension."""
    trial = pulled(1.0, 1.0, setting=SETTINGS["verlet"])
    trial.run(1.0)
    assert 1 < trial.worst.speed < 3
    trial.skip_rest_check("it is pulled")


def test_the_work_of_an_attachment_that_stretches_the_sheet_is_no_violation() -> None:
    """It is pulled slowly by 5 cm, and its energy is all that the hand gave."""
    trial = pulled(1.0, 0.05, pins=("right",))
    trial.run(1.0)
    assert trial.energy() > 500 * 8 * 8 * (0.05 / 8) ** 2 * 0.9
    trial.skip_rest_check("it is stretched")


@pytest.mark.parametrize("moves", [0.0, 0.1])
def test_an_attachment_excuses_no_more_than_its_travel_times_the_momentum(moves: float) -> None:
    """A sheet of 0.2 kg gains 3 m/s across: 0.2 kg·3 m/s over a frame of 1/60 s, along a way of 1/600 m, are 0.06 J."""
    trial = pulled(1.0, moves)
    trial.run(0.5)
    before = trial.simulation.positions(), trial.simulation.velocities()
    faster = before[1] + [0.0, 0.0, 3.0]
    moved = before[0] - [moves / 60, 0.0, 0.0]
    impulse = 0.2 * 15 / 16 * 3.0 * 60  # [N]: the left edge has a sixteenth of the mass
    assert trial.watch._work_bound(moved, faster) == pytest.approx(impulse * moves / 60, rel=0.3)
    unreported(trial, lambda x, v: v.__iadd__([0.0, 0.0, 3.0]))
    with pytest.raises(Violation, match="energy"):
        trial.one_frame()


def test_a_particle_out_of_reach_is_a_violation() -> None:
    trial = running()
    x, v = trial.simulation.positions(), trial.simulation.velocities()
    x[44] += [0.0, 0.0, 4.0]
    trial.change(lambda: trial.simulation.set_state(x, v))  # the energy that this takes counts as work
    with pytest.raises(Violation, match="away"):
        trial.watch.check_frame()


def test_an_infinite_reach_is_refused() -> None:
    trial = running()
    with pytest.raises(ValueError, match="finite"):
        InvariantMonitor(trial.simulation, Extremes(), float("inf"))


def test_a_static_ball_may_eject_cloth_and_its_penetration_is_recorded() -> None:
    """The ball is around a part of the cloth, and does work on it."""
    trial = Trial(SETTING, 0)
    trial.open(
        sheet(8, spheres=(Sphere(center=(0.0, -0.2, 0.05), radius=0.3, margin=0.01, friction=0.0),)), rest_strain=0.1
    )
    trial.start()
    trial.run(0.1)
    assert trial.worst.penetration > 0.2


def test_a_teleported_ball_excuses_only_the_work_of_ejection() -> None:
    """It is teleported into the middle of the sheet: the bound is not that of a ball that moved through it."""
    leap: Keyframes = ((0.1, 0, 0, 0), (0.100001, 0, 0, 5.0))
    ball = Sphere(center=(0.0, -0.2, -4.9), radius=0.3, margin=0.01, keyframes=leap, friction=0.0)
    trial = Trial(SETTING, 0)
    trial.open(sheet(8, spheres=(ball,)), rest_strain=0.1)
    trial.start()
    trial.run(6 / 60)
    unreported(trial, lambda x, v: v.__iadd__([0.0, 0.0, 5.0]))
    with pytest.raises(Violation, match="energy"):
        trial.one_frame()
