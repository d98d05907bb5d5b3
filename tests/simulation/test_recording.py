"""Recordings: events written to a file, read and replayed give the same bits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import taichi_cloth as tc
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene import Scene, SceneError, scene_to_toml
from taichi_cloth.scene.collider_schema import Sphere
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Maps, Solver, Tearing, Wind
from taichi_cloth.simulation.events import Event, GrabHandle
from taichi_cloth.simulation.recording import LONG, Recorder, Recording, differences, hash_of, read_recording
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import UsageError
from taichi_cloth.viewer.replay import ReplaySession

pytestmark = pytest.mark.usefixtures("serial_layout")

SMALL = Scene(
    name="small",
    cloth=Cloth(rows=4, columns=5, width=1.0, height=0.8, center=(0.0, 2.0, 0.0)),
    solver=Solver(substeps=3, iterations=4),
    wind=Wind(z=2.0),
    spheres=(Sphere(center=(0.0, 1.7, 0.2), radius=0.2, margin=0.15, friction=0.0),),
)
SIZE = (96, 54)
LAST = 19  # particle


@pytest.fixture
def simulation() -> Iterator[Simulation]:
    with Simulation(SMALL) as simulation:
        yield simulation


@pytest.fixture
def recorder(simulation: Simulation) -> Recorder:
    return Recorder(simulation)


def run(simulation: Simulation, frames: int) -> None:
    for _ in range(frames):
        simulation.step()


def check_replay(recorder: Recorder, path: Path) -> ReplaySession:
    """Save the recording, replay it, and check that the positions are equal. Return the closed session."""
    recorder.save(path, SIZE)
    session = replay(path)
    assert session.is_equal
    return session


def replay(path: Path) -> ReplaySession:
    with closing(ReplaySession(read_recording(path))) as session:
        while not session.is_over:
            session.replay_frame()
    return session


def make_all_changes(simulation: Simulation, other: str) -> None:
    """Make every kind of change, one after another."""
    run(simulation, 3)
    simulation.params["gravity"] = 4.1
    position = simulation.positions()[LAST]
    first = simulation.grab(LAST)
    for k in range(4):
        first.move_to(position + [0.01 * k, 0.0, 0.03 * k])
        run(simulation, 1)
    simulation.params["wind"] = False
    simulation.switch_solver(other)
    run(simulation, 2)
    first.release()
    second = simulation.grab(7)
    second.move_to((0.1, 1.9, 0.3))
    run(simulation, 1)
    simulation.params["substeps"] = 5
    second.release()
    simulation.params["wind"] = True
    simulation.params["sphere_radius"] = 0.4
    run(simulation, 3)
    simulation.reset()
    run(simulation, 1)
    simulation.set_state(simulation.positions() + 0.1, (0.0, 1.0, 0.0))
    run(simulation, 2)


@pytest.mark.parametrize("other", ["xpbd", "lines"])
def test_all_changes_are_replayed_bit_for_bit(recorder: Recorder, tmp_path: Path, other: str) -> None:
    simulation = recorder.simulation
    make_all_changes(simulation, other)
    check_replay(recorder, tmp_path / "all.toml")
    recorder.restart()  # with the other solver
    make_all_changes(simulation, "verlet")
    make_all_changes(simulation, other)
    check_replay(recorder, tmp_path / "middle.toml")


@pytest.mark.parametrize("solver", ["xpbd", "implicit"])
def test_penetration_free_contact_repeats_its_bits_from_a_checkpoint(solver: str, tmp_path: Path) -> None:
    """The list of pairs is not part of a checkpoint, and its order changes the last bits of a contact."""
    with Simulation(load_scene("towel", rows=14, columns=21, solver=solver)) as simulation:
        whole = Recorder(simulation)
        run(simulation, 60)
        begun = Recorder(simulation)
        simulation.save(tmp_path / "a.npz")
        run(simulation, 110)  # it is folded over
        expected = simulation.positions()
        assert simulation.penetration_free_since == 0
        whole.save(tmp_path / "whole.toml", SIZE)
        begun.save(tmp_path / "begun.toml", SIZE)
        simulation.load(tmp_path / "a.npz")
        run(simulation, 110)
        assert (simulation.positions() == expected).all()
    for name in ("whole", "begun"):
        assert replay(tmp_path / f"{name}.toml").is_equal


@pytest.mark.parametrize("solver", ["xpbd", "verlet"])
def test_self_collision_repeats_its_bits_from_a_checkpoint(solver: str, tmp_path: Path) -> None:
    """In a cloth that is wrung the candidate pairs are listed anew only every few frames."""
    with Simulation(load_scene("twist", solver=solver), "simd") as simulation:
        run(simulation, 240)
        begun = Recorder(simulation)
        simulation.save(tmp_path / "a.npz")
        run(simulation, 30)
        expected = simulation.positions()
        begun.save(tmp_path / "begun.toml", SIZE)
        simulation.load(tmp_path / "a.npz")
        run(simulation, 30)
        assert (simulation.positions() == expected).all()
    assert replay(tmp_path / "begun.toml").is_equal


def test_a_state_with_its_frame_is_replayed(recorder: Recorder, tmp_path: Path) -> None:
    recorder.simulation.set_state(recorder.simulation.positions() + 0.1, frame=40)
    run(recorder.simulation, 2)
    assert recorder.simulation.frame == 42
    check_replay(recorder, tmp_path / "state.toml")


def test_pins_fabrics_patches_and_features_are_replayed(recorder: Recorder, tmp_path: Path) -> None:
    simulation = recorder.simulation
    run(simulation, 2)
    simulation.pin(12)
    patch = simulation.grab(LAST, radius=0.3)
    patch.move_to((0.4, 1.7, 0.3))
    other = simulation.grab(5)
    other.move_to((0.0, 1.9, 0.3))
    assert len(patch.particles) > 1
    run(simulation, 2)
    simulation.switch_solver("xpbd")
    simulation.switch_fabric("denim")
    simulation.switch_scene(replace(simulation.scene, wind=None))
    run(simulation, 1)
    patch.move_to((0.4, 1.8, 0.3))
    other.move_to((0.0, 1.9, 0.4))
    simulation.unpin(12)
    run(simulation, 2)
    check_replay(recorder, tmp_path / "changes.toml")
    recorder.restart()
    patch.release()
    run(simulation, 1)
    other.release()
    run(simulation, 2)
    check_replay(recorder, tmp_path / "after.toml")


def test_pins_that_reset_removes_are_no_longer_drawn(recorder: Recorder, tmp_path: Path) -> None:
    simulation = recorder.simulation
    run(simulation, 1)
    simulation.pin(12)
    run(simulation, 1)
    simulation.reset()
    recorder.save(tmp_path / "pins.toml", SIZE)
    with closing(ReplaySession(read_recording(tmp_path / "pins.toml"))) as session:
        drawn = []
        while not session.is_over:
            session.replay_frame()
            drawn.append(session.draw_list.pins.tolist())
        assert drawn == [[12], []]


def test_tearing_is_replayed_from_a_restart(tmp_path: Path) -> None:
    cloth = Cloth(rows=6, columns=7, width=0.8, height=0.7, pins=("left", "right"), area_density=6.0)
    fabric = Fabric(warp=300.0, weft=300.0, shear=100.0, bend_spring=1.0)
    scene = Scene(cloth=cloth, fabric=fabric, solver=Solver("xpbd", 10), tearing=Tearing(0.1))
    with Simulation(scene) as simulation:
        recorder = Recorder(simulation)
        run(simulation, 30)
        recorder.restart()
        assert simulation.torn.any()
        simulation.pin(16)
        run(simulation, 2)
        simulation.switch_solver("verlet")
        run(simulation, 2)
        again = check_replay(recorder, tmp_path / "torn.toml").simulation
        np.testing.assert_array_equal(again.torn, simulation.torn)
        simulation.reset()
        run(simulation, 2)
        check_replay(recorder, tmp_path / "restored.toml")


def test_mesh_and_map_files_of_the_user_are_found_from_the_folder_of_the_recording(tmp_path: Path) -> None:
    (tmp_path / "flap.obj").write_text("v 0 0 0\nv 2 0 0\nv 2 0 1\nv 0 0 1\nf 4 3 2 1\n")
    (tmp_path / "half.csv").write_text("1\n1\n0\n0.2\n")
    (tmp_path / "flap.toml").write_text('[cloth]\nfile = "flap.obj"\npins = [0]\n[maps]\npin = "half.csv"\n')
    (tmp_path / "out").mkdir()
    with Simulation(load_scene(tmp_path / "flap.toml")) as simulation:
        recorder = Recorder(simulation)
        run(simulation, 2)
        check_replay(recorder, tmp_path / "out" / "flap.toml")
    np.save(tmp_path / "half.npy", np.linspace(0, 1, 20))
    with Simulation(replace(SMALL, maps=Maps(pin="half.npy", folder=str(tmp_path)))) as simulation:
        recorder = Recorder(simulation)
        run(simulation, 2)
        check_replay(recorder, tmp_path / "out" / "map.toml")


def test_a_recording_may_begin_during_a_drag(recorder: Recorder, tmp_path: Path) -> None:
    simulation = recorder.simulation
    simulation.params["gravity"] = 3.0
    grab = simulation.grab(LAST)
    grab.move_to((0.3, 1.5, 0.3))
    run(simulation, 2)
    simulation.params["sphere_radius"] = 0.45  # it grows around particles: they are pushed out slowly
    recorder.restart()
    assert recorder.first_frame == 2
    grab.move_to((0.3, 1.5, 0.35))
    run(simulation, 2)
    grab.release()
    run(simulation, 2)
    session = check_replay(recorder, tmp_path / "middle.toml")
    assert session.frames_replayed == 4


def test_the_replayed_frames_can_be_gone_back_to(tmp_path: Path) -> None:
    """The recording begins late, with other values than the scene; during replay nothing goes back."""
    with Simulation(SMALL) as simulation:
        run(simulation, 30)
        simulation.params["iterations"] = 3
        recorder = Recorder(simulation)
        run(simulation, 24)
        recorder.save(tmp_path / "late.toml")
    with closing(ReplaySession(read_recording(tmp_path / "late.toml"))) as session:
        session.advance(12)
        session.on_key_held("rewind", 0.1)
        assert session.simulation.frame == 42
        session.advance(12)
        end = session.simulation.positions()
        assert session.is_equal
        session.go_back(0.2)
        assert (session.simulation.frame, session.simulation.params["iterations"]) == (42, 3)
        session.go_back(5.0)
        assert (session.simulation.frame, session.simulation.params["iterations"]) == (30, 3)
        session.go_back(0.0)
        assert (session.simulation.positions() == end).all()


def test_grabs_that_are_active_at_the_end_of_a_recording_are_released(recorder: Recorder, tmp_path: Path) -> None:
    simulation = recorder.simulation
    patch = simulation.grab(LAST, radius=0.3)
    simulation.grab(5)
    for k in range(3):
        patch.move_to(simulation.topology.start[LAST] + [0.0, 0.0, 0.05 * k])
        run(simulation, 1)
    recorder.save(tmp_path / "drag.toml", SIZE)
    with closing(ReplaySession(read_recording(tmp_path / "drag.toml"))) as session:
        session.simulate(2)
        np.testing.assert_array_equal(session.simulation.grabbed, simulation.grabbed)
        session.simulate(1)
        assert session.is_equal
        assert len(session.simulation.grabbed) == 0
        for grab in simulation.grab_handles:
            grab.release()
        for running in (session.simulation, simulation):
            run(running, 5)
        np.testing.assert_array_equal(session.simulation.positions(), simulation.positions())
        check_replay(session.recorder, tmp_path / "again.toml")


def test_a_loaded_checkpoint_is_in_the_recording(recorder: Recorder, tmp_path: Path) -> None:
    simulation = recorder.simulation
    run(simulation, 3)
    simulation.save(tmp_path / "save.npz")
    run(simulation, 2)
    simulation.load(tmp_path / "save.npz")
    (tmp_path / "save.npz").unlink()
    run(simulation, 1)
    check_replay(recorder, tmp_path / "loaded.toml")


@pytest.mark.parametrize(
    "change",
    [
        lambda simulation: simulation.step(9),
        lambda simulation: simulation.params.update(wind_z=6.0),
        lambda simulation: simulation.pin(7),
        lambda simulation: simulation.grab(7).move_to((0.1, 1.0, 0.3)),
        lambda simulation: simulation.set_state(simulation.positions() + 0.1),
        lambda simulation: simulation.switch_solver("xpbd"),
    ],
    ids=["frames", "parameter", "pin", "grab", "state", "solver"],
)
def test_a_recording_of_a_simulation_that_has_changed_begins_with_its_state(
    simulation: Simulation, tmp_path: Path, change: Callable[[Simulation], object]
) -> None:
    change(simulation)
    late = Recorder(simulation)
    run(simulation, 6)
    check_replay(late, tmp_path / "late.toml")


@pytest.mark.parametrize("change", [{"wind": None}, {"solver": Solver("xpbd", 7, 3, damping=0.2)}])
def test_a_recording_that_begins_after_a_switch_returns_to_the_settings_of_the_opened_scene(
    simulation: Simulation, tmp_path: Path, change: dict[str, Any]
) -> None:
    simulation.switch_fabric("denim")
    simulation.switch_scene(replace(simulation.scene, **change))
    run(simulation, 2)
    late = Recorder(simulation)
    assert [event.name for _, event in late.rows] == ["switch_scene", "load"]
    simulation.switch_fabric("")
    run(simulation, 3)
    simulation.switch_solver(SMALL.solver.name)
    assert simulation.params["substeps"] == SMALL.solver.substeps
    run(simulation, 3)
    late.save(tmp_path / "late.toml", SIZE)
    replayed = tc.replay(tmp_path / "late.toml")
    np.testing.assert_array_equal(replayed.positions(), simulation.positions())
    replayed.close()


def test_files_of_a_scene_that_is_switched_to_are_found_in_its_folder(tmp_path: Path) -> None:
    (tmp_path / "half.csv").write_text("0\n" * 10 + "1\n" * 10)
    opened = tmp_path / "opened"
    opened.mkdir()
    (opened / "half.csv").write_text("1\n" * 10 + "0\n" * 10)
    own = Maps(pin="half.csv", folder=str(opened))
    for scene in (SMALL, replace(SMALL, maps=own)):
        with Simulation(scene) as simulation:
            recorder = Recorder(simulation)
            run(simulation, 1)
            simulation.switch_scene(replace(SMALL, maps=Maps(pin="half.csv", folder=str(tmp_path))))
            assert simulation.topology.pinned[LAST]
            run(simulation, 2)
            check_replay(recorder, tmp_path / "switched.toml")
            recorder.restart()
            run(simulation, 2)
            check_replay(recorder, tmp_path / "late.toml")


def test_a_recorded_switch_without_a_folder_takes_that_of_the_running_scene(tmp_path: Path) -> None:
    """Recordings of earlier versions have none."""
    (tmp_path / "half.csv").write_text("0\n" * 10 + "1\n" * 10)
    mapped = replace(SMALL, maps=Maps(pin="half.csv", folder=str(tmp_path)))
    with Simulation(mapped) as simulation:
        recorder = Recorder(simulation)
        simulation.apply(Event("switch_scene", (scene_to_toml(replace(mapped, wind=None)),)))
        run(simulation, 1)
        check_replay(recorder, tmp_path / "old.toml")
        for arguments in ((), ("", "", "")):
            with pytest.raises(ValueError, match="switch_scene needs 1 arguments"):
                simulation.apply(Event("switch_scene", arguments))


def test_arguments_of_numpy_and_integers_for_floats_are_recorded_as_toml(recorder: Recorder, tmp_path: Path) -> None:
    simulation = recorder.simulation
    x = simulation.positions()
    for event in (
        Event("set_param", (np.str_("wind_z"), np.float64(6))),
        Event("set_param", ("iterations", np.int64(5))),
        Event("set_param", ("wind", np.True_)),
        Event("set_state", (x, [np.float32(0), 1, 0])),
        Event("grab", (np.int32(LAST), 0, np.uint8(1))),
        Event("move_grab", (np.int64(1), 0, np.float32(1.5), np.array(0.5))),
        Event("pin_within", (7, 1, np.False_)),
    ):
        simulation.apply(event)
        run(simulation, 1)
    check_replay(recorder, tmp_path / "numbers.toml")


@pytest.mark.parametrize(
    ("name", "arguments", "refusal"),
    [
        ("move_grab", (0.0, 0.0, 1.0, 0.0), "argument 1 of event move_grab must be int, not 0.0"),
        ("move_grab", (0, 0.0, True, 0.0), "argument 3 of event move_grab must be float, not true"),
        ("release", (False,), "argument 1 of event release must be int, not false"),
        ("pin", (7, 1), "argument 2 of event pin must be bool, not 1"),
        ("load", (b"abc",), "argument 1 of event load must be str, not b'abc'"),
    ],
)
def test_arguments_that_no_recording_can_have_are_refused(
    recorder: Recorder, name: str, arguments: tuple[object, ...], refusal: str
) -> None:
    recorder.simulation.grab(LAST)
    with pytest.raises(ValueError, match=f"^{refusal}$"):
        recorder.simulation.apply(Event(name, arguments))
    assert len(recorder.rows) == 1


def test_a_recording_of_a_simulation_at_its_start_has_no_checkpoint(recorder: Recorder) -> None:
    assert recorder.rows == []


def test_a_change_of_the_last_bit_of_an_argument_is_detected(recorder: Recorder) -> None:
    recorder.simulation.grab(LAST).move_to((0.3, 1.5, 0.3))
    run(recorder.simulation, 2)
    good = Recording.of(recorder, SIZE)
    grab, (frame, move) = good.rows
    number, x, *rest = move.arguments
    changed = Event(move.name, (number, float(np.nextafter(np.float32(x), np.float32(1))), *rest))
    other = replace(good, rows=(grab, (frame, changed)))
    for recording, is_equal in ((good, True), (other, False)):
        with closing(ReplaySession(recording)) as session:
            session.replay_frame()
            assert not session.is_over
            session.replay_frame()
            assert session.is_equal is is_equal
            assert ("DIFFER" in session.verdict) is not is_equal


def test_a_reset_replays_again(recorder: Recorder) -> None:
    """Also after a change of the solver by the recording, and within it."""
    recorder.simulation.grab(LAST).move_to((0.3, 1.5, 0.3))
    run(recorder.simulation, 2)
    recorder.simulation.switch_solver("xpbd")
    run(recorder.simulation, 2)
    with closing(ReplaySession(Recording.of(recorder, SIZE))) as session:
        for frames in (4, 3, 4):
            session.advance(frames)
            assert session.frames_replayed == frames
            assert session.is_over is (frames == 4)
            session.request("reset")
            session.run_deferred()
            assert (session.frames_replayed, session.simulation.frame, session.frozen) == (0, 0, False)
            assert session.simulation.solver.name == SMALL.solver.name
        session.advance(4)
        assert session.is_equal
        assert session.note == "4 frames replayed: final positions are bit-identical; R replays again"


def test_a_replay_keeps_no_diverged_state_to_go_back_to(recorder: Recorder) -> None:
    run(recorder.simulation, 30)
    with closing(ReplaySession(Recording.of(recorder, SIZE))) as session:
        session.advance(11)
        session.simulation.cloth.x[LAST] = [np.nan] * 3
        session.advance(1)  # the twelfth frame, which would be kept
        session.frozen = False
        session.advance(18)
        for seconds in np.linspace(0.0, 0.5, 9):
            session.rewind_buffer.go_back(seconds)
            assert np.isfinite(session.simulation.positions()).all()


def test_a_failed_switch_of_the_solver_is_replayed(tmp_path: Path) -> None:
    """A failed switch has read the cloth from its fields and written it back."""
    light = replace(
        SMALL,
        fabric=replace(SMALL.fabric, warp=1e9, weft=1e9),
        cloth=replace(SMALL.cloth, width=0.2, height=0.16, area_density=0.001),
    )
    with Simulation(light) as simulation:
        recorder = Recorder(simulation)
        run(simulation, 2)
        with pytest.raises(UsageError, match="explicit needs"):
            simulation.switch_solver("explicit")
        run(simulation, 2)
        assert recorder.rows == [(2, Event("switch_solver", ("explicit",)))]
        check_replay(recorder, tmp_path / "refused.toml")


numbers = st.floats(-0.3, 0.3)
actions = st.one_of(
    st.just(("step",)),
    st.just(("reset",)),
    st.just(("release",)),
    st.tuples(st.just("set"), st.just("wind"), st.booleans()),
    st.tuples(st.just("set"), st.sampled_from(["gravity", "stiffness"]), st.floats(0.1, 1.0)),
    st.tuples(st.just("set"), st.just("sphere_radius"), st.floats(0.1, 0.4)),
    st.tuples(st.just("set"), st.sampled_from(["substeps", "iterations"]), st.integers(1, 6)),
    st.tuples(st.just("switch_solver"), st.sampled_from(["verlet", "xpbd"])),
    st.tuples(st.just("grab"), st.integers(0, LAST), st.tuples(numbers, numbers.map(lambda y: 2 + y), numbers)),
    st.just(("restart",)),
)


def apply_action(recorder: Recorder, name: str, *arguments: Any) -> None:
    """Carry out one of `actions`. A grab of another particle releases the one before."""
    simulation = recorder.simulation
    match name:
        case "set":
            simulation.params[arguments[0]] = arguments[1]
        case "restart":
            recorder.restart()
        case "release":
            for number in list(simulation.grabs):
                GrabHandle(simulation, number).release()
        case "grab":
            particle, target = arguments
            if simulation.grabbed.tolist() != [particle]:
                apply_action(recorder, "release")
                simulation.grab(particle)
            GrabHandle(simulation, 0).move_to(target)
            simulation.step()
        case _:
            getattr(simulation, name)(*arguments)


@given(st.lists(actions, max_size=25))
@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_sequence_of_changes_is_replayed_bit_for_bit(tmp_path: Path, calls: list[tuple[Any, ...]]) -> None:
    with Simulation(SMALL) as simulation:
        recorder = Recorder(simulation)
        for name, *arguments in calls:
            apply_action(recorder, name, *arguments)
        check_replay(recorder, tmp_path / "drawn.toml")


# -- what is recorded --------------------------------------------------------------------------------------------


def test_only_the_last_target_of_a_grab_between_two_frames_is_recorded(recorder: Recorder) -> None:
    simulation = recorder.simulation
    first = simulation.grab(3)
    for target in ((0.0, 1.0, 0.0), (0.0, 1.0, 0.1), (0.0, 1.0, 0.2)):
        first.move_to(target)
    second = simulation.grab(4)
    second.move_to((0.0, 1.0, 0.2))
    simulation.step()
    second.move_to((0.0, 1.0, 0.3))
    assert recorder.rows == [
        (0, Event("grab", (3, 0.0, 0))),
        (0, Event("move_grab", (0, 0.0, 1.0, 0.2))),
        (0, Event("grab", (4, 0.0, 1))),
        (0, Event("move_grab", (1, 0.0, 1.0, 0.2))),
        (1, Event("move_grab", (1, 0.0, 1.0, 0.3))),
    ]


def test_a_change_that_raised_is_not_recorded(recorder: Recorder) -> None:
    simulation = recorder.simulation
    for wrong in (lambda: simulation.params.update({"gravity": 1e9}), lambda: simulation.grab(99)):
        with pytest.raises(ValueError, match=r"range|must be in"):
            wrong()
    assert recorder.rows == []


def test_a_second_release_is_not_recorded(recorder: Recorder) -> None:
    grab = recorder.simulation.grab(3)
    grab.release()
    rows = list(recorder.rows)
    grab.release()
    assert recorder.rows == rows


def test_a_view_is_recorded_when_it_changes(recorder: Recorder) -> None:
    for view in ("shaded", "shaded", "strain", "strain"):
        recorder.record_view("view", view)
    assert [event.arguments for _, event in recorder.rows] == [("shaded",), ("strain",)]


def test_a_recording_of_many_frames_and_events_is_long(recorder: Recorder) -> None:
    recorder.simulation.frames_stepped += LONG
    assert not recorder.is_long
    recorder.simulation.reset()
    assert recorder.is_long


# -- the file ------------------------------------------------------------------------------------------------


def test_a_file_has_all_parameters_at_the_end(recorder: Recorder, tmp_path: Path) -> None:
    simulation = recorder.simulation
    simulation.params["gravity"] = 1 / 3
    run(simulation, 2)
    recorder.save(tmp_path / "a.toml", SIZE)
    again = read_recording(tmp_path / "a.toml")
    assert again == replace(Recording.of(recorder, SIZE), settings={})
    assert again.scene == SMALL
    assert again.positions_sha256 == hash_of(simulation)
    assert "gravity = 0.3333333333333333\n" in (tmp_path / "a.toml").read_text()
    assert differences(again) == []
    other = replace(again, created_with={**again.created_with, "taichi": "1.0", "python": "2.7"})
    [line] = differences(other)
    assert line.startswith("recorded with taichi 1.0, replayed with ")


@pytest.mark.parametrize("source", ["file", "dict", "python"])
def test_files_given_by_relative_paths_are_found_after_a_change_of_folder(
    source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in the window, which works in a temporary folder."""
    for name in ("here", "elsewhere"):
        (tmp_path / name).mkdir()
    (tmp_path / "here" / "flag.obj").write_text("v 0 0 0\nv 2 0 0\nv 2 0 1\nv 0 0 1\nf 4 3 2 1\n")
    (tmp_path / "here" / "half.csv").write_text("1\n1\n0\n0.2\n")
    keys = '[cloth]\nfile = "flag.obj"\npins = [0]\n[maps]\npin = "half.csv"\n[solver]\nsubsteps = 2\n'
    (tmp_path / "here" / "own.toml").write_text(keys)
    monkeypatch.chdir(tmp_path if source == "file" else tmp_path / "here")
    scene: Scene | dict[str, Any] = {
        "file": lambda: load_scene("here/own.toml"),
        "dict": lambda: {"cloth": {"file": "./flag.obj", "pins": [0]}, "maps": {"pin": "half.csv"}},
        "python": lambda: Scene(cloth=Cloth(file="flag.obj", pins=(0,)), maps=Maps(pin="half.csv")),
    }[source]()
    with Simulation(scene) as simulation:
        recorder = Recorder(simulation)
        monkeypatch.chdir(tmp_path / "elsewhere")
        assert Path(Recording.of(recorder, SIZE).folder) == tmp_path / "here"
        simulation.pin(1)
        simulation.switch_solver("explicit")
        run(simulation, 1)
        check_replay(recorder, tmp_path / "own.toml")


