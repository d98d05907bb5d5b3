"""Every scene of the gallery shows what it is there for."""

import numpy as np
import pytest

from taichi_cloth.scene import load_scene
from taichi_cloth.simulation import Simulation


def run(simulation: Simulation, frames: int) -> np.ndarray:
    for _ in range(frames):
        simulation.advance_frame()
    return simulation.positions()


def speeds(simulation: Simulation, particle: int, frames: int) -> np.ndarray:
    """Of one particle from frame to frame [m/s]."""
    places = np.array([run(simulation, 1)[particle] for _ in range(frames)])
    return 60 * np.linalg.norm(np.diff(places, axis=0), axis=1)


def test_the_flag_flutters_in_wind_and_hangs_without() -> None:
    with Simulation(load_scene("flag")) as simulation:
        free_corner = simulation.scene.cloth.columns - 1
        x = run(simulation, 480)
        assert x[:, 0].max() > 1.0  # it streams: most of its 1.8 m off the mast
        assert np.mean(speeds(simulation, free_corner, 120)) > 1.0
        simulation.set("wind", False)
        x = run(simulation, 600)
        assert x[:, 0].max() < 1.0
        assert np.mean(speeds(simulation, free_corner, 30)) < 0.3


def test_the_silk_stays_on_the_ball_that_goes_round() -> None:
    with Simulation(load_scene("sphere")) as simulation:
        for _ in range(6):
            x = run(simulation, 60)
            assert simulation.measure().penetration <= 1e-3
        ball = simulation.bodies()[0]
        assert np.linalg.norm((x.mean(axis=0) - ball.center)[[0, 2]]) < 0.15
        assert x[:, 1].max() > ball.center[1] + ball.size[0]
        assert x[:, 1].min() > 0.05  # it hangs, and does not lie on the floor


def test_the_sail_bellies_between_its_edges() -> None:
    with Simulation(load_scene("sail")) as simulation:
        sheet = run(simulation, 180).reshape(31, 31, 3)
        chord = (sheet[0, 15] + (sheet[30, 0] + sheet[30, 30]) / 2) / 2
        assert sheet[15, 15, 2] > chord[2] + 0.3  # [m] along the wind
        assert sheet[0] == pytest.approx(simulation.topology.start.reshape(31, 31, 3)[0])
        assert simulation.measure().max_strain < 0.25


def test_the_hammock_sags_under_the_ball_and_its_edges_hold() -> None:
    with Simulation(load_scene("hammock")) as simulation:
        x = run(simulation, 240).reshape(25, 65, 3)
        start = simulation.topology.start.reshape(25, 65, 3)
        assert x[:, 0] == pytest.approx(start[:, 0] + [0.22, 0, 0], abs=1e-5)
        assert x[:, 64] == pytest.approx(start[:, 64] - [0.22, 0, 0], abs=1e-5)
        ball = simulation.bodies()[0]
        assert x[..., 1].min() < ball.center[1] - ball.size[0]  # below the ball, which pushes it down
        assert x[..., 1].min() > 0.1
        assert simulation.measure().penetration <= 1e-3


def test_the_cape_stays_out_of_the_figure_that_walks() -> None:
    with Simulation(load_scene("cape")) as simulation:
        deepest = 0.0
        for _ in range(60):
            run(simulation, 5)
            deepest = max(deepest, simulation.measure().penetration)
        assert deepest <= 1e-3  # [m]


def test_the_legs_rock_about_the_hips() -> None:
    """The upper ends of both legs hardly move, the lower ends are where they step."""
    with Simulation(load_scene("cape")) as simulation:
        ends = {1.0: [], -1.0: []}
        for _ in range(12):
            run(simulation, 5)
            for body in simulation.bodies()[3:5]:
                for side, found in ends.items():
                    found.append(body.center + side * body.size[0] * body.axes[:, 1])
        assert np.ptp(np.array(ends[1.0])[:, 1:], axis=0).max() < 0.05
        assert np.ptp(np.array(ends[-1.0])[:, 2]) > 0.6


def test_the_ribbon_waves_and_keeps_its_length() -> None:
    with Simulation(load_scene("banner")) as simulation:
        run(simulation, 180)
        x = simulation.positions().reshape(4, 161, 3)
        length = np.linalg.norm(np.diff(x[1], axis=0), axis=1).sum()
        assert length == pytest.approx(simulation.scene.cloth.width, rel=0.05)
        assert np.mean(speeds(simulation, 160, 60)) > 1.0
