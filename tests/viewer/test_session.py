"""The actions of keys and mouse, without a display."""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import taichi as ti
from pointing import ASPECT, PARTICLE, ReadyPipe, cursor_on, grab, grabbed, point

from taichi_cloth.cli.output_commands import save_running_scene
from taichi_cloth.geometry.mesh_reader import read_obj
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.render.camera import OrbitCamera
from taichi_cloth.render.colors import distance_scale, rounded_up
from taichi_cloth.scene import scene_names
from taichi_cloth.scene.fabric_schema import PRESET_NAMES
from taichi_cloth.scene.schema import SOLVER_NAMES, Tearing
from taichi_cloth.simulation.copies import Copy, FrameError, FrameErrorMeter, FrameStart
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import UsageError
from taichi_cloth.viewer.capture import Capture
from taichi_cloth.viewer.charts import statistics
from taichi_cloth.viewer.error_process import Answer, ErrorProcess, error_lines
from taichi_cloth.viewer.input import HELD_KEY_RATES, REWIND_RATES, SHORTCUTS
from taichi_cloth.viewer.session import Session
from taichi_cloth.viewer.toolkit import Refusal

pytestmark = pytest.mark.usefixtures("serial_layout")


def test_a_frozen_cloth_moves_only_by_steps(session: Session) -> None:
    session.advance(2)
    session.act("freeze")
    session.advance(5)
    assert session.simulation.frame == 2
    session.act("step")
    assert session.simulation.frame == 3
    session.act("freeze")
    session.act("step")  # also freezes
    assert session.frozen
    assert session.simulation.frame == 4


def test_reset_keeps_runtime_parameters(session: Session) -> None:
    session.simulation.params["gravity"] = 3.0
    session.advance(3)
    session.act("reset")
    assert session.simulation.frame == 0
    assert session.simulation.params["gravity"] == 3.0


