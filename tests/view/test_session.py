"""What keys and mouse do, without a display."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import taichi as ti

from taichi_cloth.interact.camera import OrbitCamera
from taichi_cloth.interact.keys import KEYS
from taichi_cloth.interact.pointer import Owner
from taichi_cloth.mesh.obj import read_obj
from taichi_cloth.scene import load_scene, scene_names
from taichi_cloth.scene.model import PRESET_NAMES, SOLVER_NAMES, Tear
from taichi_cloth.simulation import Simulation
from taichi_cloth.view.keepsakes import Keepsakes
from taichi_cloth.view.session import HOLD, Session
from taichi_cloth.view.stage_times import take_over

pytestmark = pytest.mark.usefixtures("on_lists")

SIZE = (1280, 720)
ASPECT = SIZE[0] / SIZE[1]


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Session]:
    monkeypatch.chdir(tmp_path)  # where it exports to
    session = Session(load_scene("curtain"))
    yield session
    session.close()


def point(session: Session, cursor: tuple[float, float], *buttons: str, **more: Any) -> None:
    session.point(cursor, frozenset(buttons), SIZE, **{"on_panel": False, "widget_changed": False, **more})


def cursor_on(session: Session, particle: int) -> tuple[float, float]:
    u, v = session.camera.to_screen(session.simulation.positions()[particle], ASPECT)[0][0]
    return float(u), float(v)


PARTICLE = 18 * 30 + 26  # of the curtain, low on the right: nothing hides it at the start


def take(session: Session) -> tuple[float, float]:
    """Presses on the particle; where that is on the screen."""
    cursor = cursor_on(session, PARTICLE)
    point(session, cursor, "left")
    assert session.simulation.grabbed == PARTICLE
    return cursor


def test_a_press_takes_the_particle_under_the_cursor_and_a_release_lets_go(session: Session) -> None:
    take(session)
    point(session, (0.2, 0.2), "left")
    session.advance(1)
    assert cursor_on(session, PARTICLE) == pytest.approx((0.2, 0.2), abs=2e-3)
    point(session, (0.2, 0.2))
    assert session.simulation.grabbed is None


def test_a_slow_display_moves_the_hand_no_other_way_than_a_fast_one() -> None:
    after = []
    for pictures, frames in ((12, 1), (4, 3)):
        session = Session(load_scene("curtain"))
        u, v = take(session)
        for k in range(1, pictures + 1):
            point(session, (u + 0.1 * k / pictures, v), "left")
            session.advance(frames)
        point(session, (u + 0.1, v))
        session.advance(3)
        after.append(session.simulation.positions())
        session.close()
    assert after[0] == pytest.approx(after[1], abs=1e-4)


def test_frozen_cloth_moves_in_steps_only(session: Session) -> None:
    session.advance(2)
    session.act("freeze")
    session.advance(5)
    assert session.simulation.frame == 2
    session.act("step")
    assert session.simulation.frame == 3
    session.act("freeze")
    session.act("step")  # freezes, too
    assert session.frozen
    assert session.simulation.frame == 4


@pytest.mark.parametrize("action", ["reset", "next_scene"])
def test_the_hand_is_empty_after_a_reset_and_in_another_scene(session: Session, action: str) -> None:
    cursor = take(session)
    session.act(action)
    assert session.simulation.grabbed is None
    point(session, cursor, "left")  # the button is still down
    assert session.simulation.grabbed is None
    assert session.pointer.owner is Owner.NOTHING


def test_a_widget_that_answers_drops_the_cloth(session: Session) -> None:
    cursor = take(session)
    point(session, cursor, "left", widget_changed=True)
    assert session.simulation.grabbed is None


def test_reset_keeps_what_the_sliders_say(session: Session) -> None:
    session.simulation.set("gravity", 3.0)
    session.advance(3)
    session.act("reset")
    assert session.simulation.frame == 0
    assert session.simulation.get("gravity") == 3.0


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Three scenes for all that are shipped: each takes seconds to compile."""
    names = ["curtain", "drape15", "fold"]
    monkeypatch.setattr("taichi_cloth.view.session.scene_names", lambda: names)
    return names


