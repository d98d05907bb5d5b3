"""`spring` and `rk4`: their order, against the same equations solved finely in float64, and their stability bound."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.mesh.frequency import MARGIN
from taichi_cloth.mesh.from_scene import stiffness_of
from taichi_cloth.scene.model import Cloth, Fabric, Forces, Scene, Solver
from taichi_cloth.simulation import Simulation

FRAMES = 24
# Soft enough for the fastest vibration to take five substeps of a whole frame: errors far above float32's rounding.
SCENE = Scene(
    cloth=Cloth(rows=3, columns=3, width=0.6, height=0.6, center=(0.0, 0.0, 0.0), pins=("top",), area_density=0.3),
    fabric=Fabric(warp=30.0, weft=30.0, shear=12.0, bend=3.0),
    solver=Solver(substeps=1, damping=0.0),
)


def soft(solver: str, *, damping: float = 0.0, damping_time: float = 0.0) -> Scene:
    return replace(
        SCENE,
        fabric=replace(SCENE.fabric, damping_time=damping_time),
        solver=replace(SCENE.solver, name=solver, damping=damping),
    )


def first_velocities(simulation: Simulation) -> np.ndarray:
    v = np.random.default_rng(1).normal(0.0, 0.5, (9, 3))
    v[simulation.topology.pinned] = 0
    return v


def moved(scene: Scene, substeps: int) -> np.ndarray:
    """Where the sheet is after all frames."""
    with Simulation(scene) as simulation:
        simulation.set("substeps", substeps)
        assert simulation.substeps == substeps
        simulation.solver.set_velocities(first_velocities(simulation), 1 / 60 / substeps)
        for _ in range(FRAMES):
            simulation.advance_frame()
        return simulation.positions()


def solved(scene: Scene) -> np.ndarray:
    """The same by plain NumPy in float64: Runge–Kutta, 64 substeps of a frame."""
    with Simulation(scene) as simulation:
        topology, v = simulation.topology, first_velocities(simulation)
    stiffness = stiffness_of(scene, "fabric", topology)[:, None]
    a, b = topology.ends.T
    free = ~topology.pinned[:, None]

    def slope(state: np.ndarray) -> np.ndarray:
        x, v = state
        gap = x[b] - x[a]
        long = np.linalg.norm(gap, axis=1, keepdims=True)
        along = ((v[b] - v[a]) * gap).sum(axis=1, keepdims=True) / long
        pull = stiffness * (long - topology.rest[:, None] + scene.fabric.damping_time * along) * gap / long
        force = np.zeros_like(x)
        np.add.at(force, a, pull)
        np.add.at(force, b, -pull)
        return np.array([v, free * (force / topology.mass[:, None] + [0, -9.81, 0] - scene.solver.damping * v)])

    h = 1 / 60 / 64
    state = np.array([topology.start, v])
    for _ in range(64 * FRAMES):
        k1 = slope(state)
        k2 = slope(state + h / 2 * k1)
        k3 = slope(state + h / 2 * k2)
        k4 = slope(state + h * k3)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return state[0]


def error(scene: Scene, substeps: int, exact: np.ndarray) -> float:
    """Root mean square [m]; the sheet swings by 0.5 m."""
    return float(np.sqrt(((moved(scene, substeps) - exact) ** 2).mean()))


def test_rk4_half_the_substep_leaves_a_sixteenth_of_the_error() -> None:
    scene = soft("rk4", damping=1.0, damping_time=1e-3)
    exact = solved(scene)
    errors = [error(scene, substeps, exact) for substeps in (1, 2, 4)]
    assert errors[0] < 1e-2
    assert errors[2] > 1e-6  # not rounding yet
    assert 12 < (errors[0] / errors[2]) ** 0.5 < 20


def test_spring_half_the_substep_leaves_a_quarter_of_the_error() -> None:
    scene = soft("spring")
    exact = solved(scene)
    errors = [error(scene, substeps, exact) for substeps in (4, 8, 16)]
    assert errors[0] < 1e-2
    assert errors[2] > 1e-5
    assert 3.5 < (errors[0] / errors[2]) ** 0.5 < 4.5


def test_spring_is_of_first_order_where_forces_depend_on_velocity() -> None:
    """The price of one force a substep: dashpots and damping see the velocity of half a substep ago."""
    scene = soft("spring", damping=1.0, damping_time=1e-3)
    exact = solved(scene)
    errors = [error(scene, substeps, exact) for substeps in (16, 32, 64)]
    assert errors[0] < 1e-2
    assert 1.7 < (errors[0] / errors[2]) ** 0.5 < 2.5


@pytest.mark.parametrize("solver", ["spring", "rk4"])
def test_no_damping_is_too_much(solver: str) -> None:
    """At 1e6/s nothing is left of a velocity, not even a number of float32; the sheet creeps as it does at 1e3/s."""
    moves = moved(soft(solver, damping=1e6), 20) - moved(soft(solver, damping=1e3), 20)
    assert np.abs(moves).max() < 5e-3


def test_a_held_particle_stands_in_every_slope_where_the_hand_is() -> None:
    """It drags its neighbours by the hand's path and not by jumps: twice the substeps change next to nothing."""
    ends = []
    for substeps in (4, 8):
        with Simulation(soft("rk4", damping=1.0, damping_time=1e-3)) as simulation:
            simulation.set("substeps", substeps)
            start = simulation.positions()[7]
            for k in range(1, 11):
                simulation.grab(7, start + [0.0, 0.0, 0.02 * k])
                simulation.advance_frame()
            ends.append(simulation.positions())
    assert ends[0][7] == pytest.approx(start + [0.0, 0.0, 0.2], abs=1e-6)
    assert np.abs(ends[0] - ends[1]).max() < 2e-5


