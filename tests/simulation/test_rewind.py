"""Return to states of the last seconds, and before changes that can be undone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.simulation import rollback
from taichi_cloth.simulation.rollback import REWIND_EVERY, RewindBuffer
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.usefixtures("serial_layout")

FRAME = 1 / 60  # [s]


@pytest.fixture
def simulation() -> Iterator[Simulation]:
    with Simulation(load_scene("drape15", rows=6, columns=7)) as simulation:
        yield simulation


def run(simulation: Simulation, rewind: RewindBuffer, frames: int) -> None:
    for _ in range(frames):
        simulation.step()
        rewind.add()


def test_it_goes_back_to_the_nearest_state_and_on_with_the_same_bits(simulation: Simulation) -> None:
    rewind = RewindBuffer(simulation)
    run(simulation, rewind, 10 * REWIND_EVERY)
    end = simulation.positions()
    rewind.go_back(3.4 * REWIND_EVERY * FRAME)
    assert simulation.frame == 7 * REWIND_EVERY
    assert rewind.back == pytest.approx(3 * REWIND_EVERY * FRAME)
    rewind.go_back(0.0)  # and forward
    np.testing.assert_array_equal(simulation.positions(), end)
    rewind.go_back(rewind.seconds)
    assert simulation.frame == 0
    run(simulation, rewind, 10 * REWIND_EVERY)
    np.testing.assert_array_equal(simulation.positions(), end)


def test_the_states_after_the_present_one_are_dropped_when_the_cloth_moves_on(simulation: Simulation) -> None:
    rewind = RewindBuffer(simulation)
    run(simulation, rewind, 4 * REWIND_EVERY)
    rewind.go_back(2 * REWIND_EVERY * FRAME)
    run(simulation, rewind, REWIND_EVERY)
    assert rewind.back == 0
    assert rewind.seconds == pytest.approx(3 * REWIND_EVERY * FRAME)
    assert simulation.frame == 3 * REWIND_EVERY


def test_undo_restores_the_state_before_each_change_the_last_first(simulation: Simulation) -> None:
    rewind, pins = RewindBuffer(simulation), simulation.topology.pinned.copy()
    assert not rewind.undo()
    run(simulation, rewind, 9)
    before = simulation.positions()
    rewind.mark()
    simulation.pin(30)
    run(simulation, rewind, 20)
    grab = simulation.grab(40)
    rewind.mark()
    grab.move_to((0.5, 1.0, 0.5))
    run(simulation, rewind, 20)
    assert rewind.undo()
    assert (simulation.frame, simulation.grabs) == (29, {})
    assert simulation.topology.pinned[30]
    assert rewind.undo()
    np.testing.assert_array_equal(simulation.positions(), before)
    np.testing.assert_array_equal(simulation.topology.pinned, pins)
    assert not rewind.undo()
    run(simulation, rewind, REWIND_EVERY)
    assert not rewind.undo()


def test_undo_after_going_back_undoes_what_came_before(simulation: Simulation) -> None:
    rewind = RewindBuffer(simulation)
    run(simulation, rewind, 12)
    rewind.mark()
    simulation.pin(30)
    run(simulation, rewind, 12)
    rewind.mark()
    simulation.pin(31)
    run(simulation, rewind, 12)
    rewind.go_back(18 * FRAME)  # between the two pins
    assert simulation.topology.pinned[[30, 31]].tolist() == [True, False]
    assert rewind.undo()
    assert simulation.frame == 12
    assert not simulation.topology.pinned[30]


def test_time_and_memory_are_limited(simulation: Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    rewind = RewindBuffer(simulation)
    monkeypatch.setattr(rollback, "REWIND_SECONDS", 1.0)
    rewind.mark()
    run(simulation, rewind, 90)
    assert rewind.seconds == pytest.approx(1.0)
    assert len(rewind._states) == 1 + 60 // REWIND_EVERY + 1  # the mark, and those of the last second
    rewind.go_back(5.0)
    assert simulation.frame == 30  # not that of the mark
    assert rewind.back == pytest.approx(1.0)
    rewind.go_back(0.0)
    assert rewind.undo()  # however long ago
    assert simulation.frame == 0
    assert not rewind.undo()
    run(simulation, rewind, 90)
    monkeypatch.setattr(rollback, "REWIND_BYTES", 3 * rewind._states[-1].size)
    run(simulation, rewind, REWIND_EVERY)
    assert len(rewind._states) == 3
    monkeypatch.setattr(rollback, "REWIND_BYTES", 0)
    run(simulation, rewind, REWIND_EVERY)
    assert len(rewind._states) == 1  # the present one


@pytest.mark.parametrize("frames", [0, 1])
def test_another_solver_clears_it(simulation: Simulation, frames: int) -> None:
    """Also while the cloth is frozen."""
    rewind = RewindBuffer(simulation)
    run(simulation, rewind, 30)
    rewind.mark()
    simulation.switch_solver("xpbd")
    run(simulation, rewind, frames)
    assert not rewind.undo()
    rewind.go_back(0.5)
    assert simulation.solver.name == "xpbd"
    assert simulation.frame == 30 + frames
    assert rewind.seconds < 2 * FRAME
