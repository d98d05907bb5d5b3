"""A cloth that tears while it runs: when, and that all who look at it see what is left."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.errors import WrongUse
from taichi_cloth.scene import SceneError, check_scene, load_scene
from taichi_cloth.scene.model import Cloth, Fabric, Scene, SelfCollision, Solver, Springs, Tear, Tethers, Wind
from taichi_cloth.simulation import Simulation
from taichi_cloth.solvers import SOLVERS
from taichi_cloth.view.draw_list import VIEWS, DrawList

G = 9.81
LOAD = 0.5  # [kg] sewn to each of the two lower corners
STIFF = 1000.0  # [N/m] of force for each metre of width and strain
STRIP = Cloth(
    rows=6, columns=3, width=0.2, height=0.5, center=(0.0, 0.0, 0.0), area_density=0.01, pins=("top",), weight=LOAD
)
STATIC = 2 * LOAD * G / (STIFF * STRIP.width)  # strain of the hanging strip: 4.9 %


def strip(solver: str, strain: float, **parts: object) -> Scene:
    """Two threads and a half of no shear, loaded: no thread carries what another should."""
    fabric = Fabric(warp=STIFF, weft=STIFF, shear=300.0, bend=0.0)
    springs = Springs(bend=0.0)
    parts = {"fabric": fabric, "springs": springs, "tear": Tear(strain), **parts}
    return Scene(cloth=STRIP, solver=Solver(name=solver, substeps=20, iterations=20, damping=0.0), **parts)


def torn(simulation: Simulation) -> int:
    return Simulation(replace(simulation.scene, tear=None)).topology.spring_count - simulation.topology.spring_count


@pytest.mark.parametrize("solver", [name for name, kind in SOLVERS.items() if not kind.needs_rows and name != "verlet"])
def test_a_load_tears_what_bears_less_and_then_falls_freely(solver: str) -> None:
    # Let go without strain it swings to twice the static strain, and a little more at its corners.
    with Simulation(strip(solver, 4 * STATIC)) as simulation:
        for _ in range(30):
            simulation.advance_frame()
        assert simulation.topology.spring_count == simulation._tear.whole.spring_count
    with Simulation(strip(solver, 0.8 * STATIC)) as simulation:
        while simulation._tear.left() is simulation._tear.whole:
            simulation.advance_frame()
            assert simulation.frame < 30
        for _ in range(40):
            simulation.advance_frame()
        falling = simulation.velocities()[:, 1]
        simulation.advance_frame()
        # Its lowest row belongs to no pin any more.
        change = simulation.velocities()[-3:, 1] - falling[-3:]
        mass = simulation.topology.mass[-3:]
        assert change @ mass / mass.sum() == pytest.approx(-G / 60, rel=0.02)


def test_the_browser_method_tears_too() -> None:
    with Simulation(strip("verlet", 0.02, springs=Springs(structural=0.05, shear=0.05, bend=0.0))) as simulation:
        for _ in range(30):
            simulation.advance_frame()
        assert simulation.topology.spring_count < simulation._tear.whole.spring_count


def pulled(solver: str = "xpbd", **parts: object) -> Scene:
    """A sheet between two edges, and enough weight to tear it."""
    cloth = Cloth(rows=8, columns=9, width=0.8, height=0.7, pins=("left", "right"), area_density=6.0)
    fabric = Fabric(warp=300.0, weft=300.0, shear=100.0, bend=1.0)
    return Scene(cloth=cloth, fabric=fabric, solver=Solver(name=solver, substeps=20), tear=Tear(0.1), **parts)


def run(simulation: Simulation, frames: int) -> np.ndarray:
    for _ in range(frames):
        simulation.advance_frame()
    return simulation.positions()


def test_reset_mends_it_bit_for_bit() -> None:
    with Simulation(pulled()) as simulation:
        first = run(simulation, 60)
        assert simulation.topology.spring_count < simulation._tear.whole.spring_count
        simulation.reset()
        assert simulation.topology is simulation._tear.whole
        np.testing.assert_array_equal(run(simulation, 60), first)


def test_a_save_keeps_what_is_torn(tmp_path) -> None:
    with Simulation(pulled()) as simulation:
        run(simulation, 40)
        left = simulation.topology.spring_count
        simulation.save(tmp_path / "save.npz")
        there = run(simulation, 20)
    with Simulation(pulled()) as simulation:
        simulation.load(tmp_path / "save.npz")
        assert simulation.topology.spring_count == left < simulation._tear.whole.spring_count
        np.testing.assert_array_equal(run(simulation, 20), there)


def test_another_method_goes_on_with_what_is_torn() -> None:
    with Simulation(pulled()) as simulation:
        run(simulation, 40)
        ends = {tuple(pair) for pair in simulation._tear.ends.tolist()}
        simulation.change_solver("spring")
        assert ends
        assert {tuple(pair) for pair in simulation._tear.ends.tolist()} == ends
        with pytest.raises(WrongUse, match="lines needs a grid of whole rows"):
            simulation.change_solver("lines")
        assert {tuple(pair) for pair in simulation._tear.ends.tolist()} == ends
        assert simulation.measure().finite


def test_threads_for_each_particle_tear_alike() -> None:
    there = {}
    for path in ("list", "gather"):
        with Simulation(pulled("spring", wind=Wind(z=5.0)), path) as simulation:
            run(simulation, 60)
            there[path] = simulation._tear.torn
    assert there["list"].any()
    np.testing.assert_array_equal(there["list"], there["gather"])


def test_pictures_show_what_is_left() -> None:
    with Simulation(pulled()) as simulation:
        draw_list = DrawList(simulation)
        whole = {view: draw_list.update(view, (3.0, 2.0, 5.0)).corners for view in VIEWS}
        run(simulation, 60)
        left = {view: draw_list.update(view, (3.0, 2.0, 5.0)).corners for view in VIEWS}
        draw_list.close()
        lost = simulation._tear.whole.triangle_count - simulation.topology.triangle_count
        assert lost > 0
        assert whole["shaded"] - left["shaded"] == 3 * lost
        assert left["wireframe"] < whole["wireframe"]
        assert left["particles"] == whole["particles"]


def test_it_stays_finite_with_every_stage_and_a_wild_hand() -> None:
    scene = pulled(
        wind=Wind(z=20.0), self_collision=SelfCollision(thickness=0.03, contacts="triangles"), tethers=Tethers()
    )
    with Simulation(replace(scene, tear=Tear(0.05))) as simulation:
        turn = np.random.default_rng(0)
        for k in range(90):
            if k % 10 == 0:
                held = int(turn.integers(simulation.topology.particle_count))
            simulation.grab(held, turn.normal(size=3) * 2)
            simulation.advance_frame()
        simulation.release()
        run(simulation, 60)
        measures = simulation.measure()
        assert measures.finite
        assert simulation.topology.spring_count < simulation._tear.whole.spring_count / 2
        assert np.isfinite(measures.kinetic_energy)
        assert measures.crossings is not None


def test_a_scene_that_names_no_tear_pays_nothing() -> None:
    with Simulation(replace(pulled(), tear=None)) as simulation:
        assert simulation.solver.path == "lanes"
        assert "tear" not in simulation.stages
        assert run(simulation, 1) is not None
        assert simulation.topology.spring_count


def test_what_cannot_tear_is_refused_by_name() -> None:
    with pytest.raises(WrongUse, match="path lanes is for one even grid, and one that tears"):
        Simulation(pulled(), "lanes")
    with pytest.raises(
        WrongUse,
        match=r"lines needs a grid of whole rows, and one that tears loses its rows: take verlet, xpbd, spring",
    ):
        Simulation(pulled("lines"))
    with pytest.raises(SceneError, match=r"set fabric\.bending to 0"):
        check_scene(replace(pulled(), fabric=Fabric(bending=1e-5)))


def test_a_mesh_tears_where_it_is_pulled() -> None:
    scene = replace(load_scene("round", preset="", bending=0.0), tear=Tear(0.1))
    with Simulation(scene) as simulation:
        rim = int(np.linalg.norm(simulation.topology.flat[:, [0, 2]], axis=1).argmax())
        start = simulation.positions()[rim]
        for k in range(60):
            simulation.grab(rim, start + [0.02 * k, 0.02 * k, 0.0])
            simulation.advance_frame()
        whole, left = simulation._tear.whole, simulation.topology
        assert 0 < whole.spring_count - left.spring_count < 200  # a piece came off, no shreds
        assert left.triangle_count < whole.triangle_count
        assert simulation.measure().max_strain < 0.5
