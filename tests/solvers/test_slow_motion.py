"""A frame substep by substep, with a look after each."""

import numpy as np
import pytest

from taichi_cloth.scene.model import SOLVER_NAMES, Cloth, Fabric, Scene, Solver, Sphere
from taichi_cloth.simulation import Simulation


@pytest.mark.parametrize("solver", SOLVER_NAMES)
def test_slow_motion_is_the_same_motion(solver: str) -> None:
    """Bit for bit, with a ball and a hand that move within the frame."""
    ball = Sphere(center=(0.0, 0.0, 0.2), radius=0.15, path=((0.0, 0, 0, 0), (1.0, 0, 0, -3.0)))
    scene = Scene(
        cloth=Cloth(rows=5, columns=10, width=0.9, height=0.4, center=(0.0, 0.0, 0.0)),
        fabric=Fabric(warp=100.0, weft=100.0, shear=50.0, bend=0.0),
        solver=Solver(solver, substeps=4, iterations=2),
        spheres=(ball,),
    )
    with Simulation(scene, "list") as whole, Simulation(scene, "list") as slow:
        shares: list[float] = []
        for frame in range(3):
            for simulation in (whole, slow):
                simulation.grab(44, (0.1 * frame, 0.0, 0.3))
            whole.advance_frame()
            slow.advance_slowly(shares.append)
            assert np.array_equal(slow.positions(), whole.positions())
            assert np.array_equal(slow.velocities(), whole.velocities())
        steps = whole.substeps
        assert shares == pytest.approx([(k + 1) / steps for k in range(steps)] * 3)
