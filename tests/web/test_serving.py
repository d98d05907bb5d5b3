"""The simulation of a server, without one: what is heard when."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from queue import SimpleQueue
from typing import Any, cast

import numpy as np
import pytest

from taichi_cloth.scene import load_scene
from taichi_cloth.view.session import Session
from taichi_cloth.web.hub import Came, Hub
from taichi_cloth.web.serving import Serving
from taichi_cloth.web.words import Look, Said


class Silent:
    """A hub without a network."""

    def __init__(self) -> None:
        self.inbox: SimpleQueue[Came] = SimpleQueue()
        self.turned_at = 0.0
        self.visitors = 1
        self.told: list[str] = []
        self.newest: dict[str, bytes] = {}

    def publish(self, kind: str, data: bytes) -> None:
        self.told.append(kind)
        self.newest[kind] = data

    def tell(self, visitor: int, data: bytes) -> None:
        self.told.append(f"{visitor}")


@pytest.fixture
def serving() -> Iterator[Serving]:
    scene = load_scene("curtain")
    session = Session(replace(scene, cloth=replace(scene.cloth, rows=9, columns=11), wind=None, spheres=()), "list")
    yield Serving(session, cast(Hub, Silent()))
    session.close()


def say(serving: Serving, what: str, value: Any, of: int) -> None:
    serving.hub.inbox.put((1, Said(what, value, of)))
    serving.turn(time.perf_counter(), 1)


def test_a_hand_that_opens_while_the_method_changes_lets_go(serving: Serving) -> None:
    session = serving.session
    camera, place = session.camera, session.simulation.positions()[60]
    screen, _ = camera.to_screen(place, 640 / 360)
    look = Look(
        (float(screen[0, 0]), float(screen[0, 1])),
        (640, 360),
        camera.azimuth,
        camera.elevation,
        camera.distance,
        (float(camera.target[0]), float(camera.target[1]), float(camera.target[2])),
    )
    say(serving, "press", look, 0)
    assert session.simulation.grabbed_by(0) == 60
    say(serving, "choose", ("solver", "spring"), 0)
    assert session.simulation.solver.name == "spring"
    assert session.simulation.grabbed_by(0) == 60, "it keeps what it holds"
    say(serving, "set", ("gravity", 1.0), 0)  # of the cloth as it was
    assert session.simulation.get("gravity") != 1.0
    say(serving, "lift", None, 0)
    assert session.simulation.grabbed_by(0) is None


def test_another_scene_comes_with_its_panel_and_its_figures(serving: Serving) -> None:
    serving.turn(10.0, 1)
    serving.session.change_solver("spring")
    told = cast(Silent, serving.hub).told
    told.clear()
    serving.turn(10.001, 1)
    assert [kind for kind in told if kind != "moment"] == ["scene", "panel", "figures"]


def test_pages_read_why_a_cloth_that_blew_up_stands_still_and_go_on_after_a_reset(serving: Serving) -> None:
    session, newest = serving.session, cast(Silent, serving.hub).newest
    now = time.perf_counter()
    serving.turn(now, 1)
    session.simulation.set("gravity", 20.0)
    session.simulation.cloth.x[0] = (np.nan, 0.0, 0.0)
    serving.turn(now + 10, 1)
    assert b"the cloth blew up in frame 2: gravity is 20 m/s" in newest["figures"]
    assert b'"frozen":true' in newest["figures"]
    for action in ("own_values", "reset", "freeze"):
        say(serving, "do", action, 0)
    serving.turn(now + 20, 1)
    serving.turn(now + 30, 1)
    assert b'"note":""' in newest["figures"]
    assert session.simulation.frame >= 2
    assert np.isfinite(session.simulation.positions()).all()