def test_a_mesh_of_the_user_is_found_from_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from taichi_cloth.scene.presets import asset_folder

    monkeypatch.chdir(tmp_path)
    Path("here").mkdir()
    mesh = min((asset_folder() / "meshes").glob("*.obj"), key=lambda path: path.stat().st_size)
    Path("here/own.obj").write_bytes(mesh.read_bytes())
    Path("here/own.toml").write_text(
        '[cloth]\nrows = 4\ncolumns = 4\n[[meshes]]\nfile = "./own.obj"\ncenter = [0.0, 0.0, 0.0]\n'
    )
    scene = load_scene("here/own.toml")
    in_python = Scene(cloth=Cloth(file="here/own.obj"))  # in the working folder
    for name, one in (("a", scene), ("b", in_python)):
        Recording(one, None, SIZE, 0, 0, (), "", {}).write(tmp_path / f"{name}.toml")
    Path("elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    [found] = read_recording(tmp_path / "a.toml").scene.meshes
    assert Path(found.folder, found.file).samefile(tmp_path / "here" / "own.obj")
    cloth = read_recording(tmp_path / "b.toml").scene.cloth
    assert Path(cloth.folder, cloth.file).samefile(tmp_path / "here" / "own.obj")
    assert Recording(load_scene("hammock"), None, SIZE, 0, 0, (), "", {}).folder == ""


@pytest.fixture(scope="module")
def good(taichi: None, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A recording with every kind of row."""
    path = tmp_path_factory.mktemp("good") / "good.toml"
    with Simulation(SMALL) as simulation:
        recorder = Recorder(simulation)
        run(simulation, 1)
        recorder.restart()
        make_all_changes(simulation, "xpbd")
        recorder.record_view("view", "strain")
        recorder.record_view("camera", 0.1, 0.2, 3.0, 0.0, 1.0, 0.0)
        recorder.save(path, SIZE)
    return path.read_text()


Change = tuple[str, str]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[recording]", "[recordings]"), "not a recording: it has no [recording]"),
        (("format = 3", "format = 4"), "recording.format is 4, and this program reads 3"),
        (("format = 3\n", ""), "format must be int, not missing"),
        (("frames = 16", "frames = -1"), "recording.frames must be from 0"),
        (("frames = 16", "frames = 1" + "0" * 30), "recording.frames must be from 0"),
        (("frames = 16", "frames = 5"), "comes after 6 frames, which is not in 5..5"),
        (("size = [96, 54]", "size = [96, 0]"), "recording.size must be two numbers"),
        (("[events]", "[event]"), "events must be dict, not missing"),
        (('"release"', '"relase"'), "is not a frame, one of set_param, "),
        (('"release", 0]', '"release"]'), "invalid arguments of release: []"),
        (('[3, "grab", 19,', '[3, "grab", 1.5,'), "invalid arguments of grab"),
        (('[3, "grab", 19,', '[3, "grab", true,'), "invalid arguments of grab"),
        (('"switch_solver", "xpbd"', '"switch_solver", "magic"'), "unknown solver 'magic': verlet"),
        (("0.1, 0.2, 3.0", "nan, 0.2, 3.0"), "invalid arguments of camera"),
        (("0.1, 0.2, 3.0", "1e300, 0.2, 3.0"), "invalid arguments of camera"),
        (("rows = 4", "rows = -4"), "scene: cloth.rows"),
        (("[scene.cloth]", "[scene.clothes]"), "did you mean 'cloth'"),
        (("[scene]", "[[["), "not a recording: "),
        # detected during replay
        (('[3, "grab", 19,', '[3, "grab", 20,'), "grab: particle index must be in 0..19, not 20"),
        (('"gravity", 4.1', '"gravity", 1e8'), "set_param: gravity: 1"),
        (('"gravity", 4.1', '"gravitas", 4.1'), "set_param: 'gravitas' is not a parameter"),
        (('"view", "strain"', '"view", "stain"'), "view: unknown view 'stain'"),
        (("0.1, 0.2, 3.0", "0.1, 0.2, -3.0"), "camera: distance must be greater than 0 m"),
        (('"load", "UEs', '"load", "%'), "load: "),
        (('"load", "UEs', '"load", "AAAA'), "load: "),
        (('"set_state", [[', '"set_state", [[1.0], ['), "set_state: positions must be numbers of shape (20, 3)"),
        (("seed = 0", "seed = 1"), "load: checkpoint: a checkpoint of another scene: it has 'seed = 0"),
        (('layout = ""', 'layout = "roundabout"'), "roundabout"),
    ],
)
def test_an_invalid_recording_is_one_line(good: str, tmp_path: Path, change: Change, message: str) -> None:
    before, after = change
    assert before in good
    path = tmp_path / "bad.toml"
    path.write_text(good.replace(before, after, 1))
    with pytest.raises((UsageError, SceneError)) as caught:
        replay(path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_event_that_fails_in_python_is_named_with_file_and_row(good: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(good.replace('[3, "grab", 19,', '[3, "grab", 20,', 1))
    with pytest.raises(UsageError, match=r"bad\.toml: rows\[\d+\]: grab: particle index must be in 0\.\.19, not 20$"):
        tc.replay(path)


def test_the_valid_file_is_replayed(good: str, tmp_path: Path) -> None:
    (tmp_path / "good.toml").write_text(good)
    assert replay(tmp_path / "good.toml").is_equal


@pytest.mark.parametrize(
    "make",
    [
        lambda path: None,
        lambda path: path.mkdir(),
        lambda path: path.write_bytes(b"\xff\xfe\x00"),
        lambda path: path.write_text("a = " + "[" * 100_000),
        lambda path: path.write_text("cloth.rows = 3"),
        lambda path: path.write_text("recording = 7"),
    ],
)
def test_files_that_are_not_recordings_are_refused(tmp_path: Path, make: Callable[[Path], object]) -> None:
    path = tmp_path / "bad.toml"
    make(path)
    with pytest.raises(UsageError, match=r"bad\.toml(: cannot be read|: not a rec| is a folder, not a rec)"):
        read_recording(path)


@given(st.data())
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damaged_files_are_read_or_refused_in_one_line(good: str, tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(good.encode())
    offsets = st.integers(0, len(content) - 1)
    for offset in data.draw(st.lists(offsets, max_size=3), "flipped"):
        content[offset] ^= 1 << data.draw(st.integers(0, 7))
    start, end = sorted((data.draw(offsets, "from"), data.draw(offsets, "to")))
    match data.draw(st.sampled_from(["flipped", "cut", "doubled"])):
        case "cut":
            del content[start:end]
        case "doubled":
            content[start:start] = content[start:end]
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    try:
        read_recording(path)
    except (UsageError, SceneError) as error:
        assert "bad.toml" in str(error)


def test_a_recording_has_the_size_of_an_image_or_is_not_written(recorder: Recorder, tmp_path: Path) -> None:
    recorder.save(tmp_path / "numpy.toml", size=np.array([640, 360]))
    assert read_recording(tmp_path / "numpy.toml").size == (640, 360)
    for size in ((640.0, 360.0), (3,), (0, 10), (10, 8193), "ab", None, (True, "1")):
        with pytest.raises(ValueError, match="size must be width and height, 1 to 8192 pixels each"):
            recorder.save(tmp_path / "wrong.toml", size=size)
    assert not (tmp_path / "wrong.toml").exists()


@pytest.mark.parametrize("name", ["run", "run.npz", "run.mp4"])
def test_a_recording_is_a_toml_file(recorder: Recorder, tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match=r"run.*: recordings are saved as TOML files: the name must end in \.toml"):
        recorder.save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []
