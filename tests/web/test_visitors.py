"""What pages ask for, done to a session: no server, no browser."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taichi_cloth.kernels.controls import MOST_HANDS
from taichi_cloth.scene import load_scene
from taichi_cloth.view.session import Session
from taichi_cloth.web.visitors import Visitors
from taichi_cloth.web.words import Look, Malformed, Said

SIZE = 640, 360
Told = list[tuple[int, dict[str, Any]]]


class Room:
    """A session, those who look at it, and what they were told."""

    def __init__(self) -> None:
        scene = load_scene("curtain")
        scene = replace(scene, cloth=replace(scene.cloth, rows=9, columns=11), wind=None, spheres=())
        self.session = Session(scene, "list")
        self.told: Told = []
        self.visitors = Visitors(self.session, ["curtain", "drape15"], lambda *told: self.told.append(told))

    def say(self, who: int, what: str, value: Any = None) -> None:
        self.visitors.do(who, Said(what, value, 0))

    def at(self, place: np.ndarray) -> Look:
        camera = self.session.camera
        screen, _ = camera.to_screen(place, SIZE[0] / SIZE[1])
        target = float(camera.target[0]), float(camera.target[1]), float(camera.target[2])
        cursor = float(screen[0, 0]), float(screen[0, 1])
        return Look(cursor, SIZE, camera.azimuth, camera.elevation, camera.distance, target)

    def particle(self, index: int) -> Look:
        return self.at(self.session.simulation.positions()[index])


@pytest.fixture
def room() -> Iterator[Room]:
    room = Room()
    yield room
    room.session.close()


def test_each_pulls_with_a_hand_of_its_own(room: Room) -> None:
    simulation = room.session.simulation
    room.say(1, "press", room.particle(60))
    room.say(2, "press", room.particle(93))
    assert [simulation.grabbed_by(hand) for hand in range(3)] == [60, 93, None]
    assert room.told == [(1, {"kind": "told", "took": True}), (2, {"kind": "told", "took": True})]
    right, up = room.session.camera.view()[:2, :3]  # a hand stays in the plane of the picture
    there = simulation.positions()[60] + 0.2 * right + 0.1 * up
    room.say(1, "move", room.at(there))
    room.session.advance(2)
    assert simulation.positions()[60] == pytest.approx(there, abs=1e-4)
    room.visitors.left(1)
    assert [simulation.grabbed_by(hand) for hand in range(2)] == [None, 93]
    assert np.linalg.norm(simulation.velocities()[60]) > 1.0, "it is thrown"
    room.say(2, "lift")
    assert len(simulation.held) == 0


def test_what_one_holds_no_other_takes(room: Room) -> None:
    room.say(1, "press", room.particle(60))
    room.say(2, "press", room.particle(60))
    assert room.told[-1] == (2, {"kind": "told", "took": False})
    room.say(2, "move", room.particle(70))  # it holds nothing
    assert room.session.simulation.held.tolist() == [60]


def test_hands_run_out(room: Room) -> None:
    for who in range(MOST_HANDS):
        room.say(who, "press", room.particle(22 + 3 * who))
    room.say(99, "press", room.particle(80))
    assert room.told[-1] == (99, {"kind": "told", "took": False, "note": "all 8 hands hold something"})
    room.visitors.left(3)
    room.say(99, "press", room.particle(80))
    assert room.session.simulation.grabbed_by(3) == 80


def test_a_press_beside_the_cloth_takes_nothing(room: Room) -> None:
    room.say(1, "press", replace(room.particle(60), cursor=(0.01, 0.01)))
    assert room.told == [(1, {"kind": "told", "took": False})]
    assert len(room.session.simulation.held) == 0


def test_it_is_seen_from_where_the_page_looks(room: Room) -> None:
    """From behind, off to the side and beside a panel the same particle is under another cursor."""
    camera = room.session.camera
    camera.azimuth, camera.elevation, camera.distance, camera.shift = 2.6, -0.2, 5.0, 0.3
    look = replace(room.particle(60), shift=0.3)
    camera.reset()
    camera.shift = 0.0
    room.say(1, "press", look)
    assert room.session.simulation.grabbed_by(0) == 60


def test_sliders_are_clamped_and_whole_where_they_must_be(room: Room) -> None:
    simulation = room.session.simulation
    for name, value, wanted in (("gravity", 5.5, 5.5), ("gravity", 1e9, 20.0), ("substeps", 6.6, 7), ("hand", -1, 0.0)):
        room.say(1, "set", (name, value))
        assert (room.session.radius if name == "hand" else simulation.get(name)) == wanted
    with pytest.raises(Malformed, match="'gravitas' is not a live parameter"):
        room.say(1, "set", ("gravitas", 1.0))


def test_only_what_there_is_may_be_chosen(room: Room) -> None:
    for choice in (("scene", "flag"), ("scene", "/etc/passwd.toml"), ("solver", "magic"), ("fabric", "wool")):
        with pytest.raises(Malformed, match="is no"):
            room.say(1, "choose", choice)
    with pytest.raises(Malformed, match="stages to switch"):
        room.say(1, "switch", {"cloth": False})


def test_choices_wait_until_the_note_was_told(room: Room) -> None:
    room.say(1, "choose", ("solver", "spring"))
    assert room.session.note.startswith("spring: compiling")
    assert room.session.simulation.solver.name == "verlet"
    room.session.do_asked()
    assert room.session.simulation.solver.name == "spring"
    room.say(1, "switch", {"ground": False})
    room.session.do_asked()
    assert room.session.simulation.scene.ground is None
    room.say(1, "press", room.particle(60))
    room.say(1, "choose", ("scene", "drape15"))
    room.session.do_asked()
    assert room.session.simulation.scene.name == "drape15"
    room.say(1, "move", room.particle(60))  # the hand is empty in another scene
    room.session.advance(1)
    assert len(room.session.simulation.held) == 0


def test_the_particle_under_the_cursor_or_in_the_hand_is_pinned(room: Room) -> None:
    room.say(1, "pin", room.particle(60))
    room.say(2, "press", room.particle(75))
    room.say(2, "pin", replace(room.particle(75), cursor=(0.01, 0.01)))
    assert {*room.session.simulation.added_pins.tolist()} == {60, 75}
    room.say(1, "pin", replace(room.particle(75), cursor=(0.01, 0.01)))
    assert room.session.note == "no cloth under the cursor to pin"


def test_pages_stand_still_for_one_thing_at_a_time(room: Room) -> None:
    room.say(1, "choose", ("scene", "drape15"))
    for what, value in (("switch", {"ground": False}), ("choose", ("solver", "spring")), ("do", "time_stages")):
        room.say(2, what, value)
    room.say(2, "do", "freeze")
    room.session.do_asked()
    assert not room.session.waits
    assert room.session.frozen
    scene = room.session.simulation.scene
    assert (scene.name, scene.solver.name) == ("drape15", "verlet")
    assert scene.ground is not None
    assert room.session.stage_times is None
