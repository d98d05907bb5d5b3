"""Dragging of cloth and balls, and pins under the cursor, without a display."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pointing import ASPECT, PARTICLE, cursor_on, grab, grabbed, point

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.render.camera import MAX_ZOOM_LEVEL, NEAR, ZOOM_STEP, OrbitCamera
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.viewer.dragging import grab_radii
from taichi_cloth.viewer.session import Session
from taichi_cloth.viewer.toolkit import Refusal, Target

pytestmark = pytest.mark.usefixtures("serial_layout")


def test_a_press_grabs_the_particle_under_the_cursor_and_the_release_releases_it(session: Session) -> None:
    grab(session)
    point(session, (0.2, 0.2), "left")
    session.advance(1)
    assert cursor_on(session, PARTICLE) == pytest.approx((0.2, 0.2), abs=2e-3)
    point(session, (0.2, 0.2))
    assert grabbed(session) is None


@pytest.mark.parametrize("shift", [0.0, 0.2])
def test_zoom_ends_in_front_of_cloth(session: Session, shift: float) -> None:
    """Seen from the front, the cloth covers the middle of the picture, before or behind the target."""
    camera = session.camera = OrbitCamera((0.0, 1.0, 4.0), (0.0, 1.0, 0.0), 40)
    camera.view_shift = shift
    x = session.simulation.positions()
    flat = np.column_stack([2 * (x[:, 0] - x[:, 0].mean()), x[:, 1] - x[:, 1].mean() + 1.0, np.zeros(len(x))])
    session.simulation.set_state(flat + [0.0, 0.0, 0.6])
    session.zoom(1e6)
    assert camera.distance == pytest.approx(0.6 + NEAR)
    session.simulation.set_state(flat - [0.0, 0.0, 0.5])
    session.zoom(1e6)
    assert camera.distance == pytest.approx(4 * np.exp(-ZOOM_STEP * MAX_ZOOM_LEVEL))
    session.zoom(-5)
    assert session.camera.zoom_level == pytest.approx(MAX_ZOOM_LEVEL - 5)


@pytest.mark.parametrize("what", ["cloth", "ball"])
def test_a_drag_while_frozen_says_when_it_moves(session: Session, what: str) -> None:
    start = cursor_on(session, PARTICLE) if what == "cloth" else cursor_at(session, clear_ball(session))
    session.frozen = True
    point(session, start)
    point(session, start, "left")
    assert session.note == "frozen: hold the button and press Space or N, and what you drag follows the mouse"
    session.act("freeze")
    assert session.note == ""
    assert session.dragger.drag is not None


@pytest.mark.parametrize("what", ["cloth", "ball"])
def test_a_drag_that_ends_while_frozen_moves_nothing(session: Session, what: str) -> None:
    session.frozen = True
    clear_ball(session)
    start = cursor_on(session, PARTICLE) if what == "cloth" else cursor_at(session, ball_of(session))
    twin = Session(load_scene("curtain"))
    clear_ball(twin)
    point(session, start)
    for step in range(3):
        point(session, (start[0] - 0.05 * step, start[1]), "left")
    point(session, (start[0] - 0.1, start[1]))
    session.advance(1)
    assert session.note == ""
    for one in (session, twin):
        one.act("step")
    assert ball_of(session) == pytest.approx(ball_of(twin), abs=1e-9)
    assert session.simulation.positions() == pytest.approx(twin.simulation.positions(), abs=1e-3)
    twin.close()


def cursor_at(session: Session, point: Any) -> tuple[float, float]:
    u, v = session.camera.to_screen(np.array([point]), ASPECT)[0][0]
    return float(u), float(v)


def ball_of(session: Session) -> np.ndarray:
    return session.simulation.colliders()[0].center


def clear_ball(session: Session) -> np.ndarray:
    """Move the ball of the curtain beside the cloth, and return its center."""
    session.simulation.move_collider(0, (2.6, 1.0, 0.5))
    session.simulate(1)
    return ball_of(session)


def test_a_sphere_can_be_dragged_and_stays_where_it_is_released(session: Session) -> None:
    center = clear_ball(session)
    start = cursor_at(session, center)
    point(session, start)
    point(session, start, "left")
    assert session.pointer.owner is Target.CLOTH
    assert grabbed(session) is None  # no cloth
    goal = center + [-0.3, 0.2, 0.0]
    for _ in range(30):
        point(session, cursor_at(session, goal), "left")
        session.simulate(1)
    depth = session.camera.to_screen(np.array([center, ball_of(session)]), ASPECT)[1]
    assert depth[1] == pytest.approx(depth[0], abs=1e-3)  # on a plane parallel to the image
    assert cursor_at(session, ball_of(session)) == pytest.approx(cursor_at(session, goal), abs=1e-3)
    point(session, cursor_at(session, goal))
    released = ball_of(session)
    session.simulate(1)
    assert np.linalg.norm(ball_of(session) - released) < 0.05  # it continues its own slow motion
    assert session.dragger.drag is None


def test_a_dragged_sphere_moves_by_at_most_its_radius_in_a_frame(session: Session) -> None:
    center = clear_ball(session)
    start, radius = cursor_at(session, center), session.simulation.colliders()[0].size[0]
    point(session, start)
    point(session, start, "left")
    point(session, cursor_at(session, center + [0.0, 2.0, 0.0]), "left")
    for _ in range(12):
        before = ball_of(session)
        session.simulate(1)
        assert np.linalg.norm(ball_of(session) - before) < 1.001 * radius
    assert ball_of(session)[1] == pytest.approx(3.0, abs=0.05)  # and arrives


def test_a_reset_ends_the_drag_of_a_sphere(session: Session) -> None:
    home = ball_of(session)
    center = clear_ball(session)
    point(session, cursor_at(session, center))
    point(session, cursor_at(session, center), "left")
    session.simulate(1)
    assert session.dragger.drag is not None
    session.simulation.reset()
    assert session.dragger.drag is None
    assert ball_of(session) == pytest.approx(home)


def test_a_drag_of_a_sphere_can_be_undone(session: Session) -> None:
    center = clear_ball(session)
    point(session, cursor_at(session, center))
    point(session, cursor_at(session, center), "left")
    for _ in range(5):
        point(session, cursor_at(session, center + [0.5, 0.0, 0.0]), "left")
        session.simulate(1)
    point(session, cursor_at(session, center))
    session.undo()
    assert ball_of(session) == pytest.approx(center, abs=0.02)


def test_cloth_in_front_of_a_sphere_is_grabbed_first(session: Session) -> None:
    x = session.simulation.positions()
    session.simulation.move_collider(0, x[PARTICLE] - [0.0, 0.0, 1.0])
    session.simulate(1)
    cursor = cursor_on(session, PARTICLE)
    point(session, cursor)
    point(session, cursor, "left")
    assert grabbed(session) is not None


def test_a_drag_is_the_same_on_a_slow_and_a_fast_display() -> None:
    after = []
    for displayed, frames in ((12, 1), (4, 3)):
        session = Session(load_scene("curtain"))
        u, v = grab(session)
        for k in range(1, displayed + 1):
            point(session, (u + 0.1 * k / displayed, v), "left")
            session.advance(frames)
        point(session, (u + 0.1, v))
        session.advance(3)
        after.append(session.simulation.positions())
        session.close()
    assert after[0] == pytest.approx(after[1], abs=1e-4)


@pytest.mark.parametrize("action", ["reset", "next_scene"])
def test_a_reset_and_another_scene_release_the_grab(session: Session, action: str) -> None:
    cursor = grab(session)
    session.act(action)
    assert grabbed(session) is None
    point(session, cursor, "left")  # the button is still down
    assert grabbed(session) is None
    assert session.pointer.owner is Target.NOTHING


def test_a_widget_that_changes_releases_the_grab(session: Session) -> None:
    cursor = grab(session)
    point(session, cursor, "left", widget_changed=True)
    assert grabbed(session) is None


def test_the_grab_radius_selects_one_particle_or_a_patch(session: Session) -> None:
    grab(session)
    assert len(session.simulation.grabbed) == 1
    point(session, (0.1, 0.1))
    for _ in range(3):
        session.act("larger_radius")
    grab(session)
    assert len(session.simulation.grabbed) == 5  # 0.087 m · 1.25³, and cells of 0.15 m
    point(session, (0.1, 0.1))
    for _ in range(20):
        session.act("smaller_radius")
    assert session.grab_radius == 0.0
    session.act("larger_radius")
    assert 0 < session.grab_radius < session.default_grab_radius
    for _ in range(40):
        session.act("larger_radius")
    assert session.grab_radius == session.max_grab_radius


def test_a_hand_holds_more_than_one_particle_of_cloth_that_tears() -> None:
    for rows, least in ((40, 9), (8, 4), (2, 1)):
        with Simulation(load_scene("tear", rows=rows, columns=rows)) as simulation:
            default, largest = grab_radii(simulation)
            assert default <= largest
            middle = rows // 2 * (rows + 1)
            distances = np.linalg.norm(simulation.positions() - simulation.positions()[middle], axis=1)
            assert (distances <= default).sum() >= least
    with Simulation(load_scene("drape15")) as simulation:
        assert grab_radii(simulation) == (0.02 * 2.0, 0.25 * 2.0)


def test_the_cloth_can_be_grabbed_from_behind_and_while_it_is_frozen(session: Session) -> None:
    session.act("freeze")
    front = session.camera.eye[2]
    while session.camera.eye[2] > -0.8 * front:
        session.camera.orbit(0.05, 0.0)
    cursor = cursor_on(session, PARTICLE)
    point(session, cursor, "left")
    assert grabbed(session) == PARTICLE
    before = session.simulation.positions()
    point(session, (cursor[0] + 0.05, cursor[1]), "left")
    session.advance(3)
    assert (session.simulation.positions() == before).all(), "frozen cloth moved"
    session.act("step")
    assert cursor_on(session, PARTICLE) == pytest.approx((cursor[0] + 0.05, cursor[1]), abs=2e-3)


def test_pin_toggles_the_particle_under_the_cursor(session: Session) -> None:
    cursor = cursor_on(session, PARTICLE)
    point(session, cursor)
    session.act("pin")
    assert session.simulation.added_pins.tolist() == [PARTICLE]
    pinned_at = session.simulation.positions()[PARTICLE]
    session.advance(5)
    assert (session.simulation.positions()[PARTICLE] == pinned_at).all()
    session.act("pin")
    assert not session.simulation.topology.pinned[PARTICLE]
    point(session, cursor_on(session, 3))
    session.act("pin")
    assert not session.simulation.topology.pinned[3], "a pin of the scene was not removed"
    session.act("reset")
    assert session.simulation.topology.pinned[3]


@pytest.mark.parametrize("on_panel", [True, False])
def test_pin_beside_the_cloth_pins_nothing_with_a_note(session: Session, on_panel: bool) -> None:
    point(session, cursor_on(session, PARTICLE) if on_panel else (0.02, 0.02), on_panel=on_panel)
    session.act("pin")
    assert session.note == "nothing to pin: no cloth under the cursor"
    assert len(session.simulation.added_pins) == 0


def test_pin_pins_the_dragged_particle_where_it_is_dragged(session: Session) -> None:
    grab(session)
    session.act("pin")
    point(session, (0.3, 0.3), "left")
    session.advance(1)
    point(session, (0.3, 0.3))
    session.advance(5)
    assert cursor_on(session, PARTICLE) == pytest.approx((0.3, 0.3), abs=2e-3)


TOP = 14  # of the curtain, a pin of the scene in the middle of its top row


def drag(session: Session, start: tuple[float, float], by: tuple[float, float] = (-0.1, -0.1)) -> None:
    """Drag from a screen point and release, so fast that a pin would follow."""
    point(session, start)
    point(session, start, "left")
    end = start[0] + by[0], start[1] + by[1]
    for _ in range(3):
        point(session, end, "left")
        session.advance(1)
    point(session, end)


def test_a_drag_does_not_move_a_pin_of_the_scene(session: Session) -> None:
    pinned = session.simulation.topology.pinned
    start = session.simulation.positions()[pinned]
    cursor = cursor_on(session, TOP)
    point(session, cursor)
    point(session, cursor, "left")
    assert pinned[TOP]
    assert grabbed(session) == TOP + 30  # the particle below it
    point(session, cursor)
    drag(session, cursor)
    assert (session.simulation.positions()[pinned] == start).all()
    assert session.note == ""
    assert len(session.draw_list.pins) == 0


def test_pins_of_the_scene_without_a_free_particle_near_are_not_grabbed(session: Session) -> None:
    session.simulation.pin(TOP + 30, 3.5 * 0.15)
    session.refresh()
    start = session.simulation.positions()[:30]
    drag(session, cursor_on(session, TOP))
    assert session.note == "only pins of the scene here: P unpins them"
    assert isinstance(session.note, Refusal)
    assert (session.simulation.positions()[:30] == start).all()


def test_an_added_pin_moves_with_a_drag_which_the_note_says_and_undo_puts_it_back(session: Session) -> None:
    session.pin(PARTICLE)
    session.advance(2)
    before = session.simulation.positions()[PARTICLE]
    drag(session, cursor_on(session, PARTICLE))
    session.advance(5)
    assert np.linalg.norm(session.simulation.positions()[PARTICLE] - before) > 0.3
    assert session.note == "pin moved; Z puts it back"
    assert isinstance(session.note, Refusal)
    session.act("undo")
    assert session.simulation.positions()[PARTICLE] == pytest.approx(before, abs=1e-6)


def test_a_drag_beyond_the_reach_of_the_cloth_is_named_until_it_ends(session: Session) -> None:
    cursor = grab(session)
    session.measure()
    assert session.note == ""
    point(session, (cursor[0] + 0.1, cursor[1] - 0.45), "left")
    session.advance(3)
    assert session.measure().max_strain > 1
    assert session.note == "pulled too far; L grabs more"
    assert isinstance(session.note, Refusal)
    session.advance(1)
    assert session.note
    point(session, cursor)
    session.advance(1)
    session.measure()
    assert session.note == ""


def test_a_pin_of_the_scene_that_was_moved_on_purpose_is_marked(session: Session) -> None:
    session.pin(TOP)  # unpins it
    cursor = cursor_on(session, TOP)
    point(session, cursor)
    point(session, cursor, "left")
    point(session, (cursor[0], cursor[1] - 0.1), "left")
    session.advance(2)
    session.act("pin")
    point(session, (cursor[0], cursor[1] - 0.1))
    assert session.simulation.topology.pinned[TOP]
    assert session.simulation.added_pins.tolist() == []
    assert session.draw_list.pins.tolist() == [TOP]
    session.act("undo")
    assert session.draw_list.pins.tolist() == []
    session.act("reset")
    assert session.draw_list.pins.tolist() == []


def test_pins_within_the_grab_radius_change_together(session: Session) -> None:
    flat = session.simulation.topology.flat
    distances = np.linalg.norm(flat - flat[PARTICLE], axis=1)
    session.grab_radius = 1.5 * np.sort(distances)[1]
    session.pin(PARTICLE)
    pins = session.simulation.added_pins
    near = np.flatnonzero(distances <= session.grab_radius)
    assert len(pins) > 3
    np.testing.assert_array_equal(pins, near)
    session.pin(PARTICLE)
    assert session.simulation.added_pins.tolist() == []


def test_a_drag_to_a_point_beyond_all_coordinates_ends_at_the_last_one(session: Session) -> None:
    u, v = session.camera.to_screen(session.simulation.positions()[PARTICLE], ASPECT)[0][0]
    size = (round(100 * ASPECT), 100)
    assert session.dragger.begin(session.camera, (float(u), float(v)), size, 0.0)
    session.camera.target = session.camera.target + np.array([3e6, 0.0, 0.0])
    session.dragger.follow(session.camera, (float(u), float(v)), size)
    session.dragger.interpolate(1.0)
    target = session.simulation.grabs[0].target
    assert np.abs(target).max() == 1e6
