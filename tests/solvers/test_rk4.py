"""`rk4` against the same equations solved finely in float64: fourth order."""

import numpy as np
import pytest

from taichi_cloth.mesh.from_scene import stiffness_of
from taichi_cloth.scene.model import Cloth, Fabric, Scene, Solver
from taichi_cloth.simulation import Simulation

DAMPING, DAMPING_TIME, FRAMES = 1.0, 1e-3, 24
# Soft enough for the fastest vibration to take five substeps of a whole frame: errors far above float32's rounding.
SCENE = Scene(
    cloth=Cloth(rows=3, columns=3, width=0.6, height=0.6, center=(0.0, 0.0, 0.0), pins=("top",), area_density=0.3),
    fabric=Fabric(warp=30.0, weft=30.0, shear=12.0, bend=3.0, damping_time=DAMPING_TIME),
    solver=Solver(name="rk4", substeps=1, damping=DAMPING),
)


def first_velocities(simulation: Simulation) -> np.ndarray:
    v = np.random.default_rng(1).normal(0.0, 0.5, (9, 3))
    v[simulation.topology.pinned] = 0
    return v


def moved(substeps: int) -> np.ndarray:
    """Where the sheet is after all frames."""
    with Simulation(SCENE) as simulation:
        simulation.set("substeps", substeps)
        assert simulation.substeps == substeps
        simulation.solver.set_velocities(first_velocities(simulation), 1 / 60 / substeps)
        for _ in range(FRAMES):
            simulation.advance_frame()
        return simulation.positions()


def solved() -> np.ndarray:
    """The same by plain NumPy in float64, 64 substeps of a frame."""
    with Simulation(SCENE) as simulation:
        topology, v = simulation.topology, first_velocities(simulation)
    stiffness = stiffness_of(SCENE, "fabric", topology)[:, None]
    a, b = topology.ends.T
    free = ~topology.pinned[:, None]

    def slope(state: np.ndarray) -> np.ndarray:
        x, v = state
        gap = x[b] - x[a]
        long = np.linalg.norm(gap, axis=1, keepdims=True)
        along = ((v[b] - v[a]) * gap).sum(axis=1, keepdims=True) / long
        pull = stiffness * (long - topology.rest[:, None] + DAMPING_TIME * along) * gap / long
        force = np.zeros_like(x)
        np.add.at(force, a, pull)
        np.add.at(force, b, -pull)
        return np.array([v, free * (force / topology.mass[:, None] + [0, -9.81, 0] - DAMPING * v)])

    h = 1 / 60 / 64
    state = np.array([topology.start, v])
    for _ in range(64 * FRAMES):
        k1 = slope(state)
        k2 = slope(state + h / 2 * k1)
        k3 = slope(state + h / 2 * k2)
        k4 = slope(state + h * k3)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return state[0]


def test_half_the_substep_leaves_a_sixteenth_of_the_error() -> None:
    exact = solved()
    errors = [np.sqrt(((moved(substeps) - exact) ** 2).mean()) for substeps in (1, 2, 4)]
    assert errors[0] < 1e-2  # [m] the sheet swings by 0.5 m
    assert errors[2] > 1e-6  # not rounding yet
    assert 12 < (errors[0] / errors[2]) ** 0.5 < 20


def test_a_held_particle_stands_in_every_stage_where_the_hand_is() -> None:
    """It drags its neighbours by the hand's path and not by jumps: twice the substeps change next to nothing."""
    ends = []
    for substeps in (4, 8):
        with Simulation(SCENE) as simulation:
            simulation.set("substeps", substeps)
            start = simulation.positions()[7]
            for k in range(1, 11):
                simulation.grab(7, start + [0.0, 0.0, 0.02 * k])
                simulation.advance_frame()
            ends.append(simulation.positions())
    assert ends[0][7] == pytest.approx(start + [0.0, 0.0, 0.2], abs=1e-6)
    assert np.abs(ends[0] - ends[1]).max() < 2e-5
