"""What keys and mouse do, without a display."""

from __future__ import annotations

from collections.abc import Iterator
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
from taichi_cloth.scene.model import SOLVER_NAMES
from taichi_cloth.view.keepsakes import Keepsakes
from taichi_cloth.view.session import HOLD, Session

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
    assert session.note == "curtain_001.obj could not be written: File exists"
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


def test_the_solver_changes_while_the_cloth_moves_and_is_held(session: Session) -> None:
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
