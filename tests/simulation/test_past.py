"""Return to states of the last seconds, and before changes that can be undone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.simulation import rollback
from taichi_cloth.simulation.rollback import PAST_EVERY, Past
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.usefixtures("serial_layout")

FRAME = 1 / 60  # [s]


@pytest.fixture
def simulation() -> Iterator[Simulation]:
    with Simulation(load_scene("drape15", rows=6, columns=7)) as simulation:
        yield simulation


def run(simulation: Simulation, past: Past, frames: int) -> None:
    for _ in range(frames):
        simulation.step()
        past.add()


def test_it_goes_back_to_the_nearest_state_and_on_with_the_same_bits(simulation: Simulation) -> None:
    past = Past(simulation)
    run(simulation, past, 10 * PAST_EVERY)
    end = simulation.positions()
    past.go_back(3.4 * PAST_EVERY * FRAME)
    assert simulation.frame == 7 * PAST_EVERY
    assert past.back == pytest.approx(3 * PAST_EVERY * FRAME)
    past.go_back(0.0)  # and forward
    np.testing.assert_array_equal(simulation.positions(), end)
    past.go_back(past.seconds)
    assert simulation.frame == 0
    run(simulation, past, 10 * PAST_EVERY)
    np.testing.assert_array_equal(simulation.positions(), end)


def test_the_states_after_the_present_one_are_dropped_when_the_cloth_moves_on(simulation: Simulation) -> None:
    past = Past(simulation)
    run(simulation, past, 4 * PAST_EVERY)
    past.go_back(2 * PAST_EVERY * FRAME)
    run(simulation, past, PAST_EVERY)
    assert past.back == 0
    assert past.seconds == pytest.approx(3 * PAST_EVERY * FRAME)
    assert simulation.frame == 3 * PAST_EVERY


def test_undo_restores_the_state_before_each_change_the_last_first(simulation: Simulation) -> None:
    past, pins = Past(simulation), simulation.topology.pinned.copy()
    assert not past.undo()
    run(simulation, past, 9)
    before = simulation.positions()
    past.mark()
    simulation.pin(30)
    run(simulation, past, 20)
    grab = simulation.grab(40)
    past.mark()
    grab.move_to((0.5, 1.0, 0.5))
    run(simulation, past, 20)
    assert past.undo()
    assert (simulation.frame, simulation.grabs) == (29, {})
    assert simulation.topology.pinned[30]
    assert past.undo()
    np.testing.assert_array_equal(simulation.positions(), before)
    np.testing.assert_array_equal(simulation.topology.pinned, pins)
    assert not past.undo()
    run(simulation, past, PAST_EVERY)
    assert not past.undo()


def test_undo_after_going_back_undoes_what_came_before(simulation: Simulation) -> None:
    past = Past(simulation)
    run(simulation, past, 12)
    past.mark()
    simulation.pin(30)
    run(simulation, past, 12)
    past.mark()
    simulation.pin(31)
    run(simulation, past, 12)
    past.go_back(18 * FRAME)  # between the two pins
    assert simulation.topology.pinned[[30, 31]].tolist() == [True, False]
    assert past.undo()
    assert simulation.frame == 12
    assert not simulation.topology.pinned[30]


def test_time_and_memory_are_limited(simulation: Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    past = Past(simulation)
    monkeypatch.setattr(rollback, "PAST_SECONDS", 1.0)
    run(simulation, past, 90)
    assert past.seconds == pytest.approx(1.0)
    monkeypatch.setattr(rollback, "PAST_BYTES", 3 * past._states[-1].size)
    run(simulation, past, PAST_EVERY)
    assert len(past._states) == 3
    assert past._size == sum(state.size for state in past._states)
    monkeypatch.setattr(rollback, "PAST_BYTES", 0)
    run(simulation, past, PAST_EVERY)
    assert len(past._states) == 1  # the present one


def test_another_solver_clears_it(simulation: Simulation) -> None:
    past = Past(simulation)
    run(simulation, past, 30)
    past.mark()
    simulation.switch_solver("xpbd")
    run(simulation, past, 1)
    assert past.seconds < 2 * FRAME
    assert not past.undo()
