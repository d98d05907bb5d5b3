"""A cloth that is through itself is let go where it is."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from taichi_cloth.scene.model import Cloth, Fabric, Forces, Scene, SelfCollision, Solver
from taichi_cloth.simulation import Simulation

Floats = NDArray[np.float64]
SHEET = Scene(
    cloth=Cloth(rows=2, columns=6, width=5.0, height=1.0, pins=("left", "right")),
    fabric=Fabric(warp=1e3, weft=1e3, shear=1e3, bend=0.0, compression=0.0),
    solver=Solver("xpbd", substeps=10, iterations=2, damping=4.0),
    forces=Forces(gravity=0.0),
    self_collision=SelfCollision(thickness=0.9, untangle=True),
)
# Columns 3 to 5: number, share of their height, and where [m].
BENT = ((3, 1.0, (2.4, 0.0, 0.8)), (4, 0.6, (1.6, 0.0, 0.6)), (5, 0.6, (1.5, 0.0, -0.4)))


def bent(simulation: Simulation) -> Floats:
    """The strip bent back, with its end through its own second cell [m], (12, 3)."""
    x = simulation.topology.flat.reshape(2, 6, 3).copy()
    x[..., 0] -= x[0, 0, 0]
    x[:, 3], x[:, 4], x[:, 5] = (x[:, k] * [0, y, 0] + at for k, y, at in BENT)
    return x.reshape(-1, 3)


@pytest.mark.parametrize("path", ["list", "lanes", pytest.param("gather", marks=pytest.mark.long)])
def test_what_is_marked_is_what_crosses(path: str) -> None:
    with Simulation(SHEET, path) as simulation:
        simulation.place(bent(simulation))
        simulation.advance_frame()
        near = simulation.solver.work.near
        marked = near.through.to_numpy()[near.particle.to_numpy()[:12]]
        assert np.flatnonzero(marked).tolist() == [1, 2, 4, 5, 7, 8, 10, 11]


def crossings_left() -> tuple[int, int]:
    """Of a ribbon between its pins that begins as a loop through itself: after a frame, and after three seconds."""
    cloth = replace(SHEET.cloth, rows=4, columns=25, width=12.0, height=1.5, center=(6.0, 0.0, 0.0))
    scene = replace(SHEET, cloth=cloth, self_collision=SelfCollision(thickness=0.45, untangle=True))
    with Simulation(scene, "list") as simulation:
        x = simulation.topology.start.copy()
        turn = 2 * np.pi * x[:, 0] / 12.0
        x += np.stack([2.6 * np.sin(turn), 0 * turn, 2.6 * (1 - np.cos(turn))], axis=1)
        simulation.place(x)
        simulation.advance_frame()
        first = simulation.crossings()
        for _ in range(180):
            simulation.advance_frame()
        return first, simulation.crossings()


def test_a_tangle_opens() -> None:
    first, last = crossings_left()
    assert first > 3
    assert last == 0


def test_contact_lets_go_of_what_is_through() -> None:
    """Without springs only contact moves the strip's end, which is nearer to the cell that it is through than 0.9 m."""
    moved = {}
    for untangle in (True, False):
        fabric = replace(SHEET.fabric, warp=0.0, weft=0.0, shear=0.0)
        scene = replace(SHEET, fabric=fabric, self_collision=SelfCollision(0.9, untangle=untangle))
        with Simulation(scene, "list") as simulation:
            x = bent(simulation)
            simulation.place(x)
            simulation.advance_frame()
            moved[untangle] = np.abs(simulation.positions() - x)[[1, 2, 7, 8, 10]].max()
    assert moved[False] > 1e-3
    assert moved[True] < 1e-6


def test_what_is_not_through_is_kept_apart_as_ever() -> None:
    ends = []
    for untangle in (False, True):
        cloth = replace(SHEET.cloth, pins=())
        scene = replace(SHEET, cloth=cloth, self_collision=SelfCollision(0.9, untangle=untangle))
        with Simulation(scene, "lanes") as one:  # where sums keep their order, whatever else is compiled
            x = one.topology.flat.copy()
            x[[5, 11]] = x[[0, 6]] + [0.0, 0.0, 0.5]
            one.place(x)
            for _ in range(10):
                one.advance_frame()
            ends.append(one.positions())
    assert np.array_equal(*ends)
