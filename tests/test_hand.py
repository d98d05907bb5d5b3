"""The patch that a hand takes, pins that a user puts and takes, and scenes that change while they run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.errors import WrongUse
from taichi_cloth.hand import Hand, patch
from taichi_cloth.kernels.controls import MOST_HANDS
from taichi_cloth.scene import load_scene
from taichi_cloth.scene.model import Cloth, Fabric, Forces, Grip, Ground, Limit, Scene, Solver, Sphere, Tethers
from taichi_cloth.simulation import Simulation

CLOTH = Cloth(rows=9, columns=9, width=0.8, height=0.8, center=(0.0, 1.0, 0.0), pins=("top",))
MIDDLE = 4 * 9 + 4


@pytest.fixture
def hung() -> Iterator[Simulation]:
    with Simulation(Scene(cloth=CLOTH)) as simulation:
        yield simulation


def throw(simulation: Simulation) -> None:
    """Forwards, lower rows faster: a sheet that stands upright in its plane would stay there."""
    start = simulation.topology.start
    simulation.place(start, np.outer(start[:, 1].max() - start[:, 1] + 0.1, [0.0, 0.0, 2.0]))


def run(simulation: Simulation, frames: int) -> np.ndarray:
    for _ in range(frames):
        simulation.advance_frame()
    return simulation.positions()


def inverse_masses(simulation: Simulation) -> np.ndarray:
    return simulation.cloth.taken(simulation.cloth.inverse_mass)


def test_a_patch_is_what_is_free_within_the_radius_on_the_sheet() -> None:
    flat = np.array([[x, y, 0.0] for y in range(3) for x in range(4)])
    free = np.arange(12) != 4
    assert patch(flat, free, 5, 0.0).tolist() == [5]
    assert patch(flat, free, 5, 1.0).tolist() == [5, 1, 6, 9]
    assert patch(flat, free, 4, 1.0).tolist() == [4, 0, 5, 8]  # a pin that is taken itself
    assert len(patch(flat, free, 5, 1e6)) == 11


def test_what_is_thrown_has_the_hands_mean_velocity_over_three_frames() -> None:
    start = np.zeros(3)
    hand = Hand(np.array([4]), start[None], start, start)
    assert hand.velocity().tolist() == [0, 0, 0]
    found = []
    for x in (0.1, 0.3, 0.6, 1.0, 1.0):
        hand.target = np.array([x, 0.0, 0.0])
        hand.end_frame()
        found.append(hand.velocity()[0])
    # (0.1)·60, (0.3)/2·60, (0.6)/3·60, (1.0 − 0.1)/3·60 and (1.0 − 0.3)/3·60 m/s
    assert found == pytest.approx([6.0, 9.0, 12.0, 18.0, 14.0])


def test_a_patch_takes_no_layer_that_lies_behind(hung: Simulation) -> None:
    folded = hung.topology.start.copy()
    folded[45:] = folded[44:8:-1] + [0.0, 0.0, 0.01]
    hung.place(folded)
    hung.grab(2 * 9 + 4, folded[22], radius=0.11)
    assert hung.held.tolist() == [22, 13, 21, 23, 31]


def test_pins_in_a_patch_stay_and_masses_come_back_bit_for_bit(hung: Simulation) -> None:
    masses = inverse_masses(hung)
    hung.grab(13, hung.positions()[13], radius=0.15)
    assert not set(hung.held) & set(range(9))
    assert (np.flatnonzero((inverse_masses(hung) == 0) & (masses > 0)) == np.sort(hung.held)).all()
    pins = hung.positions()[:9]
    hung.grab(13, hung.positions()[13] + [0.0, 0.0, 0.2])
    assert (run(hung, 5)[:9] == pins).all()
    hung.release()
    assert (inverse_masses(hung) == masses).all()


def test_reset_and_another_grab_let_go_of_the_whole_patch(hung: Simulation) -> None:
    masses = inverse_masses(hung)
    hung.grab(MIDDLE, (0.0, 1.0, 0.3), radius=0.2)
    run(hung, 3)
    hung.grab(80, hung.positions()[80])
    assert hung.held.tolist() == [80]
    assert np.count_nonzero(inverse_masses(hung) != masses) == 1
    hung.grab(MIDDLE, (0.0, 1.0, 0.3), radius=0.2)
    hung.reset()
    assert hung.grabbed is None
    assert (inverse_masses(hung) == masses).all()
    assert (hung.positions() == hung.topology.start).all()


def test_a_patch_stays_in_the_hand_when_the_method_changes(hung: Simulation) -> None:
    """`verlet` keeps another velocity than `xpbd`, and strips another order of particles than a list."""
    hung.grab(MIDDLE, hung.positions()[MIDDLE], radius=0.2)
    held, before = hung.held, run(hung, 3)
    hung.change_solver("xpbd")
    assert (hung.held == held).all()
    assert (run(hung, 3)[held] == before[held]).all()


def test_a_fine_cloth_is_pulled_without_a_needle() -> None:
    """Half a metre out of a sheet of cells of 3 cm: the longest spring at one particle, and around a patch."""
    scene = load_scene("curtain", rows=96, columns=96, wind_x=0.0, wind_z=0.0)
    strains = []
    for radius in (0.0, 0.1):
        with Simulation(scene) as simulation:
            for k in range(20):
                simulation.grab(48 * 96 + 48, (0.0, 2.2, 0.025 * (k + 1)), radius)
                simulation.advance_frame()
            strains.append(simulation.measure().max_strain)
    assert strains[1] < 0.6 * strains[0]  # 27 % instead of 50 %


# -- several hands --------------------------------------------------------------------------------------------------


def test_several_hands_hold_throw_and_save_each_its_own(hung: Simulation, tmp_path: Path) -> None:
    hung.grab(MIDDLE, (0.0, 1.0, 0.0), radius=0.11)
    hung.grab(60, hung.positions()[60], hand=5)
    assert hung.held.tolist() == [MIDDLE, 31, 39, 41, 49, 60]
    for k in range(1, 5):
        hung.grab(MIDDLE, (0.0, 1.0, 0.02 * k))
        hung.grab(60, hung.topology.start[60] + [0.03 * k, 0.0, 0.0], hand=5)
        x = run(hung, 1)
    assert x[MIDDLE] == pytest.approx([0.0, 1.0, 0.08], abs=1e-6)
    assert x[60] == pytest.approx(hung.topology.start[60] + [0.12, 0.0, 0.0], abs=1e-6)
    hung.save(tmp_path / "two.npz")
    hung.release(5)
    assert (hung.grabbed, hung.grabbed_by(5)) == (MIDDLE, None)
    assert hung.velocities()[60] == pytest.approx([1.8, 0.0, 0.0], abs=1e-4)
    hung.load(tmp_path / "two.npz")
    assert (hung.grabbed, hung.grabbed_by(5)) == (MIDDLE, 60)
    hung.reset()
    assert len(hung.held) == 0


def test_what_one_hand_holds_no_other_takes(hung: Simulation) -> None:
    hung.grab(MIDDLE, (0.0, 1.0, 0.0), radius=0.11, hand=1)
    with pytest.raises(ValueError, match="particle 41 is held by hand 1"):
        hung.grab(41, (0.0, 1.0, 0.0))
    hung.grab(42, hung.positions()[42], radius=0.11)
    assert 41 not in hung.held[5:]
    for hand in (-1, MOST_HANDS, 0.0, True):
        with pytest.raises(ValueError, match="does not exist"):
            hung.grab(70, (0.0, 1.0, 0.0), hand=hand)


# -- pins ----------------------------------------------------------------------------------------------------------


def test_a_particle_is_pinned_where_it_is_and_let_go_again(hung: Simulation) -> None:
    masses = inverse_masses(hung)
    throw(hung)
    there = run(hung, 5)[MIDDLE]
    hung.pin(MIDDLE)
    assert (run(hung, 20)[MIDDLE] == there).all()
    assert hung.topology.pinned[MIDDLE]
    hung.pin(MIDDLE)  # twice is once
    hung.pin(MIDDLE, on=False)
    assert (inverse_masses(hung) == masses).all()
    assert np.linalg.norm(run(hung, 10)[MIDDLE] - there) > 0.01


def test_pinning_changes_no_place_nor_velocity(hung: Simulation) -> None:
    throw(hung)
    x, v = run(hung, 10), hung.velocities()
    hung.pin(MIDDLE)
    v[MIDDLE] = 0.0
    assert (hung.positions() == x).all()
    assert hung.velocities() == pytest.approx(v, abs=1e-4)  # `verlet` keeps places alone


def test_the_scenes_own_pins_come_off_and_a_reset_brings_them_back(hung: Simulation) -> None:
    for pin in range(9):
        hung.pin(pin, on=False)
    hung.pin(MIDDLE)
    throw(hung)
    assert run(hung, 60)[:9, 1].max() < 1.3  # they were at 1.4 m
    hung.reset()
    assert np.flatnonzero(hung.topology.pinned).tolist() == list(range(9))
    assert (run(hung, 5)[:9] == hung.topology.start[:9]).all()


def test_what_is_pinned_in_the_hand_stays_where_the_hand_lets_go(hung: Simulation) -> None:
    hung.grab(MIDDLE, (0.0, 1.0, 0.2), radius=0.15)
    run(hung, 2)
    hung.pin(MIDDLE)
    hung.grab(MIDDLE, (0.0, 1.1, 0.3))
    run(hung, 1)
    hung.release()
    assert run(hung, 20)[MIDDLE] == pytest.approx([0.0, 1.1, 0.3], abs=1e-6)


def test_tethers_follow_the_pins() -> None:
    """A sheet that swings about a new pin keeps within reach of it, and the old pins hold nothing."""
    with Simulation(Scene(cloth=CLOTH, tethers=Tethers(1.0), forces=Forces(gravity=20.0))) as simulation:
        for pin in range(9):
            simulation.pin(pin, on=False)
        simulation.pin(MIDDLE)
        throw(simulation)
        middle = simulation.positions()[MIDDLE]
        reach = np.linalg.norm(simulation.topology.flat - simulation.topology.flat[MIDDLE], axis=1)
        x = run(simulation, 60)
        assert x[:9, 1].max() < 1.0, "the top has not come down"
        assert (np.linalg.norm(x - middle, axis=1) - reach).max() < 1e-5


def test_a_pin_of_a_grip_comes_out_of_it_and_falls() -> None:
    rising = Grip(pins=("top",), center=(0.0, 0.0, 0.0), path=((0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 1.0, 0.0)))
    with Simulation(Scene(cloth=replace(CLOTH, pins=()), grips=(rising,))) as simulation:
        for pin in range(7):
            simulation.pin(pin, on=False)
        x = run(simulation, 30)
        assert x[7:9, 1] == pytest.approx([1.9, 1.9], abs=1e-5)
        assert x[0, 1] < 1.88


def test_the_fewest_substeps_follow_the_pins() -> None:
    """All but one corner pinned: it alone vibrates, and slower than the sheet."""
    sheet = replace(CLOTH, rows=3, columns=3, pins=())
    with Simulation(Scene(cloth=sheet, solver=Solver("spring", 1, 1), fabric=Fabric(2e4, 2e4, 1e4))) as simulation:
        free = simulation.least_substeps
        for particle in range(8):
            simulation.pin(particle)
        assert simulation.least_substeps < 0.8 * free
        simulation.reset()
        assert simulation.least_substeps == free


# -- scenes that change --------------------------------------------------------------------------------------------


def test_another_scene_goes_on_from_the_same_places_and_keeps_what_was_set() -> None:
    whole = Scene(cloth=CLOTH, ground=Ground(), limit=Limit(0.1), spheres=(Sphere(center=(0.0, 0.3, 0.5), radius=0.2),))
    with Simulation(whole) as simulation:
        simulation.set("gravity", 4.0)
        simulation.set("limit_strain", 0.3)
        x, v = run(simulation, 10), simulation.velocities()
        simulation.change(replace(whole, limit=None, spheres=()))
        assert (simulation.positions() == x).all()
        assert simulation.velocities() == pytest.approx(v, abs=1e-4)
        assert simulation.stages == ("structural", "shear", "bend", "ground")
        assert simulation.get("gravity") == 4.0
        with pytest.raises(ValueError, match="limit_strain"):
            simulation.get("limit_strain")
        assert np.isfinite(run(simulation, 3)).all()
        simulation.change(replace(whole, forces=Forces(gravity=2.0)))
        assert (simulation.get("gravity"), simulation.get("limit_strain")) == (2.0, 0.1)
        assert simulation.frame == 13


def test_another_grid_is_refused_and_nothing_changes(hung: Simulation) -> None:
    x = run(hung, 3)
    with pytest.raises(WrongUse, match="8 rows, the cloth that runs has 9"):
        hung.change(replace(hung.scene, cloth=replace(CLOTH, rows=8)))
    assert (hung.positions() == x).all()


def test_a_ball_that_is_switched_on_within_the_cloth_lets_it_out() -> None:
    whole = Scene(cloth=CLOTH, spheres=(Sphere(center=(0.0, 0.8, 0.0), radius=0.3),))
    with Simulation(replace(whole, spheres=())) as simulation:
        run(simulation, 2)
        simulation.change(whole)
        before = simulation.positions()
        assert np.linalg.norm(run(simulation, 1) - before, axis=1).max() < 0.05
        assert simulation.measure().finite


def test_fabrics_change_and_come_back() -> None:
    scene = load_scene("drape15", solver="xpbd")
    with Simulation(scene) as simulation:
        x = run(simulation, 3)
        mass = simulation.topology.mass.sum()
        simulation.change_fabric("denim")
        denim = load_scene("drape15", solver="xpbd", fabric="denim")
        assert (simulation.scene.fabric, simulation.scene.springs) == (denim.fabric, denim.springs)
        assert simulation.scene.cloth.area_density == denim.cloth.area_density
        assert simulation.topology.mass.sum() > 2 * mass
        assert (simulation.positions() == x).all()
        simulation.change_solver("lines")
        simulation.change_fabric("")
        assert simulation.scene.fabric == scene.fabric
        assert simulation.scene.cloth == scene.cloth
        assert simulation.solver.name == "lines"
