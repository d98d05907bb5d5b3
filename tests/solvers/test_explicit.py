"""`explicit` and `rk4`: order of convergence, against a fine float64 solution, and stability bound."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.geometry.cloth_builder import spring_stiffness
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.geometry.stability_bounds import MARGIN
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Forces, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation

FRAMES = 24
# So soft that the fastest vibration takes five substeps of a whole frame: errors are far above float32 rounding.
SCENE = Scene(
    cloth=Cloth(rows=3, columns=3, width=0.6, height=0.6, center=(0.0, 0.0, 0.0), pins=("top",), area_density=0.3),
    fabric=Fabric(warp=30.0, weft=30.0, shear=12.0, bend_spring=3.0),
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
    """Return the positions after all frames."""
    with Simulation(scene) as simulation:
        simulation.params["substeps"] = substeps
        assert simulation.substeps == substeps
        simulation.solver.set_velocities(first_velocities(simulation), 1 / 60 / substeps)
        for _ in range(FRAMES):
            simulation.step()
        return simulation.positions()


def solved(scene: Scene) -> np.ndarray:
    """Return the same by NumPy in float64: Runge–Kutta with 64 substeps per frame."""
    with Simulation(scene) as simulation:
        topology, v = simulation.topology, first_velocities(simulation)
    stiffness = spring_stiffness(scene, "fabric", topology)[:, None]
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


def test_rk4_is_of_fourth_order() -> None:
    scene = soft("rk4", damping=1.0, damping_time=1e-3)
    exact = solved(scene)
    errors = [error(scene, substeps, exact) for substeps in (1, 2, 4)]
    assert errors[0] < 1e-2
    assert errors[2] > 1e-6  # not rounding yet
    assert 12 < (errors[0] / errors[2]) ** 0.5 < 20


def test_explicit_is_of_second_order() -> None:
    scene = soft("explicit")
    exact = solved(scene)
    errors = [error(scene, substeps, exact) for substeps in (4, 8, 16)]
    assert errors[0] < 1e-2
    assert errors[2] > 1e-5
    assert 3.5 < (errors[0] / errors[2]) ** 0.5 < 4.5


def test_explicit_is_of_first_order_where_forces_depend_on_velocity() -> None:
    """With one force evaluation per substep, dampers use the velocity of half a substep before."""
    scene = soft("explicit", damping=1.0, damping_time=1e-3)
    exact = solved(scene)
    errors = [error(scene, substeps, exact) for substeps in (16, 32, 64)]
    assert errors[0] < 1e-2
    assert 1.7 < (errors[0] / errors[2]) ** 0.5 < 2.5


@pytest.mark.parametrize("solver", ["explicit", "rk4"])
def test_extreme_damping_is_stable(solver: str) -> None:
    """At 1e6/s the velocity factor is 0 in float32; the sheet moves as slowly as at 1e3/s."""
    moves = moved(soft(solver, damping=1e6), 20) - moved(soft(solver, damping=1e3), 20)
    assert np.abs(moves).max() < 5e-3


def test_every_stage_of_rk4_uses_the_position_of_the_grab() -> None:
    """A grabbed particle moves along the path of the grab, not in steps: twice the substeps change almost nothing."""
    ends = []
    for substeps in (4, 8):
        with Simulation(soft("rk4", damping=1.0, damping_time=1e-3)) as simulation:
            simulation.params["substeps"] = substeps
            start = simulation.positions()[7]
            grab = simulation.grab(7)
            for k in range(1, 11):
                grab.move_to(start + [0.0, 0.0, 0.02 * k])
                simulation.step()
            ends.append(simulation.positions())
    assert ends[0][7] == pytest.approx(start + [0.0, 0.0, 0.2], abs=1e-6)
    assert np.abs(ends[0] - ends[1]).max() < 2e-5


# -- stability -----------------------------------------------------------------------------------------

STIFF = Scene(
    cloth=Cloth(rows=9, columns=9, width=1.0, height=1.0, center=(0.0, 0.0, 0.0), pins=("top",)),
    fabric=Fabric(warp=2000.0, weft=2000.0, shear=500.0, bend_spring=50.0),
    forces=Forces(gravity=0.0),
    solver=Solver(name="explicit", substeps=1, damping=0.0),
)


def energies(solver: str, substeps: int | None, damping_time: float, frames: int) -> tuple[np.ndarray, int]:
    """Return the energy [J] of a flat sheet after each frame, and its substeps; it starts with 5 cm/s in its plane.

    `substeps` replaces the stability bound, below which no parameter can set it.
    """
    scene = replace(
        STIFF, solver=replace(STIFF.solver, name=solver), fabric=replace(STIFF.fabric, damping_time=damping_time)
    )
    with Simulation(scene) as simulation:
        if substeps is not None:
            simulation.built = simulation.built._replace(min_stable_substeps=substeps)
        topology, substeps_used = simulation.topology, simulation.substeps
        stiffness = spring_stiffness(scene, "fabric", topology)
        v = np.random.default_rng(2).normal(0.0, 0.05, (81, 3)) * [1, 1, 0]
        v[topology.pinned] = 0
        simulation.solver.set_velocities(v, 1 / 60 / substeps_used)
        found = []
        for _ in range(frames):
            simulation.step()
            x, v = simulation.positions(), simulation.velocities()
            gap = np.linalg.norm(x[topology.ends[:, 0]] - x[topology.ends[:, 1]], axis=1) - topology.rest
            found.append(0.5 * (topology.mass @ (v**2).sum(axis=1) + stiffness @ gap**2))
        return np.array(found), substeps_used


@pytest.mark.parametrize("solver", ["explicit", "rk4"])
@pytest.mark.parametrize("damping_time", [0.0, 2e-4])
def test_the_stability_bound_is_sufficient_and_tight(solver: str, damping_time: float) -> None:
    energy, substeps_used = energies(solver, None, damping_time, 120)
    assert energy.max() < 1.5 * energy[0]
    # The bound holds for every shape; the springs of a flat sheet resist in one direction only, and its fastest
    # vibration is up to a third slower. With fewer substeps than that it diverges.
    with np.errstate(all="ignore"):
        fewer, _ = energies(solver, int(substeps_used / MARGIN * 0.6), damping_time, 120)
    assert not fewer[-1] < 1e3 * energy[0]


def test_the_energy_of_explicit_does_not_drift_in_ten_thousand_substeps() -> None:
    """The energy of a symplectic method oscillates but does not drift."""
    energy, substeps_used = energies("explicit", None, 0.0, 600)
    assert substeps_used * 600 > 10_000
    assert energy[-100:].mean() == pytest.approx(energy[:100].mean(), rel=0.02)


@pytest.mark.parametrize("solver", ["explicit", "rk4"])
def test_unstable_substeps_are_raised_with_a_warning(solver: str) -> None:
    with Simulation(replace(STIFF, solver=replace(STIFF.solver, name=solver))) as simulation:
        least = simulation.substeps
        assert least > 5
        assert simulation.params["substeps"] == 1
        assert simulation.warnings == f"{solver} takes {least} substeps, not 1: fewer are unstable"
        assert f"{solver} {least} " in simulation.method
        simulation.params["substeps"] = 2 * least
        assert (simulation.substeps, simulation.warnings) == (2 * least, "")


# -- physics -------------------------------------------------------------------------------------------

# Bottom row of a swinging curtain of n × n cells, (forward, up) [m] after 0.25, 0.5 and 1 s, converged in float64.
CURTAINS = {
    16: ((0.5231750679, -0.8297375679), (-0.2103274487, -0.9759157740), (-0.6740654639, -0.7338234369)),
    32: ((0.5226717572, -0.8292342573), (-0.2309021056, -0.9685538124), (-0.6677511421, -0.7397831360)),
}


@pytest.mark.parametrize("solver", ["explicit", "rk4"])
@pytest.mark.parametrize("cells", CURTAINS)
def test_a_swinging_curtain_matches_the_converged_solution(cells: int, solver: str) -> None:
    """Pinned along its top edge, flat at 45°, then released; structural springs and equal masses. Within 2e-5 of its
    side."""
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
            mass_lumping="uniform",
        ),
        fabric=Fabric(warp=1000.0, weft=1000.0, shear=0.0, bend_spring=0.0),
        solver=Solver(name=solver, substeps=1, damping=0.0),
    )
    with Simulation(scene) as simulation:
        for frames, (forward, up) in zip((15, 15, 30), CURTAINS[cells], strict=True):
            for _ in range(frames):
                simulation.step()
            bottom = simulation.positions()[-cells - 1 :]
            assert np.hypot(bottom[:, 2] - forward, bottom[:, 1] - up).max() < 2e-5


def test_a_curtain_that_was_pulled_hard_comes_to_rest() -> None:
    """At its fewest substeps, released from a strain of hundreds of percent. Below √3 of h·ω it does not tangle."""
    scene = load_scene("curtain")
    scene = replace(scene, solver=replace(scene.solver, name="explicit", substeps=1))
    with Simulation(scene) as simulation:
        assert simulation.substeps == simulation.min_stable_substeps
        simulation.step(60)
        hand, start = simulation.grab(500), simulation.positions()[500]
        for k in range(40):
            hand.move_to(start + np.array((0.0, -2.0, 1.0)) * (k + 1) / 40)
            simulation.step()
        a, b = simulation.topology.ends.T
        largest = []
        for frames in (0, 300):
            hand.release()
            simulation.step(frames)
            x = simulation.positions()
            largest.append((np.linalg.norm(x[a] - x[b], axis=1) / simulation.topology.rest).max() - 1)
    assert largest[0] > 1
    assert largest[1] < 0.1, largest
