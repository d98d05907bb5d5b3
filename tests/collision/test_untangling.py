"""Untangling: contact is released where a cloth intersects itself."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Forces, Scene, SelfCollision, Solver
from taichi_cloth.simulation.simulation import Simulation

Floats = NDArray[np.float64]
SHEET = Scene(
    cloth=Cloth(rows=2, columns=6, width=5.0, height=1.0, pins=("left", "right")),
    fabric=Fabric(warp=1e3, weft=1e3, shear=1e3, bend_spring=0.0, compression=0.0),
    solver=Solver("xpbd", substeps=10, iterations=2, damping=4.0),
    forces=Forces(gravity=0.0),
    self_collision=SelfCollision(thickness=0.9, untangle=True),
)
# Columns 3 to 5: number, share of their height, and where [m].
BENT = ((3, 1.0, (2.4, 0.0, 0.8)), (4, 0.6, (1.6, 0.0, 0.6)), (5, 0.6, (1.5, 0.0, -0.4)))


def bent(simulation: Simulation) -> Floats:
    """Return the strip bent back, with its end through its own second cell [m], (12, 3)."""
    x = simulation.topology.flat.reshape(2, 6, 3).copy()
    x[..., 0] -= x[0, 0, 0]
    x[:, 3], x[:, 4], x[:, 5] = (x[:, k] * [0, y, 0] + at for k, y, at in BENT)
    return x.reshape(-1, 3)


@pytest.mark.parametrize("layout", ["serial", "simd", pytest.param("parallel", marks=pytest.mark.long)])
def test_particles_of_intersections_are_marked(layout: str) -> None:
    with Simulation(SHEET, layout) as simulation:
        simulation.set_state(bent(simulation))
        simulation.step()
        data = simulation.solver.layout.self_contact
        assert data is not None
        marked = data.is_intersecting.to_numpy()[data.particle.to_numpy()[:12]]
        assert np.flatnonzero(marked).tolist() == [1, 2, 4, 5, 7, 8, 10, 11]


def remaining_intersections() -> tuple[int, int]:
    """Return the intersections of a ribbon that starts as a loop through itself, after one frame and after 181."""
    cloth = replace(SHEET.cloth, rows=4, columns=25, width=12.0, height=1.5, center=(6.0, 0.0, 0.0))
    scene = replace(SHEET, cloth=cloth, self_collision=SelfCollision(thickness=0.45, untangle=True))
    with Simulation(scene, "serial") as simulation:
        x = simulation.topology.start.copy()
        turn = 2 * np.pi * x[:, 0] / 12.0
        x += np.stack([2.6 * np.sin(turn), 0 * turn, 2.6 * (1 - np.cos(turn))], axis=1)
        simulation.set_state(x)
        simulation.step()
        first = simulation.intersections()
        for _ in range(180):
            simulation.step()
        return first, simulation.intersections()


def test_a_loop_through_itself_opens() -> None:
    first, last = remaining_intersections()
    assert first > 3
    assert last == 0


def test_contact_is_released_at_intersections() -> None:
    """Without springs only contact moves the end of the strip, which is within 0.9 m of the cell it passes through."""
    moved = {}
    for untangle in (True, False):
        fabric = replace(SHEET.fabric, warp=0.0, weft=0.0, shear=0.0)
        scene = replace(SHEET, fabric=fabric, self_collision=SelfCollision(0.9, untangle=untangle))
        with Simulation(scene, "serial") as simulation:
            x = bent(simulation)
            simulation.set_state(x)
            simulation.step()
            moved[untangle] = np.abs(simulation.positions() - x)[[1, 2, 7, 8, 10]].max()
    assert moved[False] > 1e-3
    assert moved[True] < 1e-6


def test_untangling_does_not_change_contact_without_intersections() -> None:
    ends = []
    for untangle in (False, True):
        cloth = replace(SHEET.cloth, pins=())
        scene = replace(SHEET, cloth=cloth, self_collision=SelfCollision(0.9, untangle=untangle))
        with Simulation(scene, "simd") as one:  # where the order of sums does not depend on what else is compiled
            x = one.topology.flat.copy()
            x[[5, 11]] = x[[0, 6]] + [0.0, 0.0, 0.5]
            one.set_state(x)
            for _ in range(10):
                one.step()
            ends.append(one.positions())
    assert np.array_equal(ends[0], ends[1])
