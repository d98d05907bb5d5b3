"""`[limit]`: with every method, what would stretch more under its weight hangs at the limit, and not above it.

On lists, which compile soonest: that strips and threads limit alike is for `test_paths.py`.
"""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.scene.model import SOLVER_NAMES, Cloth, Fabric, Limit, Scene, Solver, Springs
from taichi_cloth.simulation import Simulation

# Two rows: no free particle is at the end of two springs that are limited, so that one sweep is the exact answer.
HUNG = Scene(
    cloth=Cloth(rows=2, columns=9, width=0.8, height=0.1, center=(0.0, 1.0, 0.0), pins=("top",)),
    fabric=Fabric(warp=1.0, weft=1.0, shear=0.0, bend=0.0),
    springs=Springs(structural=0.002, shear=0.0, bend=0.0),
)
LIMIT = 0.02


def strain(scene: Scene) -> float:
    """Of the vertical springs, at rest; the largest of any frame must be no more."""
    most = 0.0
    with Simulation(scene, "list") as simulation:
        for _ in range(60):
            simulation.advance_frame()
            x = simulation.positions().reshape(2, 9, 3)
            most = max(most, float((np.linalg.norm(x[0] - x[1], axis=1) / 0.1 - 1).max()))
        assert simulation.measure().kinetic_energy < 1e-6 or scene.limit is None
        lasting = float((np.linalg.norm(x[0] - x[1], axis=1) / 0.1 - 1).mean())
    if scene.limit is not None:
        assert most <= LIMIT + 1e-5
    return lasting


@pytest.mark.parametrize("solver", SOLVER_NAMES)
def test_what_hangs_is_as_long_as_its_limit_and_no_longer(solver: str) -> None:
    free = replace(HUNG, solver=Solver(solver, substeps=10, iterations=1, damping=8.0))
    assert strain(replace(free, limit=Limit(LIMIT, sweeps=1))) == pytest.approx(LIMIT, abs=1e-5)
    assert strain(free) > 2 * LIMIT  # the weight asks for more


@pytest.mark.parametrize("solver", SOLVER_NAMES)
def test_what_stays_within_its_limit_is_left_alone(solver: str) -> None:
    free = replace(HUNG, solver=Solver(solver, substeps=10, iterations=1, damping=8.0))
    places = []
    for scene in (free, replace(free, limit=Limit(5.0, sweeps=1))):
        with Simulation(scene, "list") as simulation:
            for _ in range(10):
                simulation.advance_frame()
            places.append(simulation.positions())
    assert places[0] == pytest.approx(places[1], abs=1e-7)
