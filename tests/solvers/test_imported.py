"""Cloth from a mesh file runs with every method that needs no grid."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from meshes import quads, write_obj

from taichi_cloth.errors import WrongUse
from taichi_cloth.scene import Scene, load_scene
from taichi_cloth.scene.model import USUAL, Capsule, Cloth, Fabric, Solver, Tethers
from taichi_cloth.simulation import Simulation
from taichi_cloth.solvers import SOLVERS
from taichi_cloth.view.draw_list import VIEWS, DrawList

PLACED = {"center": (0.0, 2.0, 0.0), "rotation": (-40.0, 10.0, 0.0), "pins": (0, 1, 2, 30)}
GRID = Scene(
    cloth=Cloth(rows=7, columns=9, width=1.0, height=0.8, **PLACED),
    fabric=Fabric(warp=300.0, weft=500.0, shear=100.0, bend=2.0, bending=1e-3),
    tethers=Tethers(),
)


@pytest.fixture
def mesh(tmp_path: Path) -> Scene:
    """The same from a file."""
    write_obj(tmp_path / "grid.obj", *quads(7, 9, 1.0, 0.8))
    return replace(GRID, cloth=Cloth(file="grid.obj", folder=str(tmp_path), **PLACED))


def places(scene: Scene, path: str = "list", frames: int = 20) -> np.ndarray:
    with Simulation(scene, path) as simulation:
        for _ in range(frames):
            simulation.advance_frame()
        return simulation.positions()


# Relaxation that is not at its end depends on the order of springs, which is another one.
APART = {"verlet": 0.02, "xpbd": 1e-3, "spring": 2e-5, "rk4": 2e-5, "projective": 2e-5}
SOLVED = USUAL | {"projective": (20, 60)}  # a round that ends its search early is such a relaxation


@pytest.mark.parametrize("solver", [name for name, kind in SOLVERS.items() if not kind.needs_rows])
def test_a_grid_from_a_file_moves_as_the_grid(mesh: Scene, solver: str) -> None:
    grid, mesh = (replace(scene, solver=Solver(solver, *SOLVED[solver])) for scene in (GRID, mesh))
    expected = places(grid)
    assert np.abs(expected - places(grid, frames=0)).max() > 0.1
    assert places(mesh) == pytest.approx(expected, abs=APART[solver])


def test_a_thread_for_each_particle_moves_it_alike(mesh: Scene) -> None:
    for solver in ("xpbd", "spring"):  # by colours, and by sums
        scene = replace(mesh, solver=Solver(solver, *USUAL[solver]))
        assert places(scene, "gather", 5) == pytest.approx(places(scene, "list", 5), abs=1e-5)


def test_what_needs_a_grid_says_so(mesh: Scene) -> None:
    with pytest.raises(WrongUse, match=r"lines needs a grid of whole rows, and cloth\.file is a mesh"):
        Simulation(replace(mesh, solver=Solver("lines", 5, 1)))
    with pytest.raises(WrongUse, match="path lanes is for one even grid"):
        Simulation(mesh, "lanes")
    pole = replace(mesh, capsules=(Capsule(against="triangles"),))
    with pytest.raises(WrongUse, match="path gather cannot do it, since a body is kept from the triangles of a mesh"):
        Simulation(pole, "gather")
    with pytest.raises(WrongUse, match=r"since its springs have 1[0-9]{2} colours"):
        Simulation(replace(mesh, cloth=Cloth(file="disc", pins=())), "gather")  # a fan of 96 triangles
    with Simulation(mesh) as simulation:
        assert simulation.method == "verlet 5×12 · list"
        with pytest.raises(WrongUse, match="lines needs a grid"):
            simulation.change_solver("lines")
        simulation.advance_frame()


def test_the_round_cloth_hangs_alike_in_six_directions() -> None:
    hem = list(range(1519 - 6 * 22, 1519))
    scene = load_scene("round", cloth_pins=hem, solver="spring", cloth_scale=0.3, fabric="rubber")
    scene = replace(scene, meshes=(), capsules=(), ground=None)
    x = places(scene, frames=12)
    cos, sin = 0.5, np.sqrt(0.75)
    turned = x @ np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])
    start = scene.cloth.center[1] - x[:, 1]
    assert start.max() > 0.005
    distance = np.linalg.norm(x[:, None, :] - turned[None, :, :], axis=2)
    assert distance.min(axis=1).max() < 2e-4


def test_it_is_saved_grabbed_measured_and_drawn(mesh: Scene, tmp_path: Path) -> None:
    with Simulation(mesh) as simulation:
        draw_list = DrawList(simulation)
        simulation.advance_frame()
        simulation.save(tmp_path / "save.npz")
        simulation.grab(60, (0.3, 1.6, 0.2))
        simulation.advance_frame()
        assert simulation.positions()[60] == pytest.approx([0.3, 1.6, 0.2], abs=1e-5)
        assert simulation.crossings() == 0
        assert simulation.measure().finite
        for view in VIEWS:
            drawn = draw_list.update(view, (0.0, 2.0, 5.0))
            assert np.isfinite(drawn.position.to_numpy()[: drawn.corners]).all()
        draw_list.close()
        held = simulation.positions()
        simulation.load(tmp_path / "save.npz")
        assert simulation.frame == 1
        assert np.abs(simulation.positions() - held).max() > 1e-3


def test_a_map_of_stiffness_makes_one_half_soft(tmp_path: Path) -> None:
    """Two halves of a strip that hangs: the soft one stretches ten times as much. In strips it is refused."""
    (tmp_path / "s.csv").write_text("1\n" * 12 + "0\n" * 12)
    (tmp_path / "s.toml").write_text(
        "[cloth]\nrows = 8\ncolumns = 3\nwidth = 0.1\nheight = 0.35\n[forces]\ngravity = 0.0\n"
        "[solver]\nname = 'spring'\n[fabric]\nwarp = 20.0\nweft = 20.0\nshear = 0.0\nbend = 0.0\n"
        "[maps]\nstiffness = 's.csv'\nstiffness_lo = 0.1\n"
        "[[grips]]\npins = ['bottom']\npath = [[0, 0, 0, 0], [1, 0, -0.05, 0]]\n"
    )
    scene = load_scene(tmp_path / "s.toml")
    with pytest.raises(WrongUse, match=r"maps\.stiffness makes springs differ"):
        Simulation(scene, "lanes")
    with Simulation(scene) as simulation:
        for _ in range(240):
            simulation.advance_frame()
        column = simulation.positions()[1::3, 1]
    stretch = -np.diff(column) / 0.05 - 1
    assert stretch[4:].mean() / stretch[:3].mean() == pytest.approx(10, rel=0.1)
