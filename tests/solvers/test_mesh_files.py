"""Cloth from a mesh file runs with every solver that does not need a grid."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from meshes import quads, write_obj

from taichi_cloth.geometry.cloth_builder import build_topology
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.render.draw_list import VIEWS, DrawList
from taichi_cloth.scene.collider_schema import Capsule
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Scene, Solver, Tethers
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers import SOLVERS
from taichi_cloth.system import taichi_runtime as runtime
from taichi_cloth.system.errors import UsageError

PLACED: dict[str, Any] = {"center": (0.0, 2.0, 0.0), "rotation": (-40.0, 10.0, 0.0), "pins": (0, 1, 2, 30)}
GRID = Scene(
    cloth=Cloth(rows=7, columns=9, width=1.0, height=0.8, **PLACED),
    fabric=Fabric(warp=300.0, weft=500.0, shear=100.0, bend_spring=2.0, bending_stiffness=1e-3),
    tethers=Tethers(),
)


@pytest.fixture
def mesh(tmp_path: Path) -> Scene:
    """Return the scene of `GRID` with the cloth from a file."""
    write_obj(tmp_path / "grid.obj", *quads(7, 9, 1.0, 0.8))
    return replace(GRID, cloth=Cloth(file="grid.obj", folder=str(tmp_path), **PLACED))


def positions_after(scene: Scene, layout: str = "serial", frames: int = 20) -> np.ndarray:
    with Simulation(scene, layout) as simulation:
        for _ in range(frames):
            simulation.step()
        return simulation.positions()


# Unconverged relaxation depends on the order of springs, which differs.
APART = {"verlet": 0.02, "xpbd": 1e-3, "explicit": 2e-5, "rk4": 2e-5, "implicit": 2e-5}
# An iteration of `implicit` that ends its linear solve early is such a relaxation.
SOLVED = {name: info.defaults for name, info in SOLVER_CATALOG.items()} | {"implicit": (20, 10)}


@pytest.mark.parametrize("solver", [name for name, kind in SOLVERS.items() if not kind.info.grid_only])
def test_a_grid_from_a_file_moves_like_the_grid(mesh: Scene, solver: str) -> None:
    grid, mesh = (replace(scene, solver=Solver(solver, *SOLVED[solver])) for scene in (GRID, mesh))
    expected = positions_after(grid)
    assert np.abs(expected - positions_after(grid, frames=0)).max() > 0.1
    assert positions_after(mesh) == pytest.approx(expected, abs=APART[solver])


def test_the_parallel_layout_matches_the_serial_layout(mesh: Scene) -> None:
    for solver in ("xpbd", "explicit"):  # by colors, and by sums
        scene = replace(mesh, solver=Solver(solver, *SOLVER_CATALOG[solver].defaults))
        assert positions_after(scene, "parallel", 5) == pytest.approx(positions_after(scene, "serial", 5), abs=1e-5)


def test_solvers_and_layouts_that_need_a_grid_are_rejected(mesh: Scene) -> None:
    with pytest.raises(UsageError, match=r"lines needs a grid with whole rows, and cloth\.file is a mesh without rows"):
        Simulation(replace(mesh, solver=Solver("lines", 5, 1)))
    with pytest.raises(UsageError, match="layout simd is not supported: "):
        Simulation(mesh, "simd")
    pole = replace(mesh, capsules=(Capsule(collide_with="triangles"),))
    with pytest.raises(
        UsageError, match='layout parallel is not supported: collide_with = "triangles" does not work on a mesh file'
    ):
        Simulation(pole, "parallel")
    with pytest.raises(UsageError, match=r"layout parallel is not supported: the springs have 1[0-9]{2} colors"):
        Simulation(replace(mesh, cloth=Cloth(file="disc", pins=())), "parallel")  # a fan of 96 triangles
    with Simulation(mesh) as simulation:
        assert simulation.method == "verlet 5×12 · serial"
        with pytest.raises(UsageError, match="lines needs a grid"):
            simulation.switch_solver("lines")
        simulation.step()


def test_the_round_cloth_has_sixfold_symmetry() -> None:
    hem = list(range(1519 - 6 * 22, 1519))
    scene = load_scene("round", cloth_pins=hem, solver="explicit", cloth_scale=0.3, fabric="rubber")
    scene = replace(scene, meshes=(), capsules=(), ground=None)
    x = positions_after(scene, frames=12)
    cos, sin = 0.5, np.sqrt(0.75)
    turned = x @ np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])
    start = scene.cloth.center[1] - x[:, 1]
    assert start.max() > 0.005
    distance = np.linalg.norm(x[:, None, :] - turned[None, :, :], axis=2)
    assert distance.min(axis=1).max() < 2e-4


def test_saving_grabbing_metrics_and_drawing(mesh: Scene, tmp_path: Path) -> None:
    with Simulation(mesh) as simulation:
        draw_list = DrawList(simulation)
        simulation.step()
        simulation.save(tmp_path / "save.npz")
        simulation.grab(60).move_to((0.3, 1.6, 0.2))
        simulation.step()
        assert simulation.positions()[60] == pytest.approx([0.3, 1.6, 0.2], abs=1e-5)
        assert simulation.intersections() == 0
        assert simulation.metrics().finite
        for view in VIEWS:
            drawn = draw_list.update(view, (0.0, 2.0, 5.0))
            assert np.isfinite(drawn.position.to_numpy()[: drawn.corners]).all()
        draw_list.close()
        before = simulation.positions()
        simulation.load(tmp_path / "save.npz")
        assert simulation.frame == 1
        assert np.abs(simulation.positions() - before).max() > 1e-3


def test_a_stiffness_map_softens_one_half(tmp_path: Path) -> None:
    """The soft half of a stretched strip stretches ten times as much. The SIMD layout is rejected."""
    (tmp_path / "s.csv").write_text("1\n" * 12 + "0\n" * 12)
    (tmp_path / "s.toml").write_text(
        "[cloth]\nrows = 8\ncolumns = 3\nwidth = 0.1\nheight = 0.35\n[forces]\ngravity = 0.0\n"
        "[solver]\nname = 'explicit'\n[fabric]\nwarp = 20.0\nweft = 20.0\nshear = 0.0\nbend_spring = 0.0\n"
        "[maps]\nstiffness = 's.csv'\nstiffness_min = 0.1\n"
        "[[attachments]]\npins = ['bottom']\nkeyframes = [[0, 0, 0, 0], [1, 0, -0.05, 0]]\n"
    )
    scene = load_scene(tmp_path / "s.toml")
    with pytest.raises(UsageError, match=r"maps\.stiffness makes springs differ"):
        Simulation(scene, "simd")
    with Simulation(scene) as simulation:
        for _ in range(240):
            simulation.step()
        column = simulation.positions()[1::3, 1]
    stretch = -np.diff(column) / 0.05 - 1
    assert stretch[4:].mean() / stretch[:3].mean() == pytest.approx(10, rel=0.1)


def test_a_fan_has_more_bending_links_than_a_grid_of_its_size(mesh: Scene, tmp_path: Path) -> None:
    """The fields of an earlier cloth of that size have no room for them."""
    write_obj(tmp_path / "other.obj", *quads(14, 14, 1.0, 1.0))
    fabric = Fabric(bending_stiffness=1e-3)
    scenes = [
        Scene(cloth=Cloth(**file, pins=(0,)), fabric=fabric, solver=Solver("xpbd", 5, 5))
        for file in ({"file": "other.obj", "folder": str(tmp_path)}, {"file": "disc"})
    ]
    runtime.start()
    alone = positions_after(scenes[1])
    runtime.start()
    positions_after(scenes[0])
    assert (positions_after(scenes[1]) == alone).all()
    counts = [
        (len(topology.bending_links.ends), topology.particle_count)
        for topology in (build_topology(one, "fabric") for one in scenes)
    ]
    assert counts[0][0] < 8 * 256 < counts[1][0]  # links, of which a grid of 256 particles may have 2048
    assert all(128 < particles <= 256 for _, particles in counts)
