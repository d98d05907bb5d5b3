"""Pins that move as a body does."""

from dataclasses import replace
from math import exp, sin, sqrt

import numpy as np
import pytest

from taichi_cloth.scene import load_scene
from taichi_cloth.scene.errors import SceneError
from taichi_cloth.scene.model import USUAL, Cloth, Fabric, Forces, Grip, Scene, Solver, Tethers
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


@pytest.mark.parametrize("path", ["list", "lanes"])
@pytest.mark.parametrize("solver", ["xpbd", "rk4", "projective"])  # the others begin the next substep at once
def test_what_a_grip_or_a_hand_leads_has_its_velocity(solver: str, path: str) -> None:
    """Dashpots and air see it: ω × r plus the way that the body goes, and the hand's own."""
    center, spin, going = np.array([-0.4, 1.0, 0.0]), (0.0, 90.0, 0.0), np.array([0.3, 0.0, 0.6])
    both = Grip(pins=("right",), center=tuple(center), spin=spin, path=((0.0, 0.0, 0.0, 0.0), (1.0, *going)))
    with Simulation(scene(solver, both), path) as simulation:
        simulation.grab(20, simulation.positions()[20])
        for k in range(1, 4):
            simulation.grab(20, simulation.topology.start[20] + [0.02 * k, 0.0, 0.0])
            simulation.advance_frame()
        seconds = simulation.seconds
        away = simulation.positions().reshape(6, 9, 3)[:, 8] - center - going * seconds
        # Within a frame it goes straight on and turns at one rate about its middle.
        expected = going + np.cross([0.0, np.radians(90.0), 0.0], away)
        assert simulation.velocities().reshape(6, 9, 3)[:, 8] == pytest.approx(expected, abs=2e-3)
        assert np.linalg.norm(expected - going, axis=1).min() > 1.0
        assert simulation.velocities()[20] == pytest.approx([1.2, 0.0, 0.0], abs=1e-4)  # 2 cm a frame


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


@pytest.mark.parametrize("path", ["list", "lanes"])
def test_tethers_follow_a_grip_within_the_frame(path: str) -> None:
    """A corner that goes 20 cm up in one frame takes what is tied to it all the way along, not a substep behind."""
    rising = Grip(pins=("top-left",), center=(0.0, 0.0, 0.0), path=((0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 12.0, 0.0)))
    loose = Fabric(1e-9, 1e-9, 1e-9, 0.0)
    tied = replace(scene("xpbd", rising), fabric=loose, tethers=Tethers(1.0), solver=Solver("xpbd", 4, 1, damping=0.0))
    with Simulation(tied, path) as simulation:
        simulation.advance_frame()
        x, start = simulation.positions(), simulation.topology.start
        assert x[0] - start[0] == pytest.approx([0.0, 0.2, 0.0], abs=1e-5)
        assert (np.linalg.norm(x - x[0], axis=1) <= np.linalg.norm(start - start[0], axis=1) + 1e-5).all()


def test_a_grip_that_names_no_particle_is_refused(tmp_path) -> None:
    file = tmp_path / "twist.toml"
    file.write_text('[[grips]]\npins = ["left", 720]\n', encoding="utf-8")
    with pytest.raises(SceneError, match=r"grips\[0\]\.pins\[1\]: 720 is no particle: indices run from 0 to 719"):
        load_scene(file)


@pytest.mark.parametrize(("solver", "substeps"), [("xpbd", 200), ("spring", 200), ("lines", 50), ("rk4", 100)])
def test_a_dashpot_sees_how_its_grip_moves(solver: str, substeps: int) -> None:
    """A mass on a spring and dashpot whose upper end goes up at 0.2 m/s: seen from there it starts at −0.2 m/s."""
    speed, tau, seconds = 0.2, 0.02, 0.2
    scene = Scene(
        cloth=Cloth(rows=2, columns=2, width=1.0, height=1.0, pins=(), lumping="equal"),
        fabric=Fabric(warp=5.0, weft=0.0, shear=0.0, bend=0.0, damping_time=tau),
        solver=Solver(solver, substeps, 1, damping=0.0),
        forces=Forces(gravity=0.0),
        grips=(Grip(pins=("top",), path=((0, 0, 0, 0), (10, 0, 10 * speed, 0))),),
    )
    with Simulation(scene) as simulation:
        for _ in range(round(60 * seconds)):
            simulation.advance_frame()
        moved = (simulation.positions() - simulation.topology.start)[2:, 1]
    omega = sqrt(5.0 / 0.2)
    zeta = tau * omega / 2
    damped = omega * sqrt(1 - zeta**2)
    exact = speed * (seconds - exp(-zeta * omega * seconds) * sin(damped * seconds) / damped)
    assert moved == pytest.approx([exact, exact], rel=2e-3)