# -- stability -----------------------------------------------------------------------------------------

STIFF = Scene(
    cloth=Cloth(rows=9, columns=9, width=1.0, height=1.0, center=(0.0, 0.0, 0.0), pins=("top",)),
    fabric=Fabric(warp=2000.0, weft=2000.0, shear=500.0, bend=50.0),
    forces=Forces(gravity=0.0),
    solver=Solver(name="spring", substeps=1, damping=0.0),
)


def energies(solver: str, substeps: int | None, damping_time: float, frames: int) -> tuple[np.ndarray, int]:
    """Energy [J] after each frame of a flat sheet that is shaken in its plane by 5 cm/s, and the substeps taken.

    `substeps` replaces the bound: nobody can ask for fewer.
    """
    scene = replace(
        STIFF, solver=replace(STIFF.solver, name=solver), fabric=replace(STIFF.fabric, damping_time=damping_time)
    )
    with Simulation(scene) as simulation:
        if substeps is not None:
            simulation._least_substeps = substeps
        topology, taken = simulation.topology, simulation.substeps
        stiffness = stiffness_of(scene, "fabric", topology)
        v = np.random.default_rng(2).normal(0.0, 0.05, (81, 3)) * [1, 1, 0]
        v[topology.pinned] = 0
        simulation.solver.set_velocities(v, 1 / 60 / taken)
        found = []
        for _ in range(frames):
            simulation.advance_frame()
            x, v = simulation.positions(), simulation.velocities()
            gap = np.linalg.norm(x[topology.ends[:, 0]] - x[topology.ends[:, 1]], axis=1) - topology.rest
            found.append(0.5 * (topology.mass @ (v**2).sum(axis=1) + stiffness @ gap**2))
        return np.array(found), taken


@pytest.mark.parametrize("solver", ["spring", "rk4"])
@pytest.mark.parametrize("damping_time", [0.0, 2e-4])
def test_the_substeps_taken_are_enough_and_not_many_more(solver: str, damping_time: float) -> None:
    energy, taken = energies(solver, None, damping_time, 120)
    assert energy.max() < 1.5 * energy[0]
    # The bound holds for every shape; a flat sheet's springs resist in one direction only, and its fastest vibration
    # is up to a third slower. Fewer substeps than that blow up.
    with np.errstate(all="ignore"):
        fewer, _ = energies(solver, int(taken / MARGIN * 0.6), damping_time, 120)
    assert not fewer[-1] < 1e3 * energy[0]


def test_the_energy_of_spring_stays_within_a_band_for_ten_thousand_substeps() -> None:
    """A symplectic method's energy swings and does not drift."""
    energy, taken = energies("spring", None, 0.0, 600)
    assert taken * 600 > 10_000
    assert energy[-100:].mean() == pytest.approx(energy[:100].mean(), rel=0.02)


@pytest.mark.parametrize("solver", ["spring", "rk4"])
def test_fewer_substeps_than_are_stable_are_raised_and_it_says_so(solver: str) -> None:
    with Simulation(replace(STIFF, solver=replace(STIFF.solver, name=solver))) as simulation:
        least = simulation.substeps
        assert least > 5
        assert simulation.get("substeps") == 1
        assert simulation.advice == f"{solver} takes {least} substeps, not 1: fewer are unstable"
        assert f"{solver} {least} " in simulation.method
        simulation.set("substeps", 2 * least)
        assert (simulation.substeps, simulation.advice) == (2 * least, "")


# -- physics -------------------------------------------------------------------------------------------

# Bottom row of a swinging curtain of n × n cells, (forward, up) [m] after 0.25, 0.5 and 1 s: converged in float64.
CURTAINS = {
    16: ((0.5231750679, -0.8297375679), (-0.2103274487, -0.9759157740), (-0.6740654639, -0.7338234369)),
    32: ((0.5226717572, -0.8292342573), (-0.2309021056, -0.9685538124), (-0.6677511421, -0.7397831360)),
}


@pytest.mark.parametrize("solver", ["spring", "rk4"])
@pytest.mark.parametrize("cells", CURTAINS)
def test_a_swinging_curtain_is_within_two_hundred_thousandths_of_its_side(cells: int, solver: str) -> None:
    """Pinned along its top edge, held flat at 45°, let go; columns of structural springs and equal masses."""
    middle = np.sqrt(0.125)
    scene = Scene(
        cloth=Cloth(
            rows=cells + 1,
            columns=cells + 1,
            width=1.0,
            height=1.0,
            center=(0.0, -middle, middle),
            rotation=(-45.0, 0.0, 0.0),
            pins=("top",),
            area_density=0.2,
            lumping="equal",
        ),
        fabric=Fabric(warp=1000.0, weft=1000.0, shear=0.0, bend=0.0),
        solver=Solver(name=solver, substeps=1, damping=0.0),
    )
    with Simulation(scene) as simulation:
        for frames, (forward, up) in zip((15, 15, 30), CURTAINS[cells], strict=True):
            for _ in range(frames):
                simulation.advance_frame()
            bottom = simulation.positions()[-cells - 1 :]
            assert np.hypot(bottom[:, 2] - forward, bottom[:, 1] - up).max() < 2e-5
