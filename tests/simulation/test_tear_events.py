"""Tearing of a running cloth: when springs tear, and the remaining cloth in metrics, checkpoints and images."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taichi_cloth.export.clip import replay
from taichi_cloth.geometry.scene_loader import check_scene, load_scene
from taichi_cloth.geometry.tearing import TearState
from taichi_cloth.render.draw_list import VIEWS, DrawList
from taichi_cloth.scene import SceneError
from taichi_cloth.scene.fabric_schema import Fabric, VerletSprings
from taichi_cloth.scene.schema import Cloth, Scene, SelfCollision, Solver, Tearing, Tethers, Wind
from taichi_cloth.simulation.recording import Recorder
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers import SOLVERS
from taichi_cloth.system.errors import UsageError

G = 9.81
LOAD = 0.5  # [kg] added to each of the two lower corners
STIFF = 1000.0  # [N/m] force per meter of width and strain
STRIP = Cloth(
    rows=6, columns=3, width=0.2, height=0.5, center=(0.0, 0.0, 0.0), area_density=0.01, pins=("top",), corner_mass=LOAD
)
STATIC = 2 * LOAD * G / (STIFF * STRIP.width)  # strain of the hanging strip: 4.9 %


def strip(solver: str, strain: float, **parts: Any) -> Scene:
    """A loaded strip of three columns without bend springs, which tears at `strain`."""
    fabric = Fabric(warp=STIFF, weft=STIFF, shear=300.0, bend_spring=0.0)
    parts = {"fabric": fabric, "verlet": VerletSprings(bend=0.0), "tearing": Tearing(strain), **parts}
    return Scene(cloth=STRIP, solver=Solver(name=solver, substeps=20, iterations=20, damping=0.0), **parts)


def tear_state(simulation: Simulation) -> TearState:
    assert simulation._tear is not None
    return simulation._tear


@pytest.mark.parametrize(
    "solver", [name for name, kind in SOLVERS.items() if not kind.info.grid_only and name != "verlet"]
)
def test_a_load_beyond_the_tearing_strain_tears_the_strip_and_falls_freely(solver: str) -> None:
    # Released without strain it swings to twice the static strain, and a little more at its corners.
    with Simulation(strip(solver, 4 * STATIC)) as simulation:
        for _ in range(30):
            simulation.step()
        assert simulation.topology.spring_count == tear_state(simulation).untorn.spring_count
    with Simulation(strip(solver, 0.8 * STATIC)) as simulation:
        while tear_state(simulation).remaining() is tear_state(simulation).untorn:
            simulation.step()
            assert simulation.frame < 30
        for _ in range(40):
            simulation.step()
        falling = simulation.velocities()[:, 1]
        simulation.step()
        # The lowest row is no longer connected to a pin.
        change = simulation.velocities()[-3:, 1] - falling[-3:]
        mass = simulation.topology.mass[-3:]
        assert change @ mass / mass.sum() == pytest.approx(-G / 60, rel=0.02)


def test_verlet_tears() -> None:
    with Simulation(strip("verlet", 0.02, verlet=VerletSprings(structural=0.05, shear=0.05, bend=0.0))) as simulation:
        for _ in range(30):
            simulation.step()
        assert simulation.topology.spring_count < tear_state(simulation).untorn.spring_count


def heavy_sheet(solver: str = "xpbd", **parts: Any) -> Scene:
    """A sheet between two pinned edges, heavy enough to tear."""
    cloth = Cloth(rows=8, columns=9, width=0.8, height=0.7, pins=("left", "right"), area_density=6.0)
    fabric = Fabric(warp=300.0, weft=300.0, shear=100.0, bend_spring=1.0)
    return Scene(cloth=cloth, fabric=fabric, solver=Solver(name=solver, substeps=20), tearing=Tearing(0.1), **parts)


def run(simulation: Simulation, frames: int) -> np.ndarray:
    for _ in range(frames):
        simulation.step()
    return simulation.positions()


def test_reset_restores_all_springs_bit_for_bit() -> None:
    with Simulation(heavy_sheet()) as simulation:
        first = run(simulation, 60)
        assert simulation.topology.spring_count < tear_state(simulation).untorn.spring_count
        simulation.reset()
        assert simulation.topology is tear_state(simulation).untorn
        np.testing.assert_array_equal(run(simulation, 60), first)


def test_a_checkpoint_stores_torn_springs(tmp_path: Path) -> None:
    with Simulation(heavy_sheet()) as simulation:
        run(simulation, 40)
        left = simulation.topology.spring_count
        simulation.save(tmp_path / "save.npz")
        expected = run(simulation, 20)
    with Simulation(heavy_sheet()) as simulation:
        simulation.load(tmp_path / "save.npz")
        assert simulation.topology.spring_count == left < tear_state(simulation).untorn.spring_count
        np.testing.assert_array_equal(run(simulation, 20), expected)


def test_torn_springs_stay_torn_when_the_solver_is_switched() -> None:
    with Simulation(heavy_sheet()) as simulation:
        run(simulation, 40)
        ends = {tuple(pair) for pair in tear_state(simulation).ends.tolist()}
        simulation.switch_solver("explicit")
        assert ends
        assert {tuple(pair) for pair in tear_state(simulation).ends.tolist()} == ends
        with pytest.raises(UsageError, match="lines needs a grid with whole rows, and tearing breaks rows"):
            simulation.switch_solver("lines")
        assert {tuple(pair) for pair in tear_state(simulation).ends.tolist()} == ends
        assert simulation.metrics().finite


def test_the_parallel_layout_tears_the_same_springs() -> None:
    torn = {}
    for layout in ("serial", "parallel"):
        with Simulation(heavy_sheet("explicit", wind=Wind(z=5.0)), layout) as simulation:
            run(simulation, 60)
            torn[layout] = tear_state(simulation).torn
    assert torn["serial"].any()
    np.testing.assert_array_equal(torn["serial"], torn["parallel"])


def test_images_show_the_remaining_cloth() -> None:
    with Simulation(heavy_sheet()) as simulation:
        draw_list = DrawList(simulation)
        whole = {view: draw_list.update(view, (3.0, 2.0, 5.0)).corners for view in VIEWS}
        run(simulation, 60)
        left = {view: draw_list.update(view, (3.0, 2.0, 5.0)).corners for view in VIEWS}
        draw_list.close()
        lost = tear_state(simulation).untorn.triangle_count - simulation.topology.triangle_count
        assert lost > 0
        assert whole["shaded"] - left["shaded"] == 3 * lost
        assert left["wireframe"] < whole["wireframe"]
        assert left["particles"] == whole["particles"]


def test_it_stays_finite_with_every_feature_and_random_grabs() -> None:
    scene = heavy_sheet(
        wind=Wind(z=20.0), self_collision=SelfCollision(thickness=0.03, primitives="triangles"), tethers=Tethers()
    )
    with Simulation(replace(scene, tearing=Tearing(0.05))) as simulation:
        random = np.random.default_rng(0)
        for _ in range(9):
            grab = simulation.grab(int(random.integers(simulation.topology.particle_count)))
            for _ in range(10):
                grab.move_to(random.normal(size=3) * 2)
                simulation.step()
            grab.release()
        run(simulation, 60)
        metrics = simulation.metrics()
        assert metrics.finite
        assert simulation.topology.spring_count < tear_state(simulation).untorn.spring_count / 2
        assert np.isfinite(metrics.kinetic_energy)
        assert metrics.intersections is not None


def test_a_scene_without_tearing_keeps_the_simd_layout() -> None:
    with Simulation(replace(heavy_sheet(), tearing=None)) as simulation:
        assert simulation.solver.layout_name == "simd"
        assert "tearing" not in simulation.features
        assert run(simulation, 1) is not None
        assert simulation.topology.spring_count


def test_layouts_solvers_and_fabrics_that_do_not_support_tearing_are_refused() -> None:
    with pytest.raises(UsageError, match="layout simd is not supported: tearing breaks rows"):
        Simulation(heavy_sheet(), "simd")
    with pytest.raises(
        UsageError,
        match=r"lines needs a grid with whole rows, and tearing breaks rows; use verlet, xpbd, explicit",
    ):
        Simulation(heavy_sheet("lines"))
    with pytest.raises(SceneError, match=r"set fabric\.bending_stiffness to 0"):
        check_scene(replace(heavy_sheet(), fabric=Fabric(bending_stiffness=1e-5)))


def test_a_mesh_tears_where_it_is_grabbed() -> None:
    scene = replace(load_scene("round", preset="", bending_stiffness=0.0), tearing=Tearing(0.1))
    with Simulation(scene) as simulation:
        rim = int(np.linalg.norm(simulation.topology.flat[:, [0, 2]], axis=1).argmax())
        start = simulation.positions()[rim]
        grab = simulation.grab(rim)
        for k in range(60):
            grab.move_to(start + [0.02 * k, 0.02 * k, 0.0])
            simulation.step()
        whole, left = tear_state(simulation).untorn, simulation.topology
        assert 0 < whole.spring_count - left.spring_count < 200  # one piece is torn off, not many
        assert left.triangle_count < whole.triangle_count
        assert simulation.metrics().max_strain < 0.5


def test_untear_is_an_event_that_recordings_have(tmp_path: Path) -> None:
    names = []
    with Simulation(strip("xpbd", 0.8 * STATIC)) as simulation:
        recorder = Recorder(simulation)
        simulation.listeners.append(lambda event: names.append(event.name))
        while not simulation.torn.any():
            simulation.step()
        simulation.step(5)
        simulation.untear()
        assert not simulation.torn.any()
        assert simulation.topology.spring_count == tear_state(simulation).untorn.spring_count
        simulation.step(5)
        assert names == ["untear"]
        recorder.save(tmp_path / "torn.toml")
        positions = simulation.positions()
    with replay(tmp_path / "torn.toml") as again:
        assert np.array_equal(again.positions(), positions)
