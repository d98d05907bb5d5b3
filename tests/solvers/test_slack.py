"""`fabric.compression`: springs that give way where they are shortened."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.scene.model import SOLVER_NAMES, Cloth, Fabric, Forces, Scene, Solver
from taichi_cloth.simulation import Simulation

IN_NEWTONS = [name for name in SOLVER_NAMES if name != "verlet"]
ENDS = ("left", "right")
RISE = float(np.sqrt(0.1**2 - 0.09**2))  # [m] of the arch
CONSTANT = 2.0  # [N/m] so few that a frame is a tenth of the slowest vibration


def weightless(solver: str, compression: float, constant: float = CONSTANT) -> Scene:
    """A free sheet of 4 × 9 cells."""
    return Scene(
        cloth=Cloth(rows=5, columns=10, width=0.9, height=0.4, center=(0.0, 0.0, 0.0), pins=()),
        fabric=Fabric(warp=constant, weft=constant, shear=constant, bend=0.0, compression=compression),
        solver=Solver(solver, substeps=20, iterations=10, damping=0.0),
        forces=Forces(gravity=0.0),
    )


def moved(scene: Scene, size: float, path: str = "list", frames: int = 1) -> np.ndarray:
    """How far particles go in so many frames, from the flat sheet of so many times its size [m]."""
    with Simulation(scene, path) as simulation:
        x = simulation.topology.start * size
        simulation.place(x)
        for _ in range(frames):
            simulation.advance_frame()
        return np.asarray(simulation.positions() - x)


@pytest.mark.parametrize("solver", IN_NEWTONS)
def test_threads_that_go_slack_pull_and_do_not_push(solver: str) -> None:
    assert np.abs(moved(weightless(solver, 0.0), 0.5)).max() < 1e-7  # of float32
    stiff = moved(weightless(solver, 1.0), 2.0)
    assert np.abs(stiff).max() > 1e-3
    assert moved(weightless(solver, 0.0), 2.0) == pytest.approx(stiff, abs=1e-6)  # stretched all the time


@pytest.mark.parametrize("solver", IN_NEWTONS)
def test_a_shortened_spring_has_a_share_of_its_constant(solver: str) -> None:
    """A sheet that is compressed everywhere is like a fabric of half the constants."""
    expected = moved(weightless(solver, 1.0, CONSTANT / 2), 0.5)
    assert np.abs(expected).max() > 1e-3
    assert moved(weightless(solver, 0.5), 0.5) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("solver", ["xpbd", "lines"])
def test_strips_are_as_slack_as_lists(solver: str) -> None:
    """Sheared, so that some springs are longer and others shorter than at rest."""
    scene = weightless(solver, 0.25)
    ends = []
    for path in ("list", "lanes"):
        with Simulation(scene, path) as simulation:
            x = simulation.topology.start
            simulation.place(x + x[:, [1, 0, 2]] * [0.1, 0.0, 0.0])
            for _ in range(3):
                simulation.advance_frame()
            ends.append(simulation.positions())
    assert ends[0] == pytest.approx(ends[1], abs=1e-6)


def arch(compression: float) -> float:
    """How high the middle column of a level strip of two cells stands [m], between pins that are nearer than its
    length: three seconds after it began above them.
    """
    scene = Scene(
        cloth=Cloth(rows=2, columns=3, width=0.2, height=0.1, center=(0, 0, 0), rotation=(-90, 0, 0), pins=ENDS),
        fabric=Fabric(warp=1e3, weft=1e3, shear=0.0, bend=0.0, compression=compression),
        solver=Solver("xpbd", substeps=20, iterations=4, damping=4.0),
    )
    with Simulation(scene) as simulation:
        x = simulation.topology.start * [0.9, 1.0, 1.0]
        x[[1, 4], 1] = RISE
        simulation.place(x)
        for _ in range(180):
            simulation.advance_frame()
        return float(simulation.positions()[[1, 4], 1].mean())


def test_only_what_pushes_stands_as_an_arch() -> None:
    """The smallest knot: two bars of 0.1 m between pins 0.18 m apart have two equilibria, two threads have one."""
    assert arch(1.0) == pytest.approx(RISE, abs=1e-3)
    assert arch(0.0) == pytest.approx(-RISE, abs=1e-3)


def test_what_is_not_said_is_not_compiled() -> None:
    scene = weightless("xpbd", 1.0)
    with Simulation(scene) as plain, Simulation(replace(scene, fabric=replace(scene.fabric, compression=0.9))) as slack:
        assert (plain.solver.stages.slack, slack.solver.stages.slack) == (False, True)
