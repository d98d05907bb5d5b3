"""`[strain_limit]`: with every solver, cloth that would stretch farther under its weight hangs at the limit.

In the serial layout, which compiles fastest: `test_paths.py` compares the layouts.
"""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.scene.fabric_schema import Fabric, VerletSprings
from taichi_cloth.scene.schema import SOLVER_NAMES, Cloth, Scene, Solver, StrainLimit
from taichi_cloth.simulation.simulation import Simulation

# Two rows: no free particle belongs to two limited springs, so one iteration is exact.
HUNG = Scene(
    cloth=Cloth(rows=2, columns=9, width=0.8, height=0.1, center=(0.0, 1.0, 0.0), pins=("top",)),
    fabric=Fabric(warp=1.0, weft=1.0, shear=0.0, bend_spring=0.0),
    verlet=VerletSprings(structural=0.002, shear=0.0, bend=0.0),
)
LIMIT = 0.02


def strain(scene: Scene) -> float:
    """Return the strain of the vertical springs at rest, and check that no frame exceeds the limit."""
    most = 0.0
    with Simulation(scene, "serial") as simulation:
        for _ in range(60):
            simulation.step()
            x = simulation.positions().reshape(2, 9, 3)
            most = max(most, float((np.linalg.norm(x[0] - x[1], axis=1) / 0.1 - 1).max()))
        assert simulation.metrics().kinetic_energy < 1e-6 or scene.strain_limit is None
        lasting = float((np.linalg.norm(x[0] - x[1], axis=1) / 0.1 - 1).mean())
    if scene.strain_limit is not None:
        assert most <= LIMIT + 1e-5
    return lasting


@pytest.mark.parametrize("solver", SOLVER_NAMES)
def test_hanging_cloth_is_stretched_to_the_limit(solver: str) -> None:
    free = replace(HUNG, solver=Solver(solver, substeps=10, iterations=1, damping=8.0))
    assert strain(replace(free, strain_limit=StrainLimit(LIMIT, iterations=1))) == pytest.approx(LIMIT, abs=1e-5)
    assert strain(free) > 2 * LIMIT  # the weight would stretch it more


@pytest.mark.parametrize("solver", SOLVER_NAMES)
def test_strain_within_the_limit_is_not_changed(solver: str) -> None:
    free = replace(HUNG, solver=Solver(solver, substeps=10, iterations=1, damping=8.0))
    positions = []
    for scene in (free, replace(free, strain_limit=StrainLimit(5.0, iterations=1))):
        with Simulation(scene, "serial") as simulation:
            for _ in range(10):
                simulation.step()
            positions.append(simulation.positions())
    assert positions[0] == pytest.approx(positions[1], abs=1e-7)
