"""Grabs of patches, pins that change, and scenes that change while they run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.kernels.step_params import MAX_GRABS
from taichi_cloth.scene.collider_schema import Attachment, Ground, Sphere
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Forces, Scene, Solver, StrainLimit, Tethers
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG
from taichi_cloth.simulation.events import Event
from taichi_cloth.simulation.grabbing import Grab, vertices_in_radius
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import UsageError

CLOTH = Cloth(rows=9, columns=9, width=0.8, height=0.8, center=(0.0, 1.0, 0.0), pins=("top",))
MIDDLE = 4 * 9 + 4


@pytest.fixture
def hanging() -> Iterator[Simulation]:
    with Simulation(Scene(cloth=CLOTH)) as simulation:
        yield simulation


def throw(simulation: Simulation) -> None:
    """Give it velocities forward, larger in lower rows: at rest in its vertical plane it would stay there."""
    start = simulation.topology.start
    simulation.set_state(start, np.outer(start[:, 1].max() - start[:, 1] + 0.1, [0.0, 0.0, 2.0]))


def run(simulation: Simulation, frames: int) -> np.ndarray:
    for _ in range(frames):
        simulation.step()
    return simulation.positions()


def test_a_position_names_the_nearest_particle(hanging: Simulation) -> None:
    run(hanging, 3)
    x = hanging.positions()
    hanging.pin(x[MIDDLE] + [0.0, 0.0, 0.01])
    assert list(hanging.added_pins) == [MIDDLE]
    hanging.unpin(x[MIDDLE].tolist())
    assert not len(hanging.added_pins)
    grab = hanging.grab(tuple(x[-1] + [0.03, -0.2, 0.0]))
    assert list(hanging.grabbed) == [80]
    grab.release()
    with pytest.raises(ValueError, match="invalid number in the position of a particle: not finite"):
        hanging.grab((0.0, np.nan, 0.0))


def test_closing_releases_grabs() -> None:
    with Simulation(Scene(cloth=CLOTH)) as simulation:
        grab = simulation.grab(MIDDLE)
        assert grab.active
    assert not grab.active
    grab.release()
    assert not grab.force.any()


def test_a_position_far_from_the_cloth_is_no_particle() -> None:
    with Simulation(Scene(cloth=CLOTH)) as simulation:
        side = simulation.topology.longest_side
        near = simulation.positions()[MIDDLE] + (0.0, 0.0, 0.9 * side)
        assert repr(simulation.grab(near)) == "<GrabHandle 0: of 1 particle>"
        assert repr(simulation.grab(0, radius=10.0)).endswith("particles>")
        for call in (simulation.pin, simulation.unpin, simulation.grab):
            with pytest.raises(
                ValueError, match=r"^no particle is near the position \[24.0, 12.0, 7.0\]: the nearest is "
            ):
                call([24.0, 12.0, 7.0])
        assert not len(simulation.added_pins)


@pytest.mark.parametrize("indices", [[0, 1, 2], (0, 1), np.array([0, 1, 2]), [[0, 1, 2]], np.array([True, False])])
def test_several_indices_are_not_taken_as_a_position(indices: object) -> None:
    with Simulation(Scene(cloth=CLOTH)) as simulation:
        for call in (simulation.pin, simulation.unpin, simulation.grab):
            with pytest.raises(ValueError, match=r"^a particle is one index, .* call once for each particle$"):
                call(indices)
        assert not len(simulation.added_pins)


def inverse_masses(simulation: Simulation) -> np.ndarray:
    return simulation.cloth.inverse_mass.to_numpy()[: simulation.topology.particle_count]


def test_a_patch_has_the_free_particles_within_the_radius_on_the_sheet() -> None:
    flat = np.array([[x, y, 0.0] for y in range(3) for x in range(4)])
    free = np.arange(12) != 4
    assert vertices_in_radius(flat, free, 5, 0.0).tolist() == [5]
    assert vertices_in_radius(flat, free, 5, 1.0).tolist() == [5, 1, 6, 9]
    assert vertices_in_radius(flat, free, 4, 1.0).tolist() == [4, 0, 5, 8]  # the center itself may be pinned
    assert len(vertices_in_radius(flat, free, 5, 1e6)) == 11


def test_a_released_grab_keeps_its_mean_velocity_over_three_frames() -> None:
    start = np.zeros(3)
    grab = Grab(np.array([4]), start[None], start, start)
    assert grab.velocity().tolist() == [0, 0, 0]
    found = []
    for x in (0.1, 0.3, 0.6, 1.0, 1.0):
        grab.target = np.array([x, 0.0, 0.0])
        grab.end_frame()
        found.append(grab.velocity()[0])
    # (0.1)·60, (0.3)/2·60, (0.6)/3·60, (1.0 − 0.1)/3·60 and (1.0 − 0.3)/3·60 m/s
    assert found == pytest.approx([6.0, 9.0, 12.0, 18.0, 14.0])


def test_a_patch_does_not_include_a_layer_behind_it(hanging: Simulation) -> None:
    folded = hanging.topology.start.copy()
    folded[45:] = folded[44:8:-1] + [0.0, 0.0, 0.01]
    hanging.set_state(folded)
    hanging.grab(2 * 9 + 4, radius=0.11)
    assert hanging.grabbed.tolist() == [22, 13, 21, 23, 31]


def test_pins_in_a_patch_stay_and_masses_are_restored_bit_for_bit(hanging: Simulation) -> None:
    masses = inverse_masses(hanging)
    grab = hanging.grab(13, radius=0.15)
    assert not set(hanging.grabbed) & set(range(9))
    assert (np.flatnonzero((inverse_masses(hanging) == 0) & (masses > 0)) == np.sort(hanging.grabbed)).all()
    pins = hanging.positions()[:9]
    grab.move_to(hanging.positions()[13] + [0.0, 0.0, 0.2])
    assert (run(hanging, 5)[:9] == pins).all()
    grab.release()
    assert (inverse_masses(hanging) == masses).all()


def test_release_and_reset_free_the_whole_patch(hanging: Simulation) -> None:
    masses = inverse_masses(hanging)
    grab = hanging.grab(MIDDLE, radius=0.2)
    grab.move_to((0.0, 1.0, 0.3))
    run(hanging, 3)
    grab.release()
    hanging.grab(80)
    assert hanging.grabbed.tolist() == [80]
    assert np.count_nonzero(inverse_masses(hanging) != masses) == 1
    hanging.grab(MIDDLE, radius=0.2).move_to((0.0, 1.0, 0.3))
    hanging.reset()
    assert len(hanging.grabbed) == 0
    assert (inverse_masses(hanging) == masses).all()
    assert (hanging.positions() == hanging.topology.start).all()


def test_a_patch_stays_grabbed_when_the_solver_is_switched(hanging: Simulation) -> None:
    """`verlet` stores velocities differently than `xpbd`, and the SIMD layout orders particles differently."""
    hanging.grab(MIDDLE, radius=0.2)
    grabbed, before = hanging.grabbed, run(hanging, 3)
    hanging.switch_solver("xpbd")
    assert (hanging.grabbed == grabbed).all()
    assert (run(hanging, 3)[grabbed] == before[grabbed]).all()


def test_a_patch_strains_a_fine_cloth_less_than_a_single_particle() -> None:
    """Pulled 0.5 m out of a sheet with cells of 3 cm: the longest spring at one particle, and around a patch."""
    scene = load_scene("curtain", rows=96, columns=96, wind_x=0.0, wind_z=0.0)
    strains = []
    for radius in (0.0, 0.1):
        with Simulation(scene) as simulation:
            grab = simulation.grab(48 * 96 + 48, radius)
            for k in range(20):
                grab.move_to((0.0, 2.2, 0.025 * (k + 1)))
                simulation.step()
            strains.append(simulation.metrics().max_strain)
    assert strains[1] < 0.6 * strains[0]  # 27 % instead of 50 %


# -- several grabs --------------------------------------------------------------------------------------------------


def test_several_grabs_are_moved_released_and_saved_independently(hanging: Simulation, tmp_path: Path) -> None:
    first = hanging.grab(MIDDLE, radius=0.11)
    first.move_to((0.0, 1.0, 0.0))
    second = hanging.grab(60)
    assert hanging.grabbed.tolist() == [MIDDLE, 31, 39, 41, 49, 60]
    for k in range(1, 5):
        first.move_to((0.0, 1.0, 0.02 * k))
        second.move_to(hanging.topology.start[60] + [0.03 * k, 0.0, 0.0])
        x = run(hanging, 1)
    assert x[MIDDLE] == pytest.approx([0.0, 1.0, 0.08], abs=1e-6)
    assert x[60] == pytest.approx(hanging.topology.start[60] + [0.12, 0.0, 0.0], abs=1e-6)
    hanging.save(tmp_path / "two.npz")
    second.release()
    assert (first.particles[0], second.active) == (MIDDLE, False)
    assert hanging.velocities()[60] == pytest.approx([1.8, 0.0, 0.0], abs=1e-4)
    hanging.load(tmp_path / "two.npz")
    assert [grab.particles.tolist() for grab in hanging.grab_handles] == [[MIDDLE, 31, 39, 41, 49], [60]]
    assert (first.active, second.active) == (True, False)  # `first` still held when the checkpoint was loaded
    with pytest.raises(ValueError, match="the grab was released; `grab_handles` of the simulation"):
        second.move_to((0.0, 0.0, 0.0))
    first.move_to((0.0, 1.0, 0.1))
    assert run(hanging, 1)[MIDDLE] == pytest.approx([0.0, 1.0, 0.1], abs=1e-6)
    hanging.reset()
    assert len(hanging.grabbed) == 0


def test_a_grabbed_particle_cannot_be_grabbed_again(hanging: Simulation) -> None:
    hanging.grab(MIDDLE, radius=0.11)
    with pytest.raises(ValueError, match="particle 41 is grabbed already"):
        hanging.grab(41)
    second = hanging.grab(42, radius=0.11)
    assert 41 not in second.particles


def test_the_number_of_grabs_is_limited(hanging: Simulation) -> None:
    for particle in range(9, 9 + MAX_GRABS):
        hanging.grab(particle)
    before = hanging.grabbed.tolist()
    with pytest.raises(ValueError, match=f"all {MAX_GRABS} grabs are in use"):
        hanging.grab(70)
    assert hanging.grabbed.tolist() == before


@pytest.mark.parametrize("number", [-1, MAX_GRABS, 0.0, True])
def test_an_event_with_an_invalid_grab_number_is_refused(hanging: Simulation, number: object) -> None:
    with pytest.raises(ValueError, match="grab"):
        hanging.apply(Event("grab", (70, 0.0, number)))
    with pytest.raises(ValueError, match=rf"there is no grab {number}|argument 1 of event move_grab must be int"):
        hanging.apply(Event("move_grab", (number, 0.0, 1.0, 0.0)))
    assert len(hanging.grabbed) == 0


# -- pins ----------------------------------------------------------------------------------------------------------


def test_a_particle_is_pinned_where_it_is_and_unpinned_again(hanging: Simulation) -> None:
    masses = inverse_masses(hanging)
    throw(hanging)
    position = run(hanging, 5)[MIDDLE]
    hanging.pin(MIDDLE)
    assert (run(hanging, 20)[MIDDLE] == position).all()
    assert hanging.topology.pinned[MIDDLE]
    hanging.pin(MIDDLE)  # has no effect
    hanging.unpin(MIDDLE)
    assert (inverse_masses(hanging) == masses).all()
    assert np.linalg.norm(run(hanging, 10)[MIDDLE] - position) > 0.01


def test_pinning_changes_no_other_position_or_velocity(hanging: Simulation) -> None:
    throw(hanging)
    x, v = run(hanging, 10), hanging.velocities()
    hanging.pin(MIDDLE)
    v[MIDDLE] = 0.0
    assert (hanging.positions() == x).all()
    assert hanging.velocities() == pytest.approx(v, abs=1e-4)  # `verlet` stores positions only


def test_reset_restores_the_pins_of_the_scene(hanging: Simulation) -> None:
    for pin in range(9):
        hanging.unpin(pin)
    hanging.pin(MIDDLE)
    throw(hanging)
    assert run(hanging, 60)[:9, 1].max() < 1.3  # they started at 1.4 m
    hanging.reset()
    assert np.flatnonzero(hanging.topology.pinned).tolist() == list(range(9))
    assert (run(hanging, 5)[:9] == hanging.topology.start[:9]).all()


def test_a_particle_pinned_while_grabbed_stays_where_it_is_released(hanging: Simulation) -> None:
    grab = hanging.grab(MIDDLE, radius=0.15)
    grab.move_to((0.0, 1.0, 0.2))
    run(hanging, 2)
    hanging.pin(MIDDLE)
    grab.move_to((0.0, 1.1, 0.3))
    run(hanging, 1)
    grab.release()
    assert run(hanging, 20)[MIDDLE] == pytest.approx([0.0, 1.1, 0.3], abs=1e-6)


def test_tethers_follow_the_pins() -> None:
    """A sheet that swings about a new pin stays within its tethers, and the old pins have none."""
    with Simulation(Scene(cloth=CLOTH, tethers=Tethers(1.0), forces=Forces(gravity=20.0))) as simulation:
        for pin in range(9):
            simulation.unpin(pin)
        simulation.pin(MIDDLE)
        throw(simulation)
        middle = simulation.positions()[MIDDLE]
        reach = np.linalg.norm(simulation.topology.flat - simulation.topology.flat[MIDDLE], axis=1)
        x = run(simulation, 60)
        assert x[:9, 1].max() < 1.0, "the top edge has not fallen"
        assert (np.linalg.norm(x - middle, axis=1) - reach).max() < 1e-5


def test_an_unpinned_particle_of_an_attachment_falls() -> None:
    rising = Attachment(pins=("top",), center=(0.0, 0.0, 0.0), keyframes=((0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 1.0, 0.0)))
    with Simulation(Scene(cloth=replace(CLOTH, pins=()), attachments=(rising,))) as simulation:
        for pin in range(7):
            simulation.unpin(pin)
        x = run(simulation, 30)
        assert x[7:9, 1] == pytest.approx([1.9, 1.9], abs=1e-5)
        assert x[0, 1] < 1.88


def test_the_minimum_of_stable_substeps_follows_the_pins() -> None:
    """With all but one corner pinned, only that corner vibrates, more slowly than the sheet."""
    sheet = replace(CLOTH, rows=3, columns=3, pins=())
    with Simulation(Scene(cloth=sheet, solver=Solver("explicit", 1, 1), fabric=Fabric(2e4, 2e4, 1e4))) as simulation:
        free = simulation.min_stable_substeps
        for particle in range(8):
            simulation.pin(particle)
        assert simulation.min_stable_substeps < 0.8 * free
        simulation.reset()
        assert simulation.min_stable_substeps == free


# -- scenes that change --------------------------------------------------------------------------------------------


def test_switch_scene_keeps_positions_and_changed_parameters() -> None:
    whole = Scene(
        cloth=CLOTH,
        ground=Ground(),
        strain_limit=StrainLimit(0.1),
        spheres=(Sphere(center=(0.0, 0.3, 0.5), radius=0.2, margin=0.15, friction=0.0),),
    )
    with Simulation(whole) as simulation:
        simulation.params["gravity"] = 4.0
        simulation.params["strain_limit"] = 0.3
        x, v = run(simulation, 10), simulation.velocities()
        simulation.switch_scene(replace(whole, strain_limit=None, spheres=()))
        assert (simulation.positions() == x).all()
        assert simulation.velocities() == pytest.approx(v, abs=1e-4)
        assert simulation.features == ("structural", "shear", "bend", "ground")
        assert simulation.params["gravity"] == 4.0
        with pytest.raises(ValueError, match="strain_limit"):
            simulation.params["strain_limit"]
        assert np.isfinite(run(simulation, 3)).all()
        simulation.switch_scene(replace(whole, forces=Forces(gravity=2.0)))
        assert (simulation.params["gravity"], simulation.params["strain_limit"]) == (2.0, 0.1)
        assert simulation.frame == 13


def test_another_solver_keeps_the_damping_and_stiffness_of_the_scene_that_was_switched_to(hanging: Simulation) -> None:
    first = hanging.scene.solver
    hanging.switch_scene(replace(hanging.scene, solver=replace(first, damping=0.1, stiffness=0.5, substeps=7)))
    for name, substeps in (("xpbd", SOLVER_CATALOG["xpbd"].substeps), (first.name, first.substeps)):
        hanging.switch_solver(name)
        assert (hanging.params["damping"], hanging.params["stiffness"]) == (0.1, 0.5)
        assert hanging.params["substeps"] == substeps


def test_a_scene_with_another_grid_is_refused_and_nothing_changes(hanging: Simulation) -> None:
    x = run(hanging, 3)
    with pytest.raises(UsageError, match="8 rows, the running cloth has 9"):
        hanging.switch_scene(replace(hanging.scene, cloth=replace(CLOTH, rows=8)))
    assert (hanging.positions() == x).all()


def test_cloth_inside_a_sphere_that_appears_is_pushed_out_slowly() -> None:
    whole = Scene(cloth=CLOTH, spheres=(Sphere(center=(0.0, 0.8, 0.0), radius=0.3, margin=0.15, friction=0.0),))
    with Simulation(replace(whole, spheres=())) as simulation:
        run(simulation, 2)
        simulation.switch_scene(whole)
        before = simulation.positions()
        assert np.linalg.norm(run(simulation, 1) - before, axis=1).max() < 0.05
        assert simulation.metrics().finite


def test_fabrics_are_switched_and_restored() -> None:
    scene = load_scene("drape15", solver="xpbd")
    with Simulation(scene) as simulation:
        x = run(simulation, 3)
        mass = simulation.topology.mass.sum()
        simulation.switch_fabric("denim")
        denim = load_scene("drape15", solver="xpbd", fabric="denim")
        assert (simulation.scene.fabric, simulation.scene.verlet) == (denim.fabric, denim.verlet)
        assert simulation.scene.cloth.area_density == denim.cloth.area_density
        assert simulation.topology.mass.sum() > 2 * mass
        assert (simulation.positions() == x).all()
        simulation.switch_solver("lines")
        simulation.switch_fabric("")
        assert simulation.scene.fabric == scene.fabric
        assert simulation.scene.cloth == scene.cloth
        assert simulation.solver.name == "lines"
