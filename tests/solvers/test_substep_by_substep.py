"""A frame advanced substep by substep."""

from typing import Never

import numpy as np
import pytest

from taichi_cloth.scene.collider_schema import Sphere
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import SOLVER_NAMES, Cloth, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import UsageError


@pytest.mark.parametrize("solver", SOLVER_NAMES)
def test_step_by_substep_is_bit_equal_to_step(solver: str) -> None:
    """With a sphere and a grab that move within the frame."""
    sphere = Sphere(
        center=(0.0, 0.0, 0.2), radius=0.15, keyframes=((0.0, 0, 0, 0), (1.0, 0, 0, -3.0)), margin=0.15, friction=0.0
    )
    scene = Scene(
        cloth=Cloth(rows=5, columns=10, width=0.9, height=0.4, center=(0.0, 0.0, 0.0)),
        fabric=Fabric(warp=100.0, weft=100.0, shear=50.0, bend_spring=0.0),
        solver=Solver(solver, substeps=4, iterations=2),
        spheres=(sphere,),
    )
    with Simulation(scene, "serial") as whole, Simulation(scene, "serial") as slow:
        shares: list[float] = []
        grabs = [simulation.grab(44) for simulation in (whole, slow)]
        for frame in range(3):
            for grab in grabs:
                grab.move_to((0.1 * frame, 0.0, 0.3))
            whole.step()
            slow.step_by_substep(shares.append)
            assert np.array_equal(slow.positions(), whole.positions())
            assert np.array_equal(slow.velocities(), whole.velocities())
        steps = whole.substeps
        assert shares == pytest.approx([(k + 1) / steps for k in range(steps)] * 3)


def test_a_callback_that_raises_leaves_a_whole_frame() -> None:
    def fail(fraction: float) -> Never:
        calls.append(fraction)
        raise KeyError(fraction)

    calls: list[float] = []
    scene = Scene(cloth=Cloth(rows=5, columns=6), solver=Solver("verlet", substeps=4, iterations=2))
    with Simulation(scene, "serial") as whole, Simulation(scene, "serial") as interrupted:
        for _ in range(2):
            whole.step()
            with pytest.raises(KeyError):
                interrupted.step_by_substep(fail)
        assert calls == [0.25, 0.25]
        assert interrupted.frame == whole.frame == 2
        assert np.array_equal(interrupted.positions(), whole.positions())


def test_a_callback_cannot_start_another_frame() -> None:
    with Simulation(Scene(cloth=Cloth(rows=5, columns=6)), "serial") as simulation:
        for nested in (simulation.step, lambda: simulation.step_by_substep(print)):
            with pytest.raises(UsageError, match="a callback of step_by_substep may only read"):
                simulation.step_by_substep(lambda _, nested=nested: nested())
        assert simulation.frame == 2
        simulation.step()
        assert simulation.frame == 3


def test_a_callback_that_closes_the_simulation_leaves_it_closed() -> None:
    with Simulation(Scene(cloth=Cloth(rows=5, columns=6)), "serial") as simulation:
        for run in (lambda: simulation.step_by_substep(lambda _: simulation.close()), simulation.step):
            with pytest.raises(RuntimeError, match="this simulation is closed"):
                run()
