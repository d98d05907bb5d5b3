"""Pins that move as a body does."""

import numpy as np
import pytest

from taichi_cloth.scene import load_scene
from taichi_cloth.scene.errors import SceneError
from taichi_cloth.scene.model import USUAL, Cloth, Forces, Grip, Scene, Solver, Tethers
from taichi_cloth.simulation import Simulation
from taichi_cloth.solvers import SOLVERS

CLOTH = Cloth(rows=6, columns=9, width=0.8, height=0.5, center=(0.0, 1.0, 0.0), pins=())
TURNING = Grip(pins=("left",), center=(-0.4, 1.0, 0.0), spin=(0.0, 90.0, 0.0))
GOING = Grip(pins=("right",), center=(0.0, 0.0, 0.0), path=((0.0, 0.0, 0.0, 0.0), (1.0, 0.3, 0.0, 0.6)))


def scene(solver: str, *grips: Grip) -> Scene:
    return Scene(cloth=CLOTH, solver=Solver(solver, *USUAL[solver]), grips=grips, forces=Forces(gravity=0.0))


def led(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Where both edges are by hand [m]."""
    left = np.stack([np.full(6, -0.4), np.linspace(1.25, 0.75, 6), np.zeros(6)], axis=1)
    return left, left + [0.8 + 0.3 * seconds, 0.0, 0.6 * seconds]


@pytest.mark.parametrize("solver", SOLVERS)
def test_gripped_pins_are_where_their_body_takes_them(solver: str) -> None:
    """An edge on the axis stays, and the other goes straight on; the hand may take one of them away."""
    with Simulation(scene(solver, TURNING, GOING)) as simulation:
        for _ in range(6):
            simulation.advance_frame()
        x = simulation.positions().reshape(6, 9, 3)
        left, right = led(0.1)
        assert x[:, 0] == pytest.approx(left, abs=1e-6)
        assert x[:, 8] == pytest.approx(right, abs=1e-6)
        simulation.grab(8, [0.5, 1.3, 0.1])
        simulation.advance_frame()
        assert simulation.positions()[8] == pytest.approx([0.5, 1.3, 0.1], abs=1e-6)
        simulation.release()
        simulation.advance_frame()
        assert simulation.positions()[8] == pytest.approx(led(8 / 60)[1][0], abs=1e-6)


@pytest.mark.parametrize("path", ["list", "lanes", "gather"])
def test_a_turned_edge_turns_on_every_path(path: str) -> None:
    """A quarter turn about the vertical through the left edge brings the right edge to z = −0.8."""
    turning = Grip(pins=("left", "right"), center=(-0.4, 1.0, 0.0), spin=(0.0, 90.0, 0.0))
    with Simulation(scene("verlet", turning), path) as simulation:
        for _ in range(60):
            simulation.advance_frame()
        x = simulation.positions().reshape(6, 9, 3)
        assert x[:, 8] == pytest.approx(led(0.0)[0] + [0.0, 0.0, -0.8], abs=1e-5)
        simulation.reset()
        assert simulation.positions() == pytest.approx(simulation.topology.start)


def test_tethers_follow_the_grips() -> None:
    tied = Scene(cloth=CLOTH, grips=(GOING,), tethers=Tethers(1.0), forces=Forces(gravity=0.0))
    with Simulation(tied) as simulation:
        for _ in range(60):
            simulation.advance_frame()
        x = simulation.positions().reshape(6, 9, 3)
        distance = np.linalg.norm(x[:, 0] - x[:, 8], axis=1)
        assert distance.max() <= 0.8 + 1e-5


def test_a_grip_that_names_no_particle_is_refused(tmp_path) -> None:
    file = tmp_path / "twist.toml"
    file.write_text('[[grips]]\npins = ["left", 720]\n', encoding="utf-8")
    with pytest.raises(SceneError, match=r"grips\[0\]\.pins\[1\]: 720 is no particle: indices run from 0 to 719"):
        load_scene(file)
