"""Commands of pages applied to a session, without a server and a browser."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.kernels.step_params import MAX_GRABS
from taichi_cloth.viewer.session import Session
from taichi_cloth.web.app import CommandHandler
from taichi_cloth.web.protocol import Command, PageView, ProtocolError

SIZE = 640, 360
Replies = list[tuple[int, dict[str, Any]]]  # client and reply


class Pages:
    """A session, its open pages, and the replies that they got."""

    def __init__(self) -> None:
        scene = load_scene("curtain")
        scene = replace(scene, cloth=replace(scene.cloth, rows=9, columns=11), wind=None, spheres=())
        self.session = Session(scene, "serial")
        self.replies: Replies = []
        self.handler = CommandHandler(self.session, ["curtain", "drape15"], lambda *reply: self.replies.append(reply))

    def send(self, client: int, name: str, argument: Any = None) -> None:
        self.handler.apply(client, Command(name, argument, 0))

    def view_of(self, position: np.ndarray) -> PageView:
        """Return the view of a page whose cursor is at a position."""
        camera = self.session.camera
        screen, _ = camera.to_screen(position, SIZE[0] / SIZE[1])
        target = float(camera.target[0]), float(camera.target[1]), float(camera.target[2])
        cursor = float(screen[0, 0]), float(screen[0, 1])
        return PageView(cursor, SIZE, camera.azimuth, camera.elevation, camera.distance, target)

    def view_of_particle(self, index: int) -> PageView:
        return self.view_of(self.session.simulation.positions()[index])

    def dragged_by(self, number: int) -> int | None:
        """Return the particle that a dragger has grabbed, or None."""
        particle = self.session.dragger_of(number).particle
        assert particle is None or particle in self.session.simulation.grabbed
        return particle


@pytest.fixture
def pages() -> Iterator[Pages]:
    pages = Pages()
    yield pages
    pages.session.close()


def test_every_page_has_its_own_grab(pages: Pages) -> None:
    simulation = pages.session.simulation
    pages.send(1, "press", pages.view_of_particle(60))
    pages.send(2, "press", pages.view_of_particle(93))
    assert [pages.dragged_by(number) for number in range(3)] == [60, 93, None]
    assert pages.replies == [(1, {"kind": "reply", "grabbed": True}), (2, {"kind": "reply", "grabbed": True})]
    right, up = pages.session.camera.view()[:2, :3]  # a grab stays in a plane parallel to the image
    target = simulation.positions()[60] + 0.2 * right + 0.1 * up
    pages.send(1, "move", pages.view_of(target))
    pages.session.advance(2)
    assert simulation.positions()[60] == pytest.approx(target, abs=1e-4)
    pages.handler.release(1)
    assert [pages.dragged_by(number) for number in range(2)] == [None, 93]
    assert np.linalg.norm(simulation.velocities()[60]) > 1.0, "the released particle keeps its velocity"
    pages.send(2, "release")
    assert len(simulation.grabbed) == 0


def test_a_finger_moves_no_pin_of_the_scene_and_the_note_says_which_pin_it_has_moved(pages: Pages) -> None:
    simulation, (right, up) = pages.session.simulation, pages.session.camera.view()[:2, :3]
    start = simulation.positions()
    pages.send(1, "press", pages.view_of_particle(5))
    assert pages.dragged_by(0) == 16  # in the next row
    pages.send(1, "release")
    pages.send(1, "pin", pages.view_of_particle(60))
    pages.send(1, "press", pages.view_of_particle(60))
    pages.send(1, "move", pages.view_of(start[60] + 0.2 * right - 0.1 * up))
    pages.session.advance(2)
    pages.send(1, "release")
    pages.session.advance(2)
    assert pages.session.note == "pin moved; Z puts it back"
    assert (simulation.positions()[:11] == start[:11]).all()


def test_a_grabbed_particle_cannot_be_grabbed_by_another_page(pages: Pages) -> None:
    pages.send(1, "press", pages.view_of_particle(60))
    pages.send(2, "press", pages.view_of_particle(60))
    assert pages.replies[-1] == (2, {"kind": "reply", "grabbed": False})
    pages.send(2, "move", pages.view_of_particle(70))  # it has grabbed nothing
    assert pages.session.simulation.grabbed.tolist() == [60]


def test_the_number_of_grabs_is_limited(pages: Pages) -> None:
    for client in range(MAX_GRABS):
        pages.send(client, "press", pages.view_of_particle(22 + 3 * client))
    pages.send(99, "press", pages.view_of_particle(80))
    assert pages.replies[-1] == (99, {"kind": "reply", "grabbed": False, "note": "all 8 grabs are in use"})
    pages.handler.release(3)
    pages.send(99, "press", pages.view_of_particle(80))
    assert pages.dragged_by(3) == 80


def test_a_press_beside_the_cloth_grabs_nothing(pages: Pages) -> None:
    pages.send(1, "press", replace(pages.view_of_particle(60), cursor=(0.01, 0.01)))
    assert pages.replies == [(1, {"kind": "reply", "grabbed": False})]
    assert len(pages.session.simulation.grabbed) == 0


def test_a_press_uses_the_camera_of_its_page(pages: Pages) -> None:
    """From behind, from the side and beside a panel, the same particle is at another screen point."""
    camera = pages.session.camera
    camera.azimuth, camera.elevation, camera.distance, camera.view_shift = 2.6, -0.2, 5.0, 0.3
    view = replace(pages.view_of_particle(60), view_shift=0.3)
    camera.reset()
    camera.view_shift = 0.0
    pages.send(1, "press", view)
    assert pages.dragged_by(0) == 60


def test_sliders_are_clamped_and_integers_are_rounded(pages: Pages) -> None:
    simulation = pages.session.simulation
    for name, value, expected in (
        ("gravity", 5.5, 5.5),
        ("gravity", 1e9, 20.0),
        ("substeps", 6.6, 7),
        ("grab_radius", -1, 0.0),
    ):
        pages.send(1, "set", (name, value))
        assert (pages.session.grab_radius if name == "grab_radius" else simulation.params[name]) == expected
    with pytest.raises(ProtocolError, match="'gravitas' is not a runtime parameter"):
        pages.send(1, "set", ("gravitas", 1.0))


def test_only_available_names_can_be_chosen(pages: Pages) -> None:
    for choice in (
        ("scene", "flag"),
        ("scene", "/etc/passwd.toml"),
        ("solver", "magic"),
        ("fabric", "wool"),
        ("speed", "2"),
    ):
        with pytest.raises(ProtocolError, match="unknown"):
            pages.send(1, "choose", choice)
    with pytest.raises(ProtocolError, match="cannot switch"):
        pages.send(1, "switch", {"cloth": False})


def test_the_speed_of_the_simulation_is_that_of_all_pages(pages: Pages) -> None:
    assert pages.session.speed == "1"
    pages.send(1, "choose", ("speed", "1/8"))
    assert pages.session.speed == "1/8"
    pages.session.open_scene("drape15")
    assert pages.session.speed == "1/8"


def test_choices_are_deferred_until_the_note_was_sent(pages: Pages) -> None:
    pages.send(1, "choose", ("solver", "explicit"))
    assert pages.session.note.startswith("explicit: compiling")
    assert pages.session.simulation.solver.name == "verlet"
    pages.session.run_deferred()
    assert pages.session.simulation.solver.name == "explicit"
    pages.send(1, "switch", {"ground": False})
    pages.session.run_deferred()
    assert pages.session.simulation.scene.ground is None
    pages.send(1, "press", pages.view_of_particle(60))
    pages.send(1, "choose", ("scene", "drape15"))
    pages.session.run_deferred()
    assert pages.session.simulation.scene.name == "drape15"
    pages.send(1, "move", pages.view_of_particle(60))  # the grab was released with the previous scene
    pages.session.advance(1)
    assert len(pages.session.simulation.grabbed) == 0


def test_the_dragged_particle_or_the_one_under_the_cursor_is_pinned(pages: Pages) -> None:
    pages.send(1, "pin", pages.view_of_particle(60))
    pages.send(2, "press", pages.view_of_particle(75))
    pages.send(2, "pin", replace(pages.view_of_particle(75), cursor=(0.01, 0.01)))
    assert {*pages.session.simulation.added_pins.tolist()} == {60, 75}
    pages.send(1, "pin", replace(pages.view_of_particle(75), cursor=(0.01, 0.01)))
    assert pages.session.note == "nothing to pin: no cloth under the cursor"


def test_only_one_compilation_is_deferred_at_a_time(pages: Pages) -> None:
    pages.send(1, "choose", ("scene", "drape15"))
    for name, argument in (
        ("switch", {"ground": False}),
        ("choose", ("solver", "explicit")),
        ("action", "time_features"),
    ):
        pages.send(2, name, argument)
    pages.send(2, "action", "freeze")
    pages.session.run_deferred()
    assert not pages.session.deferred
    assert pages.session.frozen
    scene = pages.session.simulation.scene
    assert (scene.name, scene.solver.name) == ("drape15", "verlet")
    assert scene.ground is not None
    assert pages.session.feature_times is None
