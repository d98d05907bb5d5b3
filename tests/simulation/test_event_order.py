"""Changes reach every listener in their order, and none is made within a frame: recordings depend on both."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.export.clip import Simulation, replay
from taichi_cloth.scene.schema import Cloth, Scene, Solver, Wind
from taichi_cloth.simulation.events import MAX_CHANGES, Event
from taichi_cloth.simulation.recording import Recorder
from taichi_cloth.system.errors import UsageError

SCENE = Scene(
    cloth=Cloth(rows=5, columns=6, pins=("top-left", "top-right")),
    solver=Solver("verlet", substeps=4, iterations=2),
    wind=Wind(z=1.0),
)


@pytest.fixture
def simulation() -> Iterator[Simulation]:
    with Simulation(SCENE, "serial") as simulation:
        yield simulation


def replayed(recorder: Recorder, path: Path) -> np.ndarray:
    recorder.save(path)
    with replay(path) as again:
        return again.positions()


WITHIN_A_FRAME: dict[str, Callable[[Simulation, Path], object]] = {
    "set a parameter": lambda simulation, path: simulation.params.__setitem__("wind_z", 3.0),
    "grab": lambda simulation, path: simulation.grab(20),
    "move a grab": lambda simulation, path: simulation.grab_handles[0].move_to((0.0, 1.0, 0.0)),
    "release": lambda simulation, path: simulation.grab_handles[0].release(),
    "pin": lambda simulation, path: simulation.pin(20),
    "set_state": lambda simulation, path: simulation.set_state(simulation.positions()),
    "switch_solver": lambda simulation, path: simulation.switch_solver("explicit"),
    "reset": lambda simulation, path: simulation.reset(),
    "save": lambda simulation, path: simulation.save(path / "within.npz"),
    "load": lambda simulation, path: simulation.load(path / "before.npz"),
    "record": lambda simulation, path: Recorder(simulation),
}


@pytest.mark.parametrize("what", WITHIN_A_FRAME)
def test_a_callback_within_a_frame_may_only_read(simulation: Simulation, what: str, tmp_path: Path) -> None:
    recorder = Recorder(simulation)
    simulation.grab(14)
    simulation.step(2)
    simulation.save(tmp_path / "before.npz")
    with pytest.raises(UsageError, match="a callback of step_by_substep may only read"):
        simulation.step_by_substep(lambda _: WITHIN_A_FRAME[what](simulation, tmp_path))
    assert simulation.frame == 3
    assert not (tmp_path / "within.npz").exists()
    assert np.array_equal(replayed(recorder, tmp_path / "r.toml"), simulation.positions())


def test_a_recorder_neither_restarts_nor_saves_within_a_frame(simulation: Simulation, tmp_path: Path) -> None:
    recorder = Recorder(simulation)
    simulation.params["wind_z"] = 4.0
    simulation.step(2)
    for action in (recorder.restart, lambda: recorder.save(tmp_path / "within.toml")):
        with pytest.raises(UsageError, match="a callback of step_by_substep may only read"):
            simulation.step_by_substep(lambda _, action=action: action())
    assert not (tmp_path / "within.toml").exists()
    assert np.array_equal(replayed(recorder, tmp_path / "r.toml"), simulation.positions())


def test_a_listener_that_raises_keeps_no_event_from_others(simulation: Simulation, tmp_path: Path) -> None:
    def fails(event: Event) -> None:
        raise KeyError(event.name)

    simulation.listeners.append(fails)
    recorder = Recorder(simulation)
    with pytest.raises(KeyError, match="set_param"):
        simulation.params["wind_z"] = 6.0
    with pytest.raises(KeyError, match="grab"):
        simulation.grab(20)
    assert simulation.params["wind_z"] == 6.0
    assert [event.name for _, event in recorder.rows] == ["set_param", "grab"]
    simulation.step(5)
    assert np.array_equal(replayed(recorder, tmp_path / "r.toml"), simulation.positions())


def test_a_change_by_a_listener_comes_after_the_event_that_it_answers(simulation: Simulation, tmp_path: Path) -> None:
    def limits(event: Event) -> None:
        if event.name == "set_param" and event.arguments[1] > 6:
            simulation.params["wind_z"] = 6.0

    simulation.listeners.append(limits)
    recorder = Recorder(simulation)
    simulation.params["wind_z"] = 9.0
    assert [event.arguments for _, event in recorder.rows] == [("wind_z", 9.0), ("wind_z", 6.0)]
    simulation.step(5)
    assert simulation.params["wind_z"] == 6.0
    assert np.array_equal(replayed(recorder, tmp_path / "r.toml"), simulation.positions())


def test_listeners_that_answer_each_other_without_end_are_stopped(simulation: Simulation) -> None:
    calls = []

    def answers(event: Event) -> None:
        calls.append(event)
        simulation.params["wind_z"] = float(len(calls) % 2)

    simulation.listeners.append(answers)
    with pytest.raises(RuntimeError, match="without end"):
        simulation.params["wind_z"] = 3.0
    assert len(calls) == MAX_CHANGES + 1
    simulation.listeners.clear()
    simulation.params["wind_z"] = 2.0
    simulation.step()


def test_a_listener_that_goes_in_a_call_is_not_called_again(simulation: Simulation) -> None:
    names: list[str] = []

    def once(event: Event) -> None:
        names.append(event.name)
        simulation.listeners.remove(once)

    simulation.listeners += [once, lambda event: names.append(f"other {event.name}")]
    simulation.pin(20)
    simulation.unpin(20)
    assert names == ["pin", "other pin", "other pin"]


def test_an_event_with_other_arguments_is_refused_in_one_line(simulation: Simulation) -> None:
    with pytest.raises(ValueError, match=r"^event grab needs 3 arguments, got \(3,\)$"):
        simulation.apply(Event("grab", (3,)))
    assert simulation.grabs == {}


def test_the_switch_of_the_wind_has_no_range(simulation: Simulation) -> None:
    with pytest.raises(ValueError, match="'wind' is a switch, True or False: it has no range"):
        simulation.params.info("wind")
