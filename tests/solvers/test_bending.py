"""Bending stiffness: forces, and the substeps they require."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taichi_cloth.geometry.stability_bounds import MAX_FORCE_PHASE, max_frequency
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Forces, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers import SOLVERS

ELASTIC = [name for name, kind in SOLVERS.items() if kind.info.stiffness_section == "fabric"]


def plate(solver: str, **fabric: Any) -> Scene:
    return Scene(
        cloth=Cloth(rows=6, columns=11, width=0.5, height=0.2, center=(0.0, 0.0, 0.0), pins=()),
        fabric=replace(Fabric(warp=0.0, weft=0.0, shear=0.0, bend_spring=0.0, bending_stiffness=1e-3), **fabric),
        solver=Solver(solver, substeps=20, iterations=1, damping=0.0),
        forces=Forces(gravity=0.0),
    )


@pytest.mark.parametrize("layout", ["serial", "simd", "parallel"])
def test_the_force_is_the_gradient_of_the_energy(layout: str) -> None:
    """A randomly bent sheet with bending links alone gains h·F/m in its first short substep, F from dense algebra."""
    with Simulation(plate("explicit"), layout) as simulation:
        topology = simulation.topology
        links = topology.bending_links
        x = topology.start + 0.01 * np.random.default_rng(1).standard_normal(topology.start.shape)
        simulation.params["substeps"] = 1000
        simulation.set_state(x)
        x = simulation.positions()
        gap = x[links.ends[:, 1]] - x[links.ends[:, 0]]
        force = np.zeros_like(x)
        np.add.at(force, links.ends[:, 0], links.stiffness[:, None] * gap)
        np.add.at(force, links.ends[:, 1], -links.stiffness[:, None] * gap)
        frame = simulation._frame_input()
        simulation.solver.step(replace(frame, substeps=1))
        expected = frame.h * force / topology.mass[:, None]
        # Half of the impulse is applied at the start of the substep, half at its end, where forces have hardly changed.
        assert simulation.velocities() == pytest.approx(expected, rel=1e-2, abs=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize("solver", ELASTIC)
def test_bending_forces_conserve_linear_and_angular_momentum(solver: str) -> None:
    scene = plate(solver)
    with Simulation(scene) as simulation:
        topology = simulation.topology
        x = topology.start + np.array([0.0, 0.0, 1.0]) * np.sin(9 * topology.start[:, :1]) * 0.01
        simulation.set_state(x)
        for _ in range(30):
            simulation.step()
        v, mass = simulation.velocities(), topology.mass[:, None]
        size = np.abs(mass * v).sum()
        assert np.abs((mass * v).sum(axis=0)).max() < 1e-4 * size
        assert np.abs((mass * np.cross(simulation.positions(), v)).sum(axis=0)).max() < 1e-4 * size


@pytest.mark.parametrize("solver", ["xpbd", "lines"])
def test_a_stiff_sheet_takes_more_substeps(solver: str) -> None:
    scene = replace(plate(solver, bending_stiffness=1.0), forces=Forces())
    with Simulation(scene) as simulation:
        frequency = max_frequency(simulation.topology, np.zeros(0))
        assert simulation.substeps == np.ceil(frequency / 60 / MAX_FORCE_PHASE) > 20
        assert f"{solver} takes {simulation.substeps} substeps, not 20: fewer are unstable" in simulation.warnings


def test_verlet_and_sheets_without_bending_stiffness_have_no_bending_links() -> None:
    with Simulation(plate("verlet")) as simulation:
        assert "bending" not in simulation.features
    with Simulation(plate("explicit", bending_stiffness=0.0)) as simulation:
        assert "bending" not in simulation.features
        simulation.switch_solver("verlet")
    with Simulation(plate("verlet")) as simulation:
        simulation.switch_solver("lines")
        assert "bending" in simulation.features


@pytest.mark.parametrize(("solver", "iterations"), [("xpbd", 1), ("xpbd", 12), ("lines", 1)])
def test_a_compressed_strip_comes_to_rest(solver: str, iterations: int) -> None:
    """Bending forces act beside length constraints: at h·ω = 0.9 their fastest vibrations would not decay."""
    scene = Scene(
        cloth=Cloth(rows=33, columns=3, width=0.1, height=1.0, center=(0.0, 0.0, 0.0), pins=("top", "bottom")),
        fabric=Fabric(warp=5e3, weft=5e3, shear=0.0, bend_spring=0.0, bending_stiffness=0.02),
        solver=Solver(solver, substeps=1, iterations=iterations, damping=3.0),
        forces=Forces(gravity=0.0),
    )
    with Simulation(scene) as simulation:
        x = simulation.topology.start * [1.0, 0.7, 1.0]
        x[:, 2] = 0.3 * np.cos(np.pi * simulation.topology.start[:, 1])
        simulation.set_state(x)
        for _ in range(900):
            simulation.step()
        assert simulation.metrics().kinetic_energy < 1e-6
