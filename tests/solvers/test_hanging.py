"""A sheet hanging from its top edge stretches like springs under weights (accuracy reference A3)."""

import numpy as np
import pytest

from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation

CONSTANT = 20.0  # [N/m]
# The stretch does not depend on iterations or substeps. Zeroing λ in every iteration instead of every substep, a known
# bug of XPBD, would leave a fifth of it at 5 iterations and a twenty-fifth at 20 (B3). `lines` needs one iteration.
CASES = [
    *(("xpbd", "serial", *numbers) for numbers in ((5, 5), (5, 20), (5, 80), (2, 40), (20, 5))),
    *(("lines", "serial", *numbers) for numbers in ((1, 1), (2, 1), (5, 1), (20, 1), (5, 4))),
    *(("lines", "simd", *numbers) for numbers in ((1, 1), (2, 1), (5, 1), (20, 1), (5, 4))),
    ("implicit", "serial", 5, 10),
    ("implicit", "simd", 5, 10),
]


def hanging(solver: str, substeps: int, iterations: int) -> Scene:
    return Scene(
        cloth=Cloth(rows=9, columns=4, width=0.3, height=0.8, center=(0.0, 1.0, 0.0), pins=("top",)),
        fabric=Fabric(warp=CONSTANT, weft=CONSTANT, shear=0.0, bend_spring=0.0),
        solver=Solver(name=solver, substeps=substeps, iterations=iterations, damping=3.0),
    )


@pytest.mark.parametrize(("solver", "layout", "substeps", "iterations"), CASES)
def test_every_spring_carries_the_weight_below_it(solver: str, layout: str, substeps: int, iterations: int) -> None:
    with Simulation(hanging(solver, substeps, iterations), layout) as simulation:
        for _ in range(400):
            simulation.step()
        mass = simulation.topology.mass.reshape(9, 4)
        carried = np.cumsum(mass[::-1], axis=0)[::-1][1:]  # by the spring above each row [kg]
        constant = CONSTANT * np.array([0.5, 1, 1, 0.5])  # a column on the edge has half the mass and stiffness
        expected = np.cumsum(9.81 * carried / constant, axis=0)
        drop = (simulation.topology.start - simulation.positions())[:, 1].reshape(9, 4)[1:]
        assert expected[-1].min() > 0.01
        assert drop == pytest.approx(expected, rel=0.01)


def test_stretch_is_inversely_proportional_to_stiffness() -> None:
    drops = []
    for stiffness in (1.0, 0.5):
        with Simulation(hanging("xpbd", 5, 40)) as simulation:
            simulation.params["stiffness"] = stiffness
            for _ in range(400):
                simulation.step()
            drops.append((simulation.topology.start - simulation.positions())[-1, 1])
    assert drops[1] / drops[0] == pytest.approx(2.0, rel=0.02)