def test_scenes_go_round_and_each_has_its_camera(session: Session, few: list[str]) -> None:
    seen = []
    for _ in few:
        scene = session.simulation.scene
        seen.append(scene.name)
        assert session.camera.eye == pytest.approx(OrbitCamera.from_scene(scene.camera).eye)
        session.act("next_scene")
    assert seen == few
    assert session.simulation.scene.name == "curtain"
    session.act("previous_scene")
    assert session.simulation.scene.name == seen[-1]


def test_the_users_own_scene_is_one_of_the_round() -> None:
    own = replace(load_scene("table"), name="my_own")
    session = Session(own)
    session.act("next_scene")
    assert session.simulation.scene.name == scene_names()[0]
    session.act("previous_scene")
    assert session.simulation.scene is own
    session.close()


def test_going_through_the_scenes_again_and_again_takes_no_more_fields(session: Session, few: list[str]) -> None:
    def fields() -> int:
        return int(ti.lang.impl.get_runtime().prog.get_snode_tree_size())

    for _ in few:
        session.act("next_scene")
    before = fields()
    for _ in range(66 * len(few) + 2):
        session.act("next_scene")
    assert fields() == before


def test_cloth_that_blew_up_is_frozen_on_its_last_good_frame_and_the_user_is_told(session: Session) -> None:
    session.advance(3)
    good = session.simulation.positions()
    take(session)
    session.simulation.set("gravity", 20.0)
    session.simulation.cloth.x[0] = (np.nan, 0.0, 0.0)
    session.advance(2)
    assert session.frozen
    assert session.note == "the cloth blew up in frame 4: gravity is 20 m/s², the scene's own is 9.81"
    assert session.simulation.grabbed is None
    assert session.simulation.frame == 3
    assert (session.simulation.positions() == good).all()
    assert session.measure().finite
    session.act("freeze")  # and on it goes
    session.advance(2)
    assert (session.frozen, session.note, session.simulation.frame) == (False, "", 5)


