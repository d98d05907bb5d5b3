"""`lines` compared with closed forms and dense algebra: stretch, one direct solve, and the error at few substeps."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Forces, Scene, Solver, Tethers
from taichi_cloth.simulation.simulation import Simulation

LAYOUTS = ["serial", "simd"]


def hanging(substeps: int, iterations: int, fabric: Fabric) -> Scene:
    return Scene(
        cloth=Cloth(rows=9, columns=4, width=0.3, height=0.8, center=(0.0, 1.0, 0.0), pins=("top",)),
        fabric=fabric,
        solver=Solver(name="lines", substeps=substeps, iterations=iterations, damping=3.0),
    )


def moved_chain(x: np.ndarray, w: np.ndarray, rest: np.ndarray, k: np.ndarray, h: float) -> np.ndarray:
    """Return the positions after one direct solve of a linearized chain, by dense algebra."""
    gap = np.diff(x, axis=0)
    long = np.linalg.norm(gap, axis=1)
    gradient = np.zeros((len(gap), *x.shape))  # of each length with respect to each particle
    for j in range(len(gap)):
        gradient[j, j], gradient[j, j + 1] = -gap[j] / long[j], gap[j] / long[j]
    flat = gradient.reshape(len(gap), -1)
    matrix = (flat * np.repeat(w, 3)) @ flat.T + np.diag(1 / (k * h * h))
    change = np.linalg.solve(matrix, -(long - rest))
    return x + (flat.T @ change).reshape(x.shape) * w[:, None]


def substep(x: np.ndarray, free: np.ndarray, solve: Callable[[np.ndarray, float], np.ndarray], h: float) -> np.ndarray:
    """Two stages of backward Euler and the extrapolation between them (Alexander 1977), from rest, without forces."""
    gamma = 1 - 0.5**0.5
    first = solve(x, gamma * h)
    velocity = (first - x) / (gamma * h)
    start = x + (1 - gamma) * h * velocity * free
    carried = velocity * (1 - gamma) / gamma * free
    return solve(start + gamma * h * carried, gamma * h)


DIRECTIONS = {  # stiffnesses of which only one is not 0, and the particles of each chain
    "rows": (Fabric(0.0, 900.0, 0.0, 0.0), lambda i: list(i)),
    "columns": (Fabric(900.0, 0.0, 0.0, 0.0), lambda i: list(i.T)),
}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_direct_solve_matches_dense_algebra(direction: str, layout: str) -> None:
    fabric, chains_of = DIRECTIONS[direction]
    rows, columns, h = 11, 19, 1 / 60
    scene = Scene(
        cloth=Cloth(rows=rows, columns=columns, width=1.8, height=1.0, pins=("top-left", 24, 25, "right")),
        fabric=fabric,
        solver=Solver(name="lines", substeps=1, iterations=1, damping=0.0),
        forces=Forces(gravity=0.0),
    )
    with Simulation(scene, layout) as simulation:
        topology = simulation.topology
        random = np.random.default_rng(5)
        x = topology.start + random.normal(size=topology.start.shape) * 0.03
        x = x.astype(np.float32).astype(np.float64)
        w = np.where(topology.pinned, 0, 1 / topology.mass)
        simulation.cloth.upload_positions(x - topology.origin, x - topology.origin, w)
        simulation.step()
        moved = simulation.positions()
        stiffness = simulation.cloth.stiffness.to_numpy()
        springs = {tuple(sorted(pair)): e for e, pair in enumerate(topology.ends.tolist())}

        def solve(positions: np.ndarray, h: float) -> np.ndarray:
            found = positions.copy()
            for chain in chains_of(np.arange(rows * columns).reshape(rows, columns)):
                e = [springs[a, b] for a, b in zip(chain[:-1].tolist(), chain[1:].tolist(), strict=True)]
                found[chain] = moved_chain(positions[chain], w[chain], topology.rest[e], stiffness[e].astype(float), h)
            return found

        expected = substep(x, w[:, None] > 0, solve, h)
    assert np.abs(expected - x).max() > 0.01
    assert moved == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_direct_solve_along_diagonals_matches_dense_algebra(layout: str) -> None:
    """Falling diagonals, then rising ones, on a sheet that does not fill its SIMD packets."""
    rows, columns, h = 7, 21, 1 / 60
    scene = Scene(
        cloth=Cloth(rows=rows, columns=columns, width=2.0, height=0.6, pins=("top",)),
        fabric=Fabric(0.0, 0.0, 700.0, 0.0),
        solver=Solver(name="lines", substeps=1, iterations=1, damping=0.0),
        forces=Forces(gravity=0.0),
    )
    with Simulation(scene, layout) as simulation:
        topology = simulation.topology
        x = topology.start + np.random.default_rng(7).normal(size=topology.start.shape) * 0.02
        x = x.astype(np.float32).astype(np.float64)
        w = np.where(topology.pinned, 0, 1 / topology.mass)
        simulation.cloth.upload_positions(x - topology.origin, x - topology.origin, w)
        simulation.step()
        springs = {tuple(sorted(pair)): e for e, pair in enumerate(topology.ends.tolist())}
        index = np.arange(rows * columns).reshape(rows, columns)
        chains = [np.diagonal(grid, offset) for grid in (index, index[:, ::-1]) for offset in range(-rows + 1, columns)]

        def solve(positions: np.ndarray, h: float) -> np.ndarray:
            found = positions.copy()
            for chain in chains:
                e = [springs[tuple(sorted(pair))] for pair in zip(chain[:-1].tolist(), chain[1:].tolist(), strict=True)]
                if e:
                    found[chain] = moved_chain(found[chain], w[chain], topology.rest[e], np.full(len(e), 700.0), h)
            return found

        expected = substep(x, w[:, None] > 0, solve, h)
        assert np.abs(expected - x).max() > 0.005
        assert simulation.positions() == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_chains_between_pins_and_without_stiffness_stay_finite(layout: str) -> None:
    scene = hanging(2, 1, Fabric(1e6, 1e6, 1e5, 1.0))
    scene = replace(scene, cloth=replace(scene.cloth, columns=9, pins=("top", "left", 1, 10, 11, 12)))
    with Simulation(scene, layout) as simulation:
        for _ in range(30):
            simulation.step()
        assert simulation.metrics().max_strain < 0.01
        simulation.params["stiffness"] = 0.0  # springs without stiffness: everything falls
        for _ in range(30):
            simulation.step()
        assert simulation.metrics().finite
        assert simulation.positions()[-1, 1] < simulation.topology.start[-1, 1] - 0.2


def released_sheet(solver: str, substeps: int, tethers: Tethers | None = None) -> Scene:
    """A nearly horizontal sheet, released with two pinned corners (the case of the project's table of solvers)."""
    return Scene(
        cloth=Cloth(
            rows=64,
            columns=64,
            width=1.45,
            height=1.45,
            center=(0.0, 2.0, 0.0),
            rotation=(-80.0, 0.0, 0.0),
            pins=("top-left", "top-right"),
        ),
        fabric=Fabric(2000.0, 2000.0, 1000.0, 20.0),
        solver=Solver(name=solver, substeps=substeps, iterations=1, damping=0.0),
        tethers=tethers,
    )


def track(scene: Scene, frames: int = 30) -> np.ndarray:
    with Simulation(scene) as simulation:
        for _ in range(frames):
            simulation.step()
        return simulation.positions()


def test_its_error_is_a_fraction_of_that_of_xpbd_at_the_same_cost() -> None:
    reference = track(released_sheet("explicit", 300))

    def error(scene: Scene) -> float:
        """Root mean square distance from the reference, relative to the side length."""
        return float(np.sqrt(np.mean(np.sum((track(scene) - reference) ** 2, axis=1)))) / 1.45

    # A substep has two stages and takes as long as two substeps of the other solvers.
    xpbd = error(released_sheet("xpbd", 10))
    lines = error(released_sheet("lines", 5))
    tethered = error(released_sheet("lines", 5, Tethers()))
    assert lines < xpbd / 2.5
    assert tethered < xpbd / 8


@pytest.mark.parametrize("cells", [64, pytest.param(128, marks=pytest.mark.long)])
def test_a_fine_curtain_takes_the_substeps_that_transverse_waves_require(cells: int) -> None:
    """With one substep fewer it would diverge within a second."""
    scene = Scene(
        cloth=Cloth(rows=cells + 1, columns=9, width=8 / cells, height=1.0, pins=("top",), rotation=(-45.0, 0.0, 0.0)),
        fabric=Fabric(1000.0, 1000.0, 0.0, 0.0),
        solver=Solver(name="lines", substeps=1, iterations=1, damping=0.0),
    )
    with Simulation(scene) as simulation:
        assert "not 1: fewer are unstable" in simulation.warnings
        for _ in range(60):
            simulation.step()
        assert simulation.metrics().max_strain < 0.02
