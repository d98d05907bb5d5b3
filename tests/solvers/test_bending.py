"""A sheet that resists bending: forces, and how many substeps they ask for."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.mesh.frequency import highest_frequency
from taichi_cloth.scene.model import Cloth, Fabric, Forces, Scene, Solver
from taichi_cloth.simulation import Simulation
from taichi_cloth.solvers import SOLVERS
from taichi_cloth.solvers.base import FORCED

ELASTIC = [name for name, kind in SOLVERS.items() if kind.springs == "fabric"]


def plate(solver: str, **fabric: float) -> Scene:
    return Scene(
        cloth=Cloth(rows=6, columns=11, width=0.5, height=0.2, center=(0.0, 0.0, 0.0), pins=()),
        fabric=replace(Fabric(warp=0.0, weft=0.0, shear=0.0, bend=0.0, bending=1e-3), **fabric),
        solver=Solver(solver, substeps=20, iterations=1, damping=0.0),
        forces=Forces(gravity=0.0),
    )


@pytest.mark.parametrize("path", ["list", "lanes", "gather"])
def test_the_force_is_the_gradient_of_the_energy(path: str) -> None:
    """A sheet of bonds alone, bent at random: in the first short substep it gains h·F/m, F from a dense matrix."""
    with Simulation(plate("spring"), path) as simulation:
        topology = simulation.topology
        bonds = topology.bonds
        x = topology.start + 0.01 * np.random.default_rng(1).standard_normal(topology.start.shape)
        simulation.set("substeps", 1000)
        simulation.place(x)
        x = simulation.positions()
        gap = x[bonds.ends[:, 1]] - x[bonds.ends[:, 0]]
        force = np.zeros_like(x)
        np.add.at(force, bonds.ends[:, 0], bonds.constant[:, None] * gap)
        np.add.at(force, bonds.ends[:, 1], -bonds.constant[:, None] * gap)
        frame = simulation._input()
        simulation.solver.advance_frame(replace(frame, substeps=1))
        expected = frame.h * force / topology.mass[:, None]
        # A substep is half a kick at its start and half at its end, where the forces have hardly changed.
        assert simulation.velocities() == pytest.approx(expected, rel=1e-2, abs=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize("solver", ELASTIC)
def test_bonds_alone_neither_move_nor_turn_a_sheet(solver: str) -> None:
    scene = plate(solver)
    with Simulation(scene) as simulation:
        topology = simulation.topology
        x = topology.start + [0.0, 0.0, 1.0] * np.sin(9 * topology.start[:, :1]) * 0.01
        simulation.place(x)
        for _ in range(30):
            simulation.advance_frame()
        v, mass = simulation.velocities(), topology.mass[:, None]
        size = np.abs(mass * v).sum()
        assert np.abs((mass * v).sum(axis=0)).max() < 1e-4 * size
        assert np.abs((mass * np.cross(simulation.positions(), v)).sum(axis=0)).max() < 1e-4 * size


@pytest.mark.parametrize("solver", ["xpbd", "lines"])
def test_more_substeps_where_the_sheet_is_stiff(solver: str) -> None:
    scene = replace(plate(solver, bending=1.0), forces=Forces())
    with Simulation(scene) as simulation:
        frequency = highest_frequency(simulation.topology, np.zeros(0))
        assert simulation.substeps == np.ceil(frequency / 60 / FORCED) > 20
        assert f"{solver} takes {simulation.substeps} substeps, not 20: fewer are unstable" in simulation.advice


def test_methods_without_a_constant_and_sheets_without_bending_have_no_bonds() -> None:
    with Simulation(plate("verlet")) as simulation:
        assert "bending" not in simulation.stages
    with Simulation(plate("spring", bending=0.0)) as simulation:
        assert "bending" not in simulation.stages
        simulation.change_solver("verlet")
    with Simulation(plate("verlet")) as simulation:
        simulation.change_solver("lines")
        assert "bending" in simulation.stages


@pytest.mark.parametrize(("solver", "iterations"), [("xpbd", 1), ("xpbd", 12), ("lines", 1)])
def test_a_compressed_strip_comes_to_rest(solver: str, iterations: int) -> None:
    """The fastest bending vibrations stand beside constraints that hold lengths: at h·ω = 0.9 they do not end."""
    scene = Scene(
        cloth=Cloth(rows=33, columns=3, width=0.1, height=1.0, center=(0.0, 0.0, 0.0), pins=("top", "bottom")),
        fabric=Fabric(warp=5e3, weft=5e3, shear=0.0, bend=0.0, bending=0.02),
        solver=Solver(solver, substeps=1, iterations=iterations, damping=3.0),
        forces=Forces(gravity=0.0),
    )
    with Simulation(scene) as simulation:
        x = simulation.topology.start * [1.0, 0.7, 1.0]
        x[:, 2] = 0.3 * np.cos(np.pi * simulation.topology.start[:, 1])
        simulation.place(x)
        for _ in range(900):
            simulation.advance_frame()
        assert simulation.measure().kinetic_energy < 1e-6
