"""The Python API."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taichi_cloth as tc
from taichi_cloth import list_scenes, load_scene
from taichi_cloth.geometry.cloth_builder import build_topology
from taichi_cloth.scene.collider_schema import Ground, Sphere
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Forces, Scene, SelfCollision, Solver, Tearing, Wind
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG
from taichi_cloth.simulation import running_cloth
from taichi_cloth.simulation.builder import unusual
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import UsageError

SMALL = Scene(
    cloth=Cloth(rows=5, columns=6, width=1.0, height=0.8, center=(0.0, 2.0, 0.0)),
    wind=Wind(z=2.0),
    spheres=(Sphere(center=(0.0, 1.0, 1.0), radius=0.2, oscillation=(1.0, 0.0, 0.0), period=(4.0, 1.0, 1.0)),),
    ground=Ground(),
)


def resident_megabytes() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


def test_arrays_have_one_row_per_particle() -> None:
    with tc.Simulation(SMALL) as simulation:
        assert simulation.positions().shape == simulation.velocities().shape == (30, 3)
        assert simulation.positions()[0] == pytest.approx([-0.5, 2.4, 0.0])


def test_time_and_spheres_advance_with_the_frames() -> None:
    with tc.Simulation(SMALL) as simulation:
        assert (simulation.frame, simulation.seconds) == (0, 0)
        for _ in range(60):
            simulation.step()
        assert simulation.seconds == pytest.approx(1.0)
        sphere, ground = simulation.colliders()
        assert sphere.center == pytest.approx([1.0, 1.0, 1.0])  # a quarter of its period of 4 s: the largest deflection
        assert sphere.size[0] == 0.2
        assert ground.collider == SMALL.ground


def test_features_lists_what_the_scene_uses() -> None:
    with tc.Simulation(SMALL) as simulation:
        assert simulation.features == ("structural", "shear", "bend", "wind", "sphere", "ground")
    with tc.Simulation(replace(SMALL, wind=None, spheres=(), ground=None)) as simulation:
        assert simulation.features == ("structural", "shear", "bend")


def test_metrics_at_the_start() -> None:
    with tc.Simulation(SMALL) as simulation:
        metrics = simulation.metrics()
        assert metrics.max_strain == pytest.approx(0, abs=1e-6)
        assert metrics.kinetic_energy == 0
        assert metrics.potential_energy == pytest.approx(0.2 * 0.8 * 9.81 * 2.0)
        assert metrics.penetration == 0
        assert metrics.finite


@pytest.mark.parametrize("name", ["gravity", "wind_x", "wind_z", "stiffness", "damping", "sphere_radius", "substeps"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1e9, "3", None, True])
def test_an_invalid_parameter_value_raises_and_changes_nothing(name: str, value: Any) -> None:
    with tc.Simulation(SMALL) as simulation:
        before = simulation.params[name]
        with pytest.raises(ValueError, match=name):
            simulation.params[name] = value
        assert simulation.params[name] == before


def test_an_unknown_parameter_raises_and_is_named() -> None:
    with tc.Simulation(replace(SMALL, wind=None)) as simulation:
        for name in ("wind_x", "color"):
            with pytest.raises(ValueError, match=f"{name!r} is not a parameter"):
                simulation.params[name] = 1.0
            with pytest.raises(ValueError, match=f"{name!r} is not a parameter"):
                simulation.params[name]
            assert simulation.params.get(name, 0.0) == 0.0
        assert simulation.params.get("gravity") == simulation.params["gravity"]


@pytest.mark.parametrize("index", [-1, 30, 10**9])
def test_a_particle_that_does_not_exist_cannot_be_grabbed(index: int) -> None:
    with tc.Simulation(SMALL) as simulation, pytest.raises(ValueError, match=r"0\.\.29"):
        simulation.grab(index)


@pytest.mark.parametrize("target", [(0, 0), (0, 0, float("nan")), "abc", None, (0, 0, float("inf")), [[1, 2, 3]]])
def test_a_grab_target_must_be_three_finite_numbers(target: Any) -> None:
    with tc.Simulation(SMALL) as simulation:
        grab = simulation.grab(7)
        before = simulation.grabs[grab.number].target.tolist()
        with pytest.raises(ValueError, match="three finite numbers"):
            grab.move_to(target)
        assert simulation.grabs[grab.number].target.tolist() == before == simulation.positions()[7].tolist()


def test_a_released_particle_moves_while_another_stays_grabbed() -> None:
    with tc.Simulation(SMALL) as simulation:
        first = simulation.grab(7)
        first.move_to((0, 2, 1))
        simulation.step()
        second = simulation.grab(8)
        second.move_to((0, 2, 1))
        assert simulation.grabbed.tolist() == [7, 8]
        first.release()
        assert simulation.grabbed.tolist() == [8]
        assert (first.active, second.active) == (False, True)
        before = simulation.positions()[7]
        for _ in range(10):
            simulation.step()
        assert np.linalg.norm(simulation.positions()[7] - before) > 1e-3


def test_a_second_release_has_no_effect() -> None:
    with tc.Simulation(SMALL) as simulation:
        grab = simulation.grab(7)
        grab.release()
        before = simulation.velocities()
        grab.release()
        assert len(simulation.grabbed) == 0
        assert (simulation.velocities() == before).all()


def test_a_closed_simulation_raises() -> None:
    simulation = tc.Simulation(SMALL)
    simulation.close()
    simulation.close()
    for call in (simulation.step, simulation.positions, simulation.velocities, simulation.reset):
        with pytest.raises(RuntimeError, match="closed"):
            call()


def test_a_closed_simulation_takes_no_changes() -> None:
    simulation = tc.Simulation(SMALL)
    grab = simulation.grab(3)
    assert repr(grab) == "<GrabHandle 0: of 1 particle>"
    simulation.step(2)
    count = simulation.topology.particle_count
    assert repr(simulation) == f"<Simulation {SMALL.name!r}: frame 2, {count} particles>"
    simulation.close()
    assert repr(simulation) == f"<Simulation {SMALL.name!r}: closed>"
    with pytest.raises(RuntimeError, match="closed"):
        simulation.params.update(gravity=1.0)
    with pytest.raises(ValueError, match="the grab was released"):  # as all grabs of a closed simulation
        grab.move_to((0.0, 1.0, 0.0))


@pytest.mark.parametrize("frames", [-5, 1.0, "3", True])
@pytest.mark.parametrize("measure_error", [False, True])
def test_a_number_of_frames_that_is_none_is_refused(frames: int, measure_error: bool) -> None:
    with tc.Simulation(SMALL) as simulation:
        with pytest.raises(ValueError, match="frames must be an integer from 0, not"):
            simulation.step(frames, measure_error=measure_error)
        simulation.step(np.int64(0), measure_error=measure_error)
        assert simulation.frame == 0


def test_scene_parameters_and_frame_cannot_be_assigned() -> None:
    """`switch_scene`, an item of `params` and `reset` change them."""
    with tc.Simulation(SMALL) as simulation:
        for name, value in (("scene", SMALL), ("params", {"gravity": 1.0}), ("frame", 0)):
            with pytest.raises(AttributeError, match=f"property '{name}' of 'Simulation' object has no setter"):
                setattr(simulation, name, value)


def test_arrays_that_describe_the_cloth_cannot_be_written() -> None:
    """The fields of the simulation would not change."""
    with tc.Simulation(SMALL) as simulation:
        for name in ("mass", "rest", "pinned", "start"):
            with pytest.raises(ValueError, match="read-only"):
                getattr(simulation.topology, name)[:] = 1
        assert simulation.positions().shape == simulation.topology.start.shape


@pytest.mark.parametrize(
    ("columns", "fabric", "line"),
    [
        (7, {"weft": 600.0, "warp": 600.0, "shear": 600.0}, ""),
        (4, {"weft": 600.0, "warp": 900.0, "shear": 600.0}, "cells are 2:1: springs are 105% stiffer than the fabric"),
        (13, {"weft": 900.0, "warp": 600.0, "shear": 600.0}, "stiffer than the fabric along the warp; model"),
        (4, {"weft": 600.0, "warp": 900.0, "shear": 300.0}, "cells are 2:1: springs are 40% stiffer than the fabric"),
        (4, {"weft": 1500.0, "warp": 600.0, "shear": 450.0}, ""),
        (4, {"weft": 600.0, "warp": 600.0, "shear": 600.0, "model": "membrane"}, ""),
    ],
)
def test_warnings_name_fabrics_that_springs_cannot_be_on_long_cells(
    columns: int, fabric: dict[str, Any], line: str
) -> None:
    cloth = Cloth(rows=7, columns=columns, width=0.6, height=0.6)
    scene = Scene(cloth=cloth, fabric=Fabric(**fabric, bend_spring=0.0), solver=Solver(name="xpbd"))
    with Simulation(scene, "serial") as simulation:
        assert line in simulation.warnings
        assert ("cells" in simulation.warnings) == bool(line)


def test_warnings_name_what_a_fabric_loses_by_tearing() -> None:
    with tc.Simulation(tc.load_scene("tear", rows=5, columns=5)) as simulation:
        assert "bending" not in simulation.warnings
        simulation.switch_fabric("cotton")
        assert "tearing leaves out the bending stiffness of cotton" in simulation.warnings


def test_a_name_close_to_a_parameter_is_refused_as_an_attribute() -> None:
    with tc.Simulation(SMALL) as simulation:
        line = "a simulation has no attribute 'gravty'; did you mean params['gravity']?"
        with pytest.raises(AttributeError, match=re.escape(line)):
            simulation.gravty = 3  # type: ignore[attr-defined]
        simulation.label = "a name of your own"  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", ["gravity", "substeps", "wind_z"])
def test_a_parameter_assigned_as_an_attribute_is_refused(name: str) -> None:
    with tc.Simulation(replace(SMALL, wind=Wind())) as simulation:
        with pytest.raises(AttributeError, match=rf"^{name} is a runtime parameter: set params\['{name}'\]$"):
            setattr(simulation, name, 3)
        simulation.params[name] = 3
        assert simulation.params[name] == 3


def test_parameters_are_printed_with_their_values() -> None:
    with tc.Simulation(SMALL) as simulation:
        assert repr(simulation.params) == repr(dict(simulation.params))


def test_a_simulation_that_was_not_closed_releases_its_fields() -> None:
    for _ in range(530):  # Taichi crashes at the 513th field tree
        tc.Simulation(SMALL).step()
    kept = tc.Simulation(SMALL)
    start = kept.positions()
    tc.Simulation(SMALL).step()
    assert (kept.positions() == start).all()


def test_two_simulations_of_one_size_are_independent() -> None:
    with tc.Simulation(SMALL) as one, tc.Simulation(SMALL) as other:
        start = other.positions()
        one.step()
        assert (other.positions() == start).all()


def test_more_simulations_in_sequence_than_taichi_has_field_trees() -> None:
    """Taichi holds 512 field trees and keeps every compiled kernel: without reuse of fields it crashes or grows."""
    sizes = [(4 + k % 5, 5 + k % 3) for k in range(530)]
    after_first = 0.0
    for k, (rows, columns) in enumerate(sizes):
        with tc.Simulation(replace(SMALL, cloth=replace(SMALL.cloth, rows=rows, columns=columns))) as simulation:
            simulation.step()
            assert simulation.metrics().finite
        if k == 200 and Path("/proc/self/statm").exists():
            after_first = resident_megabytes()
    if after_first:
        assert resident_megabytes() - after_first < 5


# -- checkpoints ---------------------------------------------------------------------------------------------


def test_a_switched_solver_gets_its_default_settings_and_the_scene_s_solver_those_of_the_scene() -> None:
    with tc.Simulation(replace(SMALL, solver=Solver(substeps=1, iterations=5))) as simulation:
        for name in (*SOLVER_CATALOG, "verlet"):
            simulation.switch_solver(name)
            asked = simulation.params["substeps"], simulation.params["iterations"]
            assert asked == ((1, 5) if name == "verlet" else SOLVER_CATALOG[name].defaults)


def test_a_checkpoint_of_another_scene_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "save.npz"
    with tc.Simulation(SMALL) as simulation:
        simulation.save(path)
    with tc.Simulation(replace(SMALL, cloth=replace(SMALL.cloth, rows=6))) as other:
        start = other.positions()
        with pytest.raises(ValueError, match="rows"):
            other.load(path)
        assert (other.positions() == start).all()


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04 torn"])
def test_a_file_that_is_not_a_checkpoint_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "save.npz"
    path.write_bytes(content)
    with tc.Simulation(SMALL) as simulation, pytest.raises(ValueError, match=r"save\.npz"):
        simulation.load(path)


def test_a_truncated_checkpoint_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "save.npz"
    with tc.Simulation(SMALL) as simulation:
        simulation.save(path)
        whole = path.read_bytes()
        for length in (len(whole) // 3, len(whole) - 30):
            path.write_bytes(whole[:length])
            with pytest.raises(ValueError, match=r"save\.npz"):
                simulation.load(path)


def test_a_failed_save_keeps_the_old_file_and_leaves_no_partial_file(tmp_path: Path) -> None:
    path = tmp_path / "save.npz"
    with tc.Simulation(SMALL) as simulation:
        simulation.save(path)
        before = path.read_bytes()
        with pytest.raises(OSError, match=r"save\.npz"):
            simulation.save(path / "inside_a_file.npz")
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["save.npz"]


def test_set_state_sets_positions_and_velocities() -> None:
    with tc.Simulation(replace(SMALL, wind=None, solver=Solver("explicit"))) as simulation:
        start = simulation.topology.start
        simulation.set_state(start + [0.0, 1.0, 0.0], (0.0, 0.0, 2.0))
        assert simulation.positions() == pytest.approx(start + [0.0, 1.0, 0.0], abs=1e-6)
        v = simulation.velocities()
        assert v[~simulation.topology.pinned] == pytest.approx(np.tile([0.0, 0.0, 2.0], (24, 1)))
        assert not v[simulation.topology.pinned].any()
        simulation.step()
        pins = simulation.topology.pinned
        assert simulation.positions()[pins] == pytest.approx((start + [0.0, 1.0, 0.0])[pins], abs=1e-6)


def test_a_run_continues_from_a_stored_state_with_its_frame() -> None:
    """Gusts and a collider that moves follow the time; explicit steps have no other state."""
    with tc.Simulation(replace(SMALL, wind=Wind(z=6.0, turbulence=0.9), solver=Solver("explicit"))) as simulation:
        simulation.step(20)
        frame, x, v = simulation.frame, simulation.positions(), simulation.velocities()
        simulation.step(5)
        expected = simulation.positions()
        simulation.reset()
        simulation.set_state(x, v, np.int64(frame))  # type: ignore[arg-type]
        assert simulation.frame == 20
        simulation.step(5)
        assert simulation.positions() == pytest.approx(expected, abs=1e-5)
        simulation.set_state(x, v)
        assert simulation.frame == 25
        simulation.step(5)
        assert np.abs(simulation.positions() - expected).max() > 1e-3


@pytest.mark.parametrize("frame", [-1, 1.5, True, "1", 10**9 + 1, 10**19])
def test_set_state_with_an_invalid_frame_raises_and_changes_nothing(frame: Any) -> None:
    with tc.Simulation(SMALL) as simulation:
        start = simulation.positions()
        with pytest.raises(
            ValueError,
            match=r"frame must be (an integer from 0|at most 10+, not)",
        ):
            simulation.set_state(start + 1.0, frame=frame)
        assert (simulation.positions() == start).all()
        assert simulation.frame == 0


@pytest.mark.parametrize("values", [[1.0, 2.0], "here", [[float("nan")] * 3] * 30])
def test_set_state_with_invalid_positions_raises_and_changes_nothing(values: Any) -> None:
    with tc.Simulation(SMALL) as simulation:
        with pytest.raises(
            ValueError, match=r"positions must be numbers of shape \(30, 3\)|invalid number in positions: not finite"
        ):
            simulation.set_state(values)
        assert simulation.positions() == pytest.approx(simulation.topology.start, abs=1e-6)


def test_far_from_the_origin_results_have_the_same_rounding() -> None:
    """At a distance of whole blocks of 8 m every position, collider and grab has the same bits (accuracy C33)."""
    away = np.array([9600.0, 0.0, -800.0])
    near = tc.load_scene("curtain", wind_x=0.0, wind_z=0.0)
    spheres = tuple(replace(one, center=tuple(np.add(one.center, away))) for one in near.spheres)
    far = replace(near, cloth=replace(near.cloth, center=tuple(np.add(near.cloth.center, away))), spheres=spheres)
    ends, velocities = [], []
    for scene, shift in ((near, np.zeros(3)), (far, away)):
        with tc.Simulation(scene) as simulation:
            for k in range(40):
                if k == 10:
                    simulation.grab(400).move_to(simulation.positions()[400] + [0.0, 0.0, 0.25])
                simulation.step()
            assert simulation.colliders()[0].center == pytest.approx(simulation.scene.spheres[0].center, abs=1.5)
            ends.append(simulation.positions() - shift)
            velocities.append(simulation.velocities())
    assert np.abs(ends[0] - ends[1]).max() < 1e-11  # the rounding error of float64 at 10 km is 1e-12
    assert (velocities[0] == velocities[1]).all()


def test_gusts_do_not_depend_on_the_local_origin(monkeypatch: pytest.MonkeyPatch) -> None:
    ends = []
    for spacing in (8.0, 1.0):
        monkeypatch.setattr("taichi_cloth.geometry.topology.ORIGINS", spacing)
        with tc.Simulation(tc.load_scene("curtain")) as simulation:
            for _ in range(10):
                simulation.step()
            ends.append(simulation.positions())
    assert np.abs(ends[0] - ends[1]).max() < 2e-5
    assert (ends[0] != ends[1]).any()


def test_springs_too_stiff_for_their_particles_are_refused_and_nothing_changes() -> None:
    scene = tc.load_scene("curtain", solver_name="verlet", warp=1e9, weft=1e9, width=0.4, area_density=0.001)
    with pytest.raises(UsageError, match=r"curtain: explicit needs [\d,]+ substeps a frame, more than 200,000"):
        tc.Simulation(replace(scene, solver=replace(scene.solver, name="explicit")))
    with tc.Simulation(scene) as simulation:
        simulation.step()
        x, v = simulation.positions(), simulation.velocities()
        with pytest.raises(UsageError, match="substeps"):
            simulation.switch_solver("explicit")
        assert simulation.solver.name == "verlet"
        assert (simulation.positions() == x).all()
        assert simulation.velocities() == pytest.approx(v, abs=1e-3)  # verlet stores positions only
        simulation.step()
        assert simulation.metrics().finite


# -- a rebuild that fails ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("failure", [KeyboardInterrupt, ValueError])
@pytest.mark.parametrize("where", ["build", "parameters_of", "StepRow", "upload_all"])
def test_a_rebuild_that_is_interrupted_leaves_the_earlier_cloth(
    monkeypatch: pytest.MonkeyPatch, failure: type[BaseException], where: str
) -> None:
    scene = Scene(cloth=Cloth(rows=5, columns=5), tearing=Tearing(strain=0.9), solver=Solver("xpbd", 4, 4))
    with Simulation(scene) as simulation:
        torn = np.arange(len(simulation.torn)) == 30
        simulation.set_torn(torn)
        simulation.params["gravity"] = 3.0
        simulation.step(3)
        x, params, v = simulation.positions(), dict(simulation.params), simulation.velocities()
        with monkeypatch.context() as patch:
            fail_once(patch, where, failure)
            with pytest.raises(failure):
                simulation.switch_scene(replace(scene, tearing=None, forces=Forces(gravity=1.0)))
        with Simulation(scene) as other:  # takes what was released
            other.step()
            np.testing.assert_array_equal(simulation.positions(), x)
            np.testing.assert_array_equal(simulation.torn, torn)
            assert simulation.velocities() == pytest.approx(v, abs=1e-3)
            assert (simulation.scene, dict(simulation.params)) == (scene, params)
            simulation.step()


def fail_once(patch: pytest.MonkeyPatch, where: str, failure: type[BaseException], times: int = 1) -> None:
    """Let the first calls of a function of `running_cloth` raise."""
    real, calls = getattr(running_cloth, where), []

    def failing(*arguments: Any, **named: Any) -> Any:
        calls.append(where)
        if len(calls) <= times:
            raise failure
        return real(*arguments, **named)

    patch.setattr(running_cloth, where, failing)


def test_a_simulation_that_cannot_be_built_again_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(cloth=Cloth(rows=5, columns=5), solver=Solver("xpbd", 4, 4))
    with Simulation(scene) as simulation:
        fail_once(monkeypatch, "build", KeyboardInterrupt, 2)
        with pytest.raises(KeyboardInterrupt):
            simulation.switch_fabric("denim")
        assert simulation.closed
        with Simulation(scene) as other:
            other.step()
        with pytest.raises(RuntimeError, match="closed"):
            simulation.step()


@pytest.mark.parametrize(("density", "named"), [(0.2, False), (10.0, False), (150.0, True)])
def test_an_area_density_that_may_be_meant_in_grams_is_named(density: float, named: bool) -> None:
    with Simulation(Scene(cloth=Cloth(rows=3, columns=3, area_density=density))) as simulation:
        line = "cloth.area_density is 150 kg/m²: fabrics have 0.02 to 2"
        assert (line in simulation.warnings) is named


SHEET = Cloth(rows=11, columns=11, width=1.0, height=1.0, center=(0.0, 1.0, 0.0))  # cells of 10 cm


@pytest.mark.parametrize(
    ("contact", "line"),
    [
        ({"thickness": 0.091}, ""),
        ({"thickness": 0.149}, ""),
        ({"thickness": 0.08}, "80 mm is 0.8 cells: layers can come as near as 37 mm; primitives"),
        ({"thickness": 0.05}, "50 mm is 0.5 cells: layers can come as near as 0 mm; primitives"),
        ({"thickness": 0.2}, "200 mm is 2 cells: layers stay 200 mm apart, and one cell is enough"),
        ({"thickness": 0.059, "primitives": "triangles"}, ""),
        ({"thickness": 0.08, "primitives": "triangles"}, "80 mm is 0.8 cells: with triangles up to 0.6 are fast"),
        ({"thickness": 0.08, "penetration_free": True}, "80 mm is 0.8 cells: with triangles up to 0.6 are fast"),
    ],
)
def test_a_thickness_that_does_not_suit_the_cells_is_named(contact: dict[str, Any], line: str) -> None:
    scene = Scene(cloth=SHEET, self_collision=SelfCollision(**contact))
    found = unusual(scene, build_topology(scene, "verlet"))
    assert [one.startswith(f"self_collision.thickness of {line}") for one in found] == ([True] if line else [])


def test_particles_of_a_layer_come_as_near_to_those_of_another_as_the_line_says() -> None:
    """Over the middles of cells: the nearest position in which no distance is below the thickness."""
    flat = build_topology(Scene(cloth=SHEET), "verlet").start[:, :2]
    for thickness in (0.08, 0.089):
        heights = np.linspace(0.0, 0.1, 2001)
        shifts = np.array([[x, y] for x in np.linspace(0, 0.1, 21) for y in np.linspace(0, 0.1, 21)])
        across = np.linalg.norm(flat[None, :] - (flat[60] + shifts)[:, None], axis=2).min(axis=1)
        free = across[:, None] ** 2 + heights**2 >= thickness**2
        nearest = heights[free.any(axis=0).argmax()]
        assert nearest == pytest.approx(np.sqrt(thickness**2 - 0.1**2 / 2), abs=1e-4)


def test_python_is_told_what_check_tells(tmp_path: Path) -> None:
    inside = Scene(cloth=SHEET, spheres=(Sphere(center=(0.0, 1.0, 0.0), radius=0.05),), forces=Forces(gravity=-9.81))
    with Simulation(inside) as simulation:
        assert "gravity points up" in simulation.warnings
        assert "1 particle inside a collider at the start" in simulation.warnings
    (tmp_path / "mm.obj").write_text("v 0 0 0\nv 900 0 0\nv 0 0 900\nf 1 2 3\n")
    large = Scene(cloth=Cloth(file="mm.obj", folder=str(tmp_path), pins=(0,)))
    with Simulation(large) as simulation:
        assert "the cloth is 900 m long: cloth.scale is" in simulation.warnings
    with Simulation(replace(large, cloth=replace(large.cloth, scale=1e-3))) as simulation:
        assert "long" not in simulation.warnings


@pytest.mark.parametrize("name", list_scenes())
def test_no_shipped_scene_is_unusual(name: str) -> None:
    scene = load_scene(name)
    assert unusual(scene, build_topology(scene, SOLVER_CATALOG[scene.solver.name].stiffness_section)) == ()


def test_a_checkpoint_can_be_in_memory() -> None:
    with Simulation(Scene(cloth=SHEET)) as simulation:
        simulation.step(3)
        stored = io.BytesIO()
        simulation.save(stored)
        ends = []
        for _ in range(2):
            stored.seek(0)
            simulation.load(stored)
            assert simulation.frame == 3
            simulation.step(3)
            ends.append(simulation.positions())
        np.testing.assert_array_equal(*ends)
        with pytest.raises(ValueError, match="checkpoint: not a checkpoint"):
            simulation.load(io.BytesIO(b"nothing"))
        np.testing.assert_array_equal(simulation.positions(), ends[1])
