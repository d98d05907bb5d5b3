"""`fabric.compression`: shortened springs have reduced stiffness."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import SOLVER_NAMES, Cloth, Forces, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation

SI_SOLVERS = [name for name in SOLVER_NAMES if name != "verlet"]
ENDS = ("left", "right")
RISE = float(np.sqrt(0.1**2 - 0.09**2))  # [m] height of the arch
CONSTANT = 2.0  # [N/m] so low that a frame is a tenth of the slowest vibration


def weightless(solver: str, compression: float, constant: float = CONSTANT) -> Scene:
    """A free sheet of 4 × 9 cells."""
    return Scene(
        cloth=Cloth(rows=5, columns=10, width=0.9, height=0.4, center=(0.0, 0.0, 0.0), pins=()),
        fabric=Fabric(warp=constant, weft=constant, shear=constant, bend_spring=0.0, compression=compression),
        solver=Solver(solver, substeps=20, iterations=10, damping=0.0),
        forces=Forces(gravity=0.0),
    )


def moved(scene: Scene, size: float, layout: str = "serial", frames: int = 1) -> np.ndarray:
    """Return the displacement of particles [m] in some frames, from the flat sheet scaled by `size`."""
    with Simulation(scene, layout) as simulation:
        x = simulation.topology.start * size
        simulation.set_state(x)
        for _ in range(frames):
            simulation.step()
        return np.asarray(simulation.positions() - x)


@pytest.mark.parametrize("solver", SI_SOLVERS)
def test_slack_springs_pull_but_do_not_push(solver: str) -> None:
    assert np.abs(moved(weightless(solver, 0.0), 0.5)).max() < 1e-7  # float32 rounding
    stiff = moved(weightless(solver, 1.0), 2.0)
    assert np.abs(stiff).max() > 1e-3
    assert moved(weightless(solver, 0.0), 2.0) == pytest.approx(stiff, abs=1e-6)  # stretched throughout


@pytest.mark.parametrize("solver", SI_SOLVERS)
def test_a_shortened_spring_has_reduced_stiffness(solver: str) -> None:
    """A sheet compressed everywhere moves like a fabric of half the stiffness."""
    expected = moved(weightless(solver, 1.0, CONSTANT / 2), 0.5)
    assert np.abs(expected).max() > 1e-3
    assert moved(weightless(solver, 0.5), 0.5) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("solver", ["xpbd", "lines"])
def test_simd_and_serial_layouts_agree_on_slack(solver: str) -> None:
    """Sheared, so that some springs are longer and others shorter than at rest."""
    scene = weightless(solver, 0.25)
    ends = []
    for layout in ("serial", "simd"):
        with Simulation(scene, layout) as simulation:
            x = simulation.topology.start
            simulation.set_state(x + x[:, [1, 0, 2]] * [0.1, 0.0, 0.0])
            for _ in range(3):
                simulation.step()
            ends.append(simulation.positions())
    assert ends[0] == pytest.approx(ends[1], abs=1e-6)


def arch(compression: float) -> float:
    """Return the height of the middle column of a horizontal strip of two cells [m] after three seconds.

    Its pins are closer than its length, and it starts above them.
    """
    scene = Scene(
        cloth=Cloth(rows=2, columns=3, width=0.2, height=0.1, center=(0, 0, 0), rotation=(-90, 0, 0), pins=ENDS),
        fabric=Fabric(warp=1e3, weft=1e3, shear=0.0, bend_spring=0.0, compression=compression),
        solver=Solver("xpbd", substeps=20, iterations=4, damping=4.0),
    )
    with Simulation(scene) as simulation:
        x = simulation.topology.start * [0.9, 1.0, 1.0]
        x[[1, 4], 1] = RISE
        simulation.set_state(x)
        for _ in range(180):
            simulation.step()
        return float(simulation.positions()[[1, 4], 1].mean())


def test_an_arch_stands_only_with_compression_stiffness() -> None:
    """Two bars of 0.1 m between pins 0.18 m apart have two equilibria, two threads have one."""
    assert arch(1.0) == pytest.approx(RISE, abs=1e-3)
    assert arch(0.0) == pytest.approx(-RISE, abs=1e-3)


def test_slack_is_compiled_only_if_used() -> None:
    scene = weightless("xpbd", 1.0)
    with Simulation(scene) as plain, Simulation(replace(scene, fabric=replace(scene.fabric, compression=0.9))) as slack:
        assert (plain.solver.features.soft_compression, slack.solver.features.soft_compression) == (False, True)