@pytest.fixture
def three_scenes(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Replace the shipped scenes by three of them, since each takes seconds to compile."""
    names = ["curtain", "drape15", "fold"]
    monkeypatch.setattr("taichi_cloth.viewer.session.scene_names", lambda: names)
    return names


def test_scenes_cycle_and_each_has_its_camera(session: Session, three_scenes: list[str]) -> None:
    seen = []
    for _ in three_scenes:
        scene = session.simulation.scene
        seen.append(scene.name)
        assert session.camera.eye == pytest.approx(OrbitCamera.from_scene(scene).eye)
        session.act("next_scene")
    assert seen == three_scenes
    assert session.simulation.scene.name == "curtain"
    session.act("previous_scene")
    assert session.simulation.scene.name == seen[-1]


def test_the_initial_scene_is_part_of_the_cycle() -> None:
    own = replace(load_scene("table"), name="my_own")
    session = Session(own)
    session.act("next_scene")
    assert session.simulation.scene.name == scene_names()[0]
    session.act("previous_scene")
    assert session.simulation.scene is own
    session.close()


def test_cycling_through_scenes_allocates_no_more_fields(session: Session, three_scenes: list[str]) -> None:
    def fields() -> int:
        return int(ti.lang.impl.get_runtime().prog.get_snode_tree_size())

    for _ in three_scenes:
        session.act("next_scene")
    before = fields()
    for _ in range(66 * len(three_scenes) + 2):
        session.act("next_scene")
    assert fields() == before


def test_a_diverged_cloth_is_frozen_at_its_last_stable_frame_with_a_note(session: Session) -> None:
    session.advance(3)
    stable = session.simulation.positions()
    grab(session)
    session.simulation.params["gravity"] = 20.0
    session.simulation.cloth.x[0] = (np.nan, 0.0, 0.0)
    session.advance(2)
    assert session.frozen
    assert session.note == "the cloth blew up in frame 4: gravity is 20 m/s², the scene's value is 9.81"
    assert grabbed(session) is None
    assert session.simulation.frame == 3
    assert (session.simulation.positions() == stable).all()
    assert session.measure().finite
    session.act("freeze")  # and it continues
    session.advance(2)
    assert (session.frozen, session.note, session.simulation.frame) == (False, "", 5)


def test_an_export_writes_a_new_file_to_the_initial_folder(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    out = Path("out").resolve()
    monkeypatch.chdir("/")  # the window changes the folder, too
    for name in ("curtain/mesh_001.obj", "curtain/mesh_002.obj"):
        session.act("export")
        assert session.note == f"wrote out/{name}"
        points, faces = read_obj(out / name)
        assert points == pytest.approx(session.simulation.positions(), rel=1e-6, abs=1e-9)
        assert (faces == session.simulation.topology.triangles).all()
        session.advance(2)
    assert sorted(path.name for path in (out / "curtain").iterdir()) == ["mesh_001.obj", "mesh_002.obj"]


def test_a_failed_export_is_reported(session: Session) -> None:
    Path("out").write_text("a file")
    session.act("export")
    assert session.note.startswith("cannot write the mesh: ")
    assert "Not a directory" in session.note
    assert isinstance(session.note, Refusal)
    session.advance(1)
    assert session.simulation.frame == 1


def test_a_scene_is_saved_with_the_values_of_its_sliders(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    session.act("save_scene")
    assert session.note == "no scenes are saved here"
    session.save = save_running_scene
    out = Path("out").resolve()
    monkeypatch.chdir("/")  # the window changes the folder, too
    session.simulation.params["gravity"] = 3.0
    session.simulation.params["sphere_radius"] = 0.4
    session.change_solver("lines")
    session.set_features({"spheres": True, "ground": False})
    for number in (1, 2):
        session.act("save_scene")
        assert (session.note, type(session.note)) == (f"wrote out/curtain/scene_00{number}.toml", str)
    saved = load_scene(out / "curtain" / "scene_001.toml")
    assert (saved.forces.gravity, saved.spheres[0].radius, saved.solver.name) == (3.0, 0.4, "lines")
    assert saved.ground is None
    assert saved.cloth == session.simulation.scene.cloth
    session.capture = Capture(out / "curtain" / "scene_001.toml")  # a file
    session.act("save_scene")
    assert session.note.startswith("cannot save the scene: ")
    assert isinstance(session.note, Refusal)


def test_every_key_has_an_action(session: Session, tmp_path: Path) -> None:
    session.capture = Capture(tmp_path)
    for key in SHORTCUTS:
        session.on_key_held(key.action, 0.1) if key.held else session.act(key.action)
    assert {key.action for key in SHORTCUTS if key.held} == {*HELD_KEY_RATES, *REWIND_RATES}
    assert (session.page, session.running) == ("Sliders", True)  # Esc has closed the help
    with pytest.raises(ValueError, match="dance"):
        session.act("dance")


@pytest.mark.parametrize(("page", "hidden", "quits"), [
    ("Sliders", False, True), ("Menu", False, False), ("Solvers", False, False), ("Solvers", True, True),
    ("Help", False, False), ("Help", True, False),
])  # fmt: skip
def test_escape_closes_help_or_page_and_quits_from_the_sliders(
    session: Session, page: str, hidden: bool, quits: bool
) -> None:
    session.page, session.hidden = page, hidden
    session.request("quit")
    assert session.running is not quits
    if not quits:
        assert session.page == "Sliders"
        session.request("quit")
        assert not session.running


def test_a_held_camera_key_moves_equally_at_any_frame_rate(session: Session) -> None:
    other = OrbitCamera.from_scene(session.simulation.scene)
    session.on_key_held("zoom_in", 1.0)
    fast, session.camera = session.camera, other
    for _ in range(100):
        session.on_key_held("zoom_in", 0.01)
    assert session.camera.distance == pytest.approx(fast.distance)


def test_the_solver_can_change_while_the_cloth_moves_and_is_grabbed() -> None:
    with closing(Session(load_scene("curtain"), "serial")) as session:  # compiles in half the time of the simd layout
        cursor = grab(session)
        session.advance(20)
        for name in (*SOLVER_NAMES[1:], SOLVER_NAMES[0]):
            before, velocities = session.simulation.positions(), session.simulation.velocities()
            session.act("solver")
            assert session.simulation.solver.name == session.simulation.scene.solver.name == name
            assert (session.simulation.positions() == before).all()  # nothing jumps
            assert session.simulation.velocities() == pytest.approx(velocities, abs=1e-2)
            assert grabbed(session) == PARTICLE
            point(session, cursor, "left")
            session.advance(3)
            assert session.measure().finite
            assert session.measure().max_strain < 0.6
        point(session, (0.3, 0.3))
        assert grabbed(session) is None


def test_an_unsupported_solver_is_skipped_with_a_note() -> None:
    light = load_scene("curtain", warp=1e9, weft=1e9, width=0.4, area_density=0.001)
    session = Session(light)
    assert session.simulation.solver.name == "verlet"
    session.act("solver")
    assert (session.simulation.solver.name, session.note) == ("xpbd", "")
    session.act("solver")
    assert session.simulation.solver.name == "lines"  # explicit is between them
    assert "curtain: explicit needs" in session.note
    session.advance(1)
    assert session.simulation.metrics().finite
    session.close()


# -- grab radius, pins, fabrics and features -------------------------------------------------------------------------


def test_fabrics_cycle(session: Session) -> None:
    own, seen = session.simulation.scene.fabric, []
    for _ in range(len(PRESET_NAMES) + 1):
        before = session.simulation.positions()
        session.act("fabric")
        assert (session.simulation.positions() == before).all()
        seen.append(session.simulation.scene.fabric.preset)
    assert seen == [*PRESET_NAMES, ""]
    assert session.simulation.scene.fabric == own


def test_an_unsupported_fabric_is_skipped_with_a_note(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    switch = session.simulation.switch_fabric

    def refuse(name: str) -> None:
        if name == PRESET_NAMES[0]:
            raise UsageError(f"{name} is not supported")
        switch(name)

    monkeypatch.setattr(session.simulation, "switch_fabric", refuse)
    session.act("fabric")
    assert (session.fabric, session.note) == (PRESET_NAMES[1], f"{PRESET_NAMES[0]} is not supported")
    session.act("fabric")
    assert (session.fabric, session.note) == (PRESET_NAMES[2], "")


def test_features_are_switched_off_one_by_one_and_all_on_again(session: Session) -> None:
    assert list(session.features) == ["spheres", "ground"]
    notes = []
    for _ in range(3):
        session.act("feature")
        notes.append((session.note, [name for name, on in session.features.items() if not on]))
        session.advance(1)
    assert notes == [
        ("without spheres until it is checked in Features", ["spheres"]),
        ("without ground until it is checked in Features", ["ground"]),
        ("", []),
    ]
    assert session.simulation.scene == load_scene("curtain")


def test_a_feature_that_the_fabric_does_not_support_stays_off_with_a_note(tmp_path: Path) -> None:
    with closing(Session(replace(load_scene("curtain"), tearing=Tearing()), out=tmp_path)) as session:
        session.set_features({"tearing": False})
        session.act("fabric")  # one with bending stiffness
        session.set_features({"tearing": True})
        assert session.note.startswith("curtain: tearing: does not support bending stiffness")
        assert not session.features["tearing"]
        session.advance(1)
        assert session.measure().finite


def test_cycling_through_pins_fabrics_and_features_allocates_no_more_fields(session: Session) -> None:
    def fields() -> int:
        return int(ti.lang.impl.get_runtime().prog.get_snode_tree_size())

    def round_trip() -> None:
        for action in [*["fabric"] * (len(PRESET_NAMES) + 1), *["feature"] * 3, "pin", "pin"]:
            session.act(action)
            session.advance(1)

    point(session, cursor_on(session, PARTICLE))
    round_trip()
    before = fields()
    for _ in range(2):
        round_trip()
    assert fields() == before


def test_the_history_has_the_measurements(session: Session) -> None:
    for _ in range(4):
        session.advance(1)
        session.measure()
    assert session.history.rows[:, 0] == pytest.approx(np.arange(5) / 60)
    assert session.history.rows[-1, 1] == session.metrics.kinetic_energy
    assert session.measuring_ms > 0
    session.act("reset")
    session.advance(1)
    session.measure()
    assert len(session.history.rows) == 1


def test_actions_that_compile_are_deferred_until_their_note_was_displayed(
    session: Session, three_scenes: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    session.request("next_scene")
    session.request("freeze")
    assert session.frozen
    assert session.simulation.scene.name == "curtain"
    session.request("next_scene")  # only the last is opened
    session.request("solver")  # it would be for the scene that is closed
    assert session.note == "fold: compiling; the first time, the display pauses for some seconds"
    opened = []
    monkeypatch.setattr(session, "_open", lambda scene, do=session._open: (opened.append(scene.name), do(scene)))
    session.run_deferred()
    assert opened == ["fold"]
    assert (session.simulation.scene.name, session.simulation.solver.name) == ("fold", "verlet")
    assert session.note == ""
    session.run_deferred()
    assert session.simulation.scene.name == "fold"


def test_a_key_pressed_twice_moves_on_from_what_is_waiting(session: Session) -> None:
    session.request("solver")
    assert session.note.startswith("xpbd: compiling")
    session.request("solver")
    session.request("fabric")
    session.run_deferred()
    assert (session.simulation.solver.name, session.fabric) == ("explicit", PRESET_NAMES[0])


def test_a_name_of_a_list_is_chosen(session: Session) -> None:
    session.choose("view", "strain")
    session.choose("solver", "lines")
    session.choose("fabric", "")
    assert (session.view, session.simulation.solver.name) == ("strain", "verlet")
    assert session.note.startswith("own fabric: compiling")
    session.run_deferred()
    assert session.simulation.solver.name == "lines"


def test_a_name_that_is_refused_is_not_replaced_by_another() -> None:
    with closing(Session(load_scene("curtain", warp=1e9, weft=1e9, width=0.4, area_density=0.001))) as session:
        session.choose("solver", "explicit")
        session.run_deferred()
        assert session.simulation.solver.name == "verlet"
        assert "curtain: explicit needs" in session.note
        assert isinstance(session.note, Refusal)


def test_feature_times_are_measured_on_copies(session: Session) -> None:
    session.simulation.params["wind_z"] = 7.0
    session.advance(3)
    grab(session)
    before = session.simulation.positions(), session.simulation.velocities(), len(session.recorder.rows)
    session.request("time_features")
    assert session.note.startswith("feature times: compiling")
    session.run_deferred()
    times = session.feature_times
    assert times is not None
    assert set(times.cost_ms) == {*session.features, "wind"}
    assert times.frame == session.simulation.frame == 3
    assert times.ms > max(times.cost_ms.values())
    assert grabbed(session) == PARTICLE
    np.testing.assert_array_equal(session.simulation.positions(), before[0])
    np.testing.assert_array_equal(session.simulation.velocities(), before[1])
    assert len(session.recorder.rows) == before[2]
    session.act("solver")
    assert session.feature_times is None


def test_errors_of_frames_are_measured_until_they_are_switched_off(
    session: Session, three_scenes: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    measured: list[str] = []

    def run_frame(self: ErrorProcess, simulation: Simulation) -> None:
        measured.append(simulation.scene.name)
        simulation.step()

    monkeypatch.setattr(ErrorProcess, "run_frame", run_frame)
    session.request("errors")
    session.advance(2)
    session.act("next_scene")
    session.advance(1)
    assert measured == [three_scenes[0], three_scenes[0], three_scenes[1]]
    session.act("errors")
    assert session.meter is None
    session.advance(1)
    assert len(measured) == 3
    assert session.simulation.frame == 2


def test_a_copy_has_the_state_of_the_running_cloth(session: Session) -> None:
    running = session.simulation
    running.params["wind_z"] = 7.0
    running.pin(PARTICLE)
    running.unpin(0)
    session.advance(5)
    with Copy(running.scene) as copy:
        copy.start_from(FrameStart.of(running))
        for one in (copy, running):
            one.step()
        np.testing.assert_allclose(copy.positions(), running.positions(), atol=1e-6)
        assert (copy.frame, copy.params["wind_z"]) == (6, 7.0)
        np.testing.assert_array_equal(copy.topology.pinned, running.topology.pinned)


def test_switching_features_is_deferred(session: Session) -> None:
    session.request_features({**session.features, "ground": False})
    assert "ground" in session.simulation.features
    assert session.note.startswith("features: compiling")
    session.run_deferred()
    assert "ground" not in session.simulation.features


def test_a_pull_and_a_pin_can_be_undone(session: Session) -> None:
    session.advance(3)
    point(session, cursor_on(session, PARTICLE), "left")
    for k in range(5):
        point(session, (0.5 + 0.02 * k, 0.5), "left")
        session.advance(1)
    point(session, (0.6, 0.5))
    session.advance(4)
    session.request("undo")
    assert (session.simulation.frame, session.frozen) == (3, True)
    session.act("freeze")
    session.pin(PARTICLE)
    assert session.simulation.added_pins.tolist() == [PARTICLE]
    session.advance(2)
    session.act("undo")
    assert session.simulation.added_pins.tolist() == []
    session.act("undo")
    assert session.note.startswith("nothing to undo: no grab or pin since the start")
    assert isinstance(session.note, Refusal)
    assert session.recorder.frames == 0  # a replay begins here


def test_holding_a_key_goes_back_in_time_and_forward_again(session: Session) -> None:
    session.advance(60)
    end = session.simulation.positions()
    for _ in range(3):
        session.on_key_held("rewind", 0.1)
    assert session.frozen
    assert session.simulation.frame == 42
    for _ in range(5):
        session.on_key_held("forward", 0.1)
    np.testing.assert_array_equal(session.simulation.positions(), end)
    for _ in range(50):  # displayed frames of 10 ms, a tenth of the distance of two stored states
        session.on_key_held("rewind", 0.01)
    assert session.simulation.frame == 30
    for _ in range(60):
        session.on_key_held("forward", 0.01)
    np.testing.assert_array_equal(session.simulation.positions(), end)
    session.act("clip")
    session.on_key_held("rewind", 0.5)
    assert session.simulation.frame == 60
    assert session.note.startswith("cannot go back in time while recording a clip")
    session.capture.clip_is_on = False


def test_the_view_error_shows_what_was_measured(session: Session) -> None:
    session.view = "error"
    session.draw_list.update("error", session.camera.eye)
    assert session.draw_list.scale("error") is None
    with closing(FrameErrorMeter(session.simulation.scene)) as meter:
        found = meter.measure_frame(session.simulation)
    session.act("errors")
    assert session.meter is not None
    session.meter._scene, session.meter.answer = session.simulation.scene, Answer(found)
    session.frozen = True
    session.advance(1)
    scale = session.draw_list.scale("error")
    assert scale is not None
    largest = max(found.by_particle)
    assert scale.labels == distance_scale(rounded_up(largest)).labels
    session.draw_list.update("error", session.camera.eye)
    color = session.draw_list.mesh.color.to_numpy()[session.draw_list.mesh.cloth_from : session.draw_list.mesh.corners]
    corners = session.simulation.topology.triangles.reshape(-1)
    redness = color[:, 0] - color[:, 2]
    worst, least = found.by_particle[corners].argmax(), found.by_particle[corners].argmin()
    assert redness[worst] > redness[least] + 0.2


def test_the_cloth_is_framed_where_it_is(session: Session) -> None:
    session.simulation.set_state(session.simulation.positions() + [20.0, 0.0, 0.0])
    session.act("first_view")
    uv, _ = session.camera.to_screen(session.simulation.positions(), ASPECT)
    assert ((uv >= 0) & (uv <= 1)).all()
    session.act("reset")
    session.act("first_view")
    assert session.camera.eye == pytest.approx(OrbitCamera.from_scene(session.simulation.scene).eye)


def test_a_state_that_diverged_is_not_kept_to_go_back_to(session: Session) -> None:
    session.advance(11)
    cloth = session.simulation.cloth
    cloth.x[100] = [np.nan] * 3
    session.advance(1)  # the twelfth frame, which would be kept
    assert session.note.startswith("the cloth blew up")
    for key in 5 * ["rewind"] + 9 * ["forward"]:
        session.on_key_held(key, 0.1)
        assert np.isfinite(session.simulation.positions()).all()


def test_another_setting_shows_no_error_of_the_one_before(session: Session) -> None:
    session.act("errors")
    session.advance(1)
    assert session.meter is not None
    found = FrameError(1, 0.1, 0.1, 0.0, None, 0.1, np.ones(720), 0.1)
    session.view, session.meter.answer = "error", Answer(found)
    session.advance(1)
    assert session.draw_list.error_frame == 1
    scale = session.draw_list.scale("error")
    assert scale is not None
    assert scale.caption == "frame 1"
    session.act("wind")  # its switch is a parameter too
    assert session.frame_error is None
    session.meter.answer = Answer(found)
    session.simulation.params["iterations"] = 3
    assert session.frame_error is None
    session.advance(1)
    assert (session.draw_list.errors, session.draw_list.error_frame) == (None, None)
    assert session.draw_list.scale("error") is None


def test_an_error_that_arrives_while_the_cloth_is_frozen_is_shown(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    session.act("errors")
    assert session.meter is not None
    session.frozen = True
    session.advance(1)
    assert error_lines(session.meter) == ["error of a frame: not measured yet"]
    line = "error of a frame: not measured yet; frozen: N runs a frame"
    assert error_lines(session.meter, frozen=True) == [line]
    session.meter._is_busy, session.meter._is_stale = True, False
    assert "frozen" not in error_lines(session.meter, frozen=True)[0]
    session.meter._sent = time.perf_counter() - 12.1
    assert error_lines(session.meter) == ["error of a frame: being measured (12 s)"]
    session.meter.forget()
    assert error_lines(session.meter) == [
        "error of a frame: not measured yet: busy with a frame before the change (12 s)"
    ]
    session.meter._is_stale = False
    found = FrameError(1, 0.1, 0.1, 0.0, None, 0.1, np.ones(720), 0.1)
    monkeypatch.setattr(session.meter, "_pipe", ReadyPipe(Answer(found)))
    session.advance(1)
    assert session.frame_error is found
    assert error_lines(session.meter)[0].startswith("error of frame 1: ")
    assert list(session.meter.recent) == [0.1]
    session.meter._pipe = None
    session.change_solver("xpbd")
    assert not session.meter.recent  # errors of another setting


def test_a_scene_that_the_layout_does_not_support_is_refused_and_the_next_follows() -> None:
    with closing(Session(load_scene("drape15"), layout="simd")) as session:
        session.choose("scene", "round")
        session.run_deferred()
        assert session.simulation.scene.name == "drape15"
        assert isinstance(session.note, Refusal)
        assert session.note.startswith("layout simd is not supported: ")
        session.advance(1)
        assert session.simulation.frame == 1


def test_a_hidden_panel_hides_no_note(session: Session) -> None:
    session.act("hide")
    assert session.caption == []
    session.act("undo")
    assert session.caption == [session.note]
    assert session.note.startswith("nothing to undo")


def test_the_error_before_a_change_is_shown_until_the_next_is_measured(session: Session) -> None:
    session.act("errors")
    session.advance(1)
    assert session.meter is not None
    session.meter.answer = Answer(FrameError(1, 2e-3, 0.1, 0.0, None, 2e-3, np.ones(720), 0.1))
    for change in (lambda: session.simulation.params.update(iterations=3), lambda: session.change_solver("xpbd")):
        change()
        session.advance(1)
        assert error_lines(session.meter) == ["error of a frame: not measured yet; before the change: 2 mm"]
    session.frozen = True
    session.open_scene("drape15")
    session.advance(1)
    assert error_lines(session.meter) == ["error of a frame: not measured yet"]


def test_a_frozen_cloth_goes_back_to_no_state_with_another_feature(session: Session) -> None:
    session.advance(30)
    session.pin(PARTICLE)
    session.act("freeze")
    session.set_features({"spheres": False})
    frame = session.simulation.frame
    session.act("undo")
    assert session.note.startswith("nothing to undo")
    session.go_back(0.3)
    assert session.simulation.frame == frame
    assert not session.features["spheres"]


def test_undo_says_how_to_go_on_and_the_panel_that_the_cloth_is_frozen(session: Session) -> None:
    session.pin(PARTICLE)
    session.advance(3)
    session.act("undo")
    assert (session.note, type(session.note)) == ("undone; Space continues", str)
    session.pin(PARTICLE)
    session.simulation.params["gravity"] = 5.0
    session.act("undo")
    assert session.note == "undone, and slider changes since; Space continues"
    assert statistics(session, {"drawing": 1.0}, 60.0).splitlines()[1] == "frame 0 · frozen"
    session.act("freeze")
    assert session.note == ""
    assert statistics(session, {"drawing": 1.0}, 60.0).splitlines()[1] == "frame 0 · 60 fps"
    session.act("clip")
    session.pin(PARTICLE)  # its note takes the place of that of the clip
    assert statistics(session, {"drawing": 1.0}, 60.0).splitlines()[1] == "frame 0 · 60 fps · recording a clip"


@pytest.mark.parametrize("change", ["solver", "fabric", "next_scene", "reset", "undo"])
def test_a_frozen_cloth_that_has_changed_shows_no_time_and_error_of_the_one_before(
    session: Session, three_scenes: list[str], change: str
) -> None:
    """The scenes have other numbers of particles. A frozen scene runs no frame, so nothing new is measured."""
    session.act("errors")
    session.pin(PARTICLE)  # can be undone
    session.advance(1)  # compiles
    assert session.physics_ms == 0.0
    session.advance(1)
    assert session.meter is not None
    found = FrameError(1, 0.1, 0.1, 0.0, None, 0.1, np.ones(720), 0.1)
    session.meter.answer = Answer(found)
    session.view, session.frozen = "error", True
    session.advance(1)
    assert session.draw_list.errors is found.by_particle
    assert session.physics_ms > 0
    session.act(change)
    session.advance(1)
    assert session.draw_list.errors is None
    lines = statistics(session, {"drawing": 1.0}, 60.0).splitlines()
    assert any(line.startswith("error of a frame: not measured yet") for line in lines)
    assert "physics - ms of 16.7 ms" in lines
    session.draw_list.update("error", session.camera.eye)
