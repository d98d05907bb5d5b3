"""The Python API: what a program may rely on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import taichi_cloth as tc
from taichi_cloth.errors import WrongUse
from taichi_cloth.scene.model import USUAL, Cloth, Ground, Scene, Solver, Sphere, Wind

SMALL = Scene(
    cloth=Cloth(rows=5, columns=6, width=1.0, height=0.8, center=(0.0, 2.0, 0.0)),
    wind=Wind(z=2.0),
    spheres=(Sphere(center=(0.0, 1.0, 1.0), radius=0.2, sway=(1.0, 0.0, 0.0), period=(4.0, 1.0, 1.0)),),
    ground=Ground(),
)


def resident_megabytes() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


def test_arrays_have_a_row_for_every_particle() -> None:
    with tc.Simulation(SMALL) as simulation:
        assert simulation.positions().shape == simulation.velocities().shape == (30, 3)
        assert simulation.positions()[0] == pytest.approx([-0.5, 2.4, 0.0])


def test_time_and_spheres_go_on_with_the_frames() -> None:
    with tc.Simulation(SMALL) as simulation:
        assert (simulation.frame, simulation.seconds) == (0, 0)
        for _ in range(60):
            simulation.advance_frame()
        assert simulation.seconds == pytest.approx(1.0)
        ball, ground = simulation.bodies()
        assert ball.center == pytest.approx([1.0, 1.0, 1.0])  # a quarter of its 4 s: at the end of its sway
        assert ball.size[0] == 0.2
        assert ground.collider == SMALL.ground


def test_stages_name_what_is_on() -> None:
    with tc.Simulation(SMALL) as simulation:
        assert simulation.stages == ("structural", "shear", "bend", "wind", "sphere", "ground")
    with tc.Simulation(replace(SMALL, wind=None, spheres=(), ground=None)) as simulation:
        assert simulation.stages == ("structural", "shear", "bend")


def test_measure_at_the_start() -> None:
    with tc.Simulation(SMALL) as simulation:
        measures = simulation.measure()
        assert measures.max_strain == pytest.approx(0, abs=1e-6)
        assert measures.kinetic_energy == 0
        assert measures.potential_energy == pytest.approx(0.2 * 0.8 * 9.81 * 2.0)
        assert measures.penetration == 0
        assert measures.finite


@pytest.mark.parametrize("name", ["gravity", "wind_x", "wind_z", "stiffness", "damping", "sphere_radius", "substeps"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1e9, "3", None, True])
def test_a_bad_value_is_refused_and_changes_nothing(name: str, value: object) -> None:
    with tc.Simulation(SMALL) as simulation:
        before = simulation.get(name)
        with pytest.raises(ValueError, match=name):
            simulation.set(name, value)
        assert simulation.get(name) == before


def test_an_unknown_parameter_is_refused_by_name() -> None:
    with tc.Simulation(replace(SMALL, wind=None)) as simulation:
        for name in ("wind_x", "colour"):
            with pytest.raises(ValueError, match=name):
                simulation.set(name, 1.0)
            with pytest.raises(ValueError, match="gravity"):
                simulation.get(name)


@pytest.mark.parametrize("index", [-1, 30, 10**9])
def test_a_particle_that_does_not_exist_cannot_be_grabbed(index: int) -> None:
    with tc.Simulation(SMALL) as simulation, pytest.raises(ValueError, match="29"):
        simulation.grab(index, (0, 0, 0))


@pytest.mark.parametrize("target", [(0, 0), (0, 0, float("nan")), "abc", None, (0, 0, float("inf")), [[1, 2, 3]]])
def test_a_target_must_be_a_point(target: object) -> None:
    with tc.Simulation(SMALL) as simulation:
        with pytest.raises(ValueError, match="three finite numbers"):
            simulation.grab(7, target)
        assert simulation.grabbed is None


def test_grabbing_another_particle_lets_go_of_the_first() -> None:
    with tc.Simulation(SMALL) as simulation:
        simulation.grab(7, (0, 2, 1))
        simulation.advance_frame()
        simulation.grab(8, (0, 2, 1))
        assert simulation.grabbed == 8
        before = simulation.positions()[7]
        for _ in range(10):
            simulation.advance_frame()
        assert np.linalg.norm(simulation.positions()[7] - before) > 1e-3


def test_release_of_nothing_does_nothing() -> None:
    with tc.Simulation(SMALL) as simulation:
        simulation.release()
        assert simulation.grabbed is None


def test_a_closed_simulation_says_so() -> None:
    simulation = tc.Simulation(SMALL)
    simulation.close()
    simulation.close()
    for call in (simulation.advance_frame, simulation.positions, simulation.velocities, simulation.reset):
        with pytest.raises(RuntimeError, match="closed"):
            call()


def test_a_simulation_that_nobody_closed_gives_its_fields_back_too() -> None:
    for _ in range(530):  # Taichi crashes at the 513th field tree
        tc.Simulation(SMALL).advance_frame()
    kept = tc.Simulation(SMALL)
    start = kept.positions()
    tc.Simulation(SMALL).advance_frame()
    assert (kept.positions() == start).all()


def test_two_simulations_of_one_size_do_not_touch_each_other() -> None:
    with tc.Simulation(SMALL) as one, tc.Simulation(SMALL) as other:
        start = other.positions()
        one.advance_frame()
        assert (other.positions() == start).all()


def test_more_simulations_one_after_another_than_there_are_field_trees() -> None:
    """Taichi holds 512 field trees and keeps every compiled kernel: without reuse this crashes or grows."""
    sizes = [(4 + k % 5, 5 + k % 3) for k in range(530)]
    after_first = 0.0
    for k, (rows, columns) in enumerate(sizes):
        with tc.Simulation(replace(SMALL, cloth=replace(SMALL.cloth, rows=rows, columns=columns))) as simulation:
            simulation.advance_frame()
            assert simulation.measure().finite
        if k == 200 and Path("/proc/self/statm").exists():
            after_first = resident_megabytes()
    if after_first:
        assert resident_megabytes() - after_first < 5


# -- saves -------------------------------------------------------------------------------------------------


def test_another_method_takes_its_usual_numbers_and_the_scene_s_own_method_those_of_the_scene() -> None:
    with tc.Simulation(replace(SMALL, solver=Solver(substeps=1, iterations=5))) as simulation:
        for name in (*USUAL, "verlet"):
            simulation.change_solver(name)
            asked = simulation.get("substeps"), simulation.get("iterations")
            assert asked == ((1, 5) if name == "verlet" else USUAL[name])


def test_a_save_of_another_scene_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "save.npz"
    with tc.Simulation(SMALL) as simulation:
        simulation.save(path)
    with tc.Simulation(replace(SMALL, cloth=replace(SMALL.cloth, rows=6))) as other:
        start = other.positions()
        with pytest.raises(ValueError, match="rows"):
            other.load(path)
        assert (other.positions() == start).all()


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04 torn"])
def test_a_file_that_is_no_save_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "save.npz"
    path.write_bytes(content)
    with tc.Simulation(SMALL) as simulation, pytest.raises(ValueError, match=r"save\.npz"):
        simulation.load(path)


def test_a_torn_save_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "save.npz"
    with tc.Simulation(SMALL) as simulation:
        simulation.save(path)
        whole = path.read_bytes()
        for length in (len(whole) // 3, len(whole) - 30):
            path.write_bytes(whole[:length])
            with pytest.raises(ValueError, match=r"save\.npz"):
                simulation.load(path)


def test_a_save_that_fails_leaves_the_old_one_and_no_rest(tmp_path: Path) -> None:
    path = tmp_path / "save.npz"
    with tc.Simulation(SMALL) as simulation:
        simulation.save(path)
        before = path.read_bytes()
        with pytest.raises(OSError, match="missing"):
            simulation.save(tmp_path / "missing" / "save.npz")
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["save.npz"]


def test_place_puts_and_throws_the_cloth() -> None:
    with tc.Simulation(replace(SMALL, wind=None, solver=Solver("spring"))) as simulation:
        start = simulation.topology.start
        simulation.place(start + [0.0, 1.0, 0.0], (0.0, 0.0, 2.0))
        assert simulation.positions() == pytest.approx(start + [0.0, 1.0, 0.0], abs=1e-6)
        v = simulation.velocities()
        assert v[~simulation.topology.pinned] == pytest.approx(np.tile([0.0, 0.0, 2.0], (24, 1)))
        assert not v[simulation.topology.pinned].any()
        simulation.advance_frame()
        pins = simulation.topology.pinned
        assert simulation.positions()[pins] == pytest.approx((start + [0.0, 1.0, 0.0])[pins], abs=1e-6)


@pytest.mark.parametrize("values", [[1.0, 2.0], "here", [[float("nan")] * 3] * 30])
def test_place_refuses_what_is_no_place_and_changes_nothing(values: object) -> None:
    with tc.Simulation(SMALL) as simulation:
        with pytest.raises(
            ValueError, match=r"positions (are 30 times three numbers|hold a number that is not finite)"
        ):
            simulation.place(values)  # type: ignore[arg-type]
        assert simulation.positions() == pytest.approx(simulation.topology.start, abs=1e-6)


def test_far_from_the_origin_nothing_is_rounded_that_is_not_so_near_it() -> None:
    """Whole blocks of 8 m away every place, collider and hand is the same, to the last bit (accuracy C33)."""
    away = np.array([9600.0, 0.0, -800.0])
    near = tc.load_scene("curtain", wind_x=0.0, wind_z=0.0)
    moved = {"center": tuple(np.add(near.cloth.center, away))}
    spheres = tuple(replace(ball, center=tuple(np.add(ball.center, away))) for ball in near.spheres)
    far = replace(near, cloth=replace(near.cloth, **moved), spheres=spheres)
    ends, velocities = [], []
    for scene, shift in ((near, np.zeros(3)), (far, away)):
        with tc.Simulation(scene) as simulation:
            for k in range(40):
                if k == 10:
                    simulation.grab(400, simulation.positions()[400] + [0.0, 0.0, 0.25])
                simulation.advance_frame()
            assert simulation.bodies()[0].center == pytest.approx(simulation.scene.spheres[0].center, abs=1.5)
            ends.append(simulation.positions() - shift)
            velocities.append(simulation.velocities())
    assert np.abs(ends[0] - ends[1]).max() < 1e-11  # float64 rounds them by 1e-12 at 10 km
    assert (velocities[0] == velocities[1]).all()


def test_gusts_do_not_depend_on_where_places_are_kept_from(monkeypatch: pytest.MonkeyPatch) -> None:
    ends = []
    for apart in (8.0, 1.0):
        monkeypatch.setattr("taichi_cloth.mesh.topology.ORIGINS", apart)
        with tc.Simulation(tc.load_scene("curtain")) as simulation:
            for _ in range(10):
                simulation.advance_frame()
            ends.append(simulation.positions())
    assert np.abs(ends[0] - ends[1]).max() < 2e-5
    assert (ends[0] != ends[1]).any()


def test_springs_too_stiff_for_their_particles_are_refused_and_nothing_is_lost() -> None:
    scene = tc.load_scene("curtain", solver_name="verlet", warp=1e9, weft=1e9, width=0.4, area_density=0.001)
    with pytest.raises(WrongUse, match=r"curtain: spring would take [\d,]+ substeps a frame, more than 200,000"):
        tc.Simulation(replace(scene, solver=replace(scene.solver, name="spring")))
    with tc.Simulation(scene) as simulation:
        simulation.advance_frame()
        x, v = simulation.positions(), simulation.velocities()
        with pytest.raises(WrongUse, match="substeps"):
            simulation.change_solver("spring")
        assert simulation.solver.name == "verlet"
        assert (simulation.positions() == x).all()
        assert simulation.velocities() == pytest.approx(v, abs=1e-3)  # verlet keeps places alone
        simulation.advance_frame()
        assert simulation.measure().finite