def test_an_export_is_a_new_file_where_the_session_began(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    out = Path("out").resolve()
    monkeypatch.chdir("/")  # as the window does, to another place
    for frame, name in ((0, "curtain_001.obj"), (2, "curtain_002.obj")):
        session.act("export")
        assert session.note == f"frame {frame} is in out/{name}"
        points, faces = read_obj(out / name)
        assert points == pytest.approx(session.simulation.positions(), rel=1e-6, abs=1e-9)
        assert (faces == session.simulation.topology.triangles).all()
        session.advance(2)
    assert sorted(path.name for path in out.iterdir()) == ["curtain_001.obj", "curtain_002.obj"]


def test_an_export_that_fails_is_told(session: Session) -> None:
    Path("out").write_text("a file")
    session.act("export")
    assert session.note.startswith("no mesh: ")
    assert "File exists" in session.note
    session.advance(1)
    assert session.simulation.frame == 1


def test_every_key_has_a_meaning(session: Session, tmp_path: Path) -> None:
    session.keepsakes = Keepsakes(tmp_path)
    for key in KEYS:
        session.hold(key.action, 0.1) if key.held else session.act(key.action)
    assert {key.action for key in KEYS if key.held} == set(HOLD)
    assert not session.running
    with pytest.raises(ValueError, match="dance"):
        session.act("dance")


def test_a_camera_key_held_for_a_second_goes_the_same_way_at_any_frame_rate(session: Session) -> None:
    other = OrbitCamera.from_scene(session.simulation.scene.camera)
    session.hold("zoom_in", 1.0)
    fast, session.camera = session.camera, other
    for _ in range(100):
        session.hold("zoom_in", 0.01)
    assert session.camera.distance == pytest.approx(fast.distance)


def test_the_solver_changes_while_the_cloth_moves_and_is_held() -> None:
    with closing(Session(load_scene("curtain"), "list")) as session:  # which compiles in half the time of strips
        cursor = take(session)
        session.advance(20)
        for name in (*SOLVER_NAMES[1:], SOLVER_NAMES[0]):
            before, speed = session.simulation.positions(), session.simulation.velocities()
            session.act("solver")
            assert session.simulation.solver.name == session.simulation.scene.solver.name == name
            assert (session.simulation.positions() == before).all()  # nothing jumps
            assert session.simulation.velocities() == pytest.approx(speed, abs=1e-2)
            assert session.simulation.grabbed == PARTICLE
            point(session, cursor, "left")
            session.advance(3)
            assert session.measure().finite
            assert session.measure().max_strain < 0.6
        point(session, (0.3, 0.3))
        assert session.simulation.grabbed is None


def test_a_method_that_the_scene_cannot_have_is_passed_over_and_told() -> None:
    light = load_scene("curtain", warp=1e9, weft=1e9, width=0.4, area_density=0.001)
    session = Session(light)
    assert session.simulation.solver.name == "verlet"
    session.act("solver")
    assert (session.simulation.solver.name, session.note) == ("xpbd", "")
    session.act("solver")
    assert session.simulation.solver.name == "lines"  # spring is between them
    assert "curtain: spring would take" in session.note
    session.advance(1)
    assert session.simulation.measure().finite
    session.close()


# -- the hand, pins, fabrics and stages ---------------------------------------------------------------------------


def test_the_hand_takes_a_patch_of_a_fine_cloth_and_one_particle_of_a_coarse_one(session: Session) -> None:
    take(session)
    assert len(session.simulation.held) == 1
    point(session, (0.1, 0.1))
    for _ in range(3):
        session.act("larger_hand")
    take(session)
    assert len(session.simulation.held) == 5  # 0.087 m · 1.25³, and cells of 0.15 m
    point(session, (0.1, 0.1))
    for _ in range(20):
        session.act("smaller_hand")
    assert session.radius == 0.0
    session.act("larger_hand")
    assert 0 < session.radius < session.usual_radius
    for _ in range(40):
        session.act("larger_hand")
    assert session.radius == session.largest_radius


def test_cloth_is_taken_from_behind_and_while_it_is_frozen(session: Session) -> None:
    session.act("freeze")
    front = session.camera.eye[2]
    while session.camera.eye[2] > -0.8 * front:
        session.camera.orbit(0.05, 0.0)
    cursor = cursor_on(session, PARTICLE)
    point(session, cursor, "left")
    assert session.simulation.grabbed == PARTICLE
    before = session.simulation.positions()
    point(session, (cursor[0] + 0.05, cursor[1]), "left")
    session.advance(3)
    assert (session.simulation.positions() == before).all(), "frozen cloth moved"
    session.act("step")
    assert cursor_on(session, PARTICLE) == pytest.approx((cursor[0] + 0.05, cursor[1]), abs=2e-3)


def test_p_pins_what_is_under_the_cursor_and_lets_it_go(session: Session) -> None:
    cursor = cursor_on(session, PARTICLE)
    point(session, cursor)
    session.act("pin")
    assert session.simulation.added_pins.tolist() == [PARTICLE]
    there = session.simulation.positions()[PARTICLE]
    session.advance(5)
    assert (session.simulation.positions()[PARTICLE] == there).all()
    session.act("pin")
    assert not session.simulation.topology.pinned[PARTICLE]
    point(session, cursor_on(session, 3))
    session.act("pin")
    assert not session.simulation.topology.pinned[3], "a pin of the scene's own stayed"
    session.act("reset")
    assert session.simulation.topology.pinned[3]


@pytest.mark.parametrize("on_panel", [True, False])
def test_p_beside_the_cloth_pins_nothing_and_says_so(session: Session, on_panel: bool) -> None:
    point(session, cursor_on(session, PARTICLE) if on_panel else (0.02, 0.02), on_panel=on_panel)
    session.act("pin")
    assert session.note == "no cloth under the cursor to pin"
    assert len(session.simulation.added_pins) == 0


def test_p_pins_what_the_hand_holds_where_it_is_led(session: Session) -> None:
    take(session)
    session.act("pin")
    point(session, (0.3, 0.3), "left")
    session.advance(1)
    point(session, (0.3, 0.3))
    session.advance(5)
    assert cursor_on(session, PARTICLE) == pytest.approx((0.3, 0.3), abs=2e-3)


def test_fabrics_go_round(session: Session) -> None:
    own, seen = session.simulation.scene.fabric, []
    for _ in range(len(PRESET_NAMES) + 1):
        before = session.simulation.positions()
        session.act("fabric")
        assert (session.simulation.positions() == before).all()
        seen.append(session.simulation.scene.fabric.preset)
    assert seen == [*PRESET_NAMES, ""]
    assert session.simulation.scene.fabric == own


def test_stages_go_off_one_after_another_and_all_come_back(session: Session) -> None:
    assert list(session.stages) == ["spheres", "ground"]
    notes = []
    for _ in range(3):
        session.act("stage")
        notes.append((session.note, [name for name, on in session.stages.items() if not on]))
        session.advance(1)
    assert notes == [("without spheres", ["spheres"]), ("without ground", ["ground"]), ("", [])]
    assert session.simulation.scene == load_scene("curtain")


def test_a_stage_that_does_not_go_with_the_fabric_stays_off_and_says_why(tmp_path: Path) -> None:
    with closing(Session(replace(load_scene("curtain"), tear=Tear()), out=tmp_path)) as session:
        session.switch({"tear": False})
        session.act("fabric")  # one that resists bending
        session.switch({"tear": True})
        assert session.note.startswith("curtain: tear: cannot cut what resists bending")
        assert not session.stages["tear"]
        session.advance(1)
        assert session.measure().finite


def test_going_through_pins_fabrics_and_stages_takes_no_more_fields(session: Session) -> None:
    def fields() -> int:
        return int(ti.lang.impl.get_runtime().prog.get_snode_tree_size())

    def round_trip() -> None:
        for action in [*["fabric"] * (len(PRESET_NAMES) + 1), *["stage"] * 3, "pin", "pin"]:
            session.act(action)
            session.advance(1)

    point(session, cursor_on(session, PARTICLE))
    round_trip()
    before = fields()
    for _ in range(2):
        round_trip()
    assert fields() == before


def test_curves_follow_what_was_measured(session: Session) -> None:
    for _ in range(4):
        session.advance(1)
        session.measure()
    assert session.history.rows[:, 0] == pytest.approx(np.arange(5) / 60)
    assert session.history.rows[-1, 1] == session.measures.kinetic_energy
    assert session.measuring_ms > 0
    session.act("reset")
    session.advance(1)
    session.measure()
    assert len(session.history.rows) == 1


def test_what_compiles_waits_until_its_note_was_shown(session: Session, few: list[str]) -> None:
    session.ask("next_scene")
    session.ask("freeze")
    assert session.frozen
    assert session.simulation.scene.name == "curtain"
    session.ask("next_scene")
    assert session.note == "next scene: compiling; the first time the picture stands still for some seconds"
    session.do_asked()
    assert session.simulation.scene.name == "fold"
    assert session.note == ""
    session.do_asked()
    assert session.simulation.scene.name == "fold"


def test_times_of_the_stages_are_of_copies(session: Session) -> None:
    session.simulation.set("wind_z", 7.0)
    session.advance(3)
    take(session)
    before = session.simulation.positions(), session.simulation.velocities(), len(session.simulation.take.rows)
    session.ask("time_stages")
    assert session.note.startswith("times of the stages: compiling")
    session.do_asked()
    times = session.stage_times
    assert times is not None
    assert set(times.less) == {*session.stages, "wind"}
    assert times.frame == session.simulation.frame == 3
    assert times.ms > max(times.less.values())
    assert session.simulation.grabbed == PARTICLE
    np.testing.assert_array_equal(session.simulation.positions(), before[0])
    np.testing.assert_array_equal(session.simulation.velocities(), before[1])
    assert len(session.simulation.take.rows) == before[2]
    session.act("solver")
    assert session.stage_times is None


def test_a_copy_is_where_the_running_cloth_is(session: Session) -> None:
    running = session.simulation
    running.set("wind_z", 7.0)
    running.pin(PARTICLE)
    running.pin(0, on=False)
    session.advance(5)
    with Simulation(running.scene) as copy:
        take_over(copy, running)
        for one in (copy, running):
            one.advance_frame()
        np.testing.assert_allclose(copy.positions(), running.positions(), atol=1e-6)
        assert (copy.frame, copy.get("wind_z")) == (6, 7.0)
        np.testing.assert_array_equal(copy.topology.pinned, running.topology.pinned)


def test_a_stage_waits_too(session: Session) -> None:
    session.ask_to_switch({**session.stages, "ground": False})
    assert "ground" in session.simulation.stages
    assert session.note.startswith("other stages: compiling")
    session.do_asked()
    assert "ground" not in session.simulation.stages
