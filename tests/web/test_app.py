"""The main loop of the web server, without a network."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from queue import SimpleQueue
from typing import Any, cast

import numpy as np
import pytest

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.viewer.session import Session
from taichi_cloth.web.app import WebApp
from taichi_cloth.web.protocol import Command, PageView
from taichi_cloth.web.server import InboxItem, WebServer


class FakeServer:
    """A web server without a network."""

    def __init__(self) -> None:
        self.inbox: SimpleQueue[InboxItem] = SimpleQueue()
        self.stepped_at = 0.0
        self.clients = 1
        self.kinds: list[str] = []  # of all messages
        self.newest: dict[str, bytes] = {}

    def publish(self, kind: str, data: bytes) -> None:
        self.kinds.append(kind)
        self.newest[kind] = data

    def send(self, client: int, data: bytes) -> None:
        self.kinds.append(f"reply to {client}")


@pytest.fixture
def app() -> Iterator[WebApp]:
    scene = load_scene("curtain")
    session = Session(replace(scene, cloth=replace(scene.cloth, rows=9, columns=11), wind=None, spheres=()), "serial")
    yield WebApp(session, cast(WebServer, FakeServer()))
    session.close()


def send_command(app: WebApp, name: str, argument: Any, scene_id: int) -> None:
    """Send a command as client 1, and run the loop once."""
    app.server.inbox.put((1, Command(name, argument, scene_id)))
    app.step(time.perf_counter(), 1)


def test_a_release_during_a_switch_of_the_solver_releases_the_grab(app: WebApp) -> None:
    session = app.session
    camera, position = session.camera, session.simulation.positions()[60]
    screen, _ = camera.to_screen(position, 640 / 360)
    view = PageView(
        (float(screen[0, 0]), float(screen[0, 1])),
        (640, 360),
        camera.azimuth,
        camera.elevation,
        camera.distance,
        (float(camera.target[0]), float(camera.target[1]), float(camera.target[2])),
    )
    send_command(app, "press", view, 0)
    assert session.simulation.grabbed.tolist() == [60]
    send_command(app, "choose", ("solver", "explicit"), 0)
    assert session.simulation.solver.name == "explicit"
    assert session.simulation.grabbed.tolist() == [60], "the switch released the grab"
    send_command(app, "set", ("gravity", 1.0), 0)  # about the previous scene
    assert session.simulation.params["gravity"] != 1.0
    send_command(app, "release", None, 0)
    assert len(session.simulation.grabbed) == 0


def test_a_new_scene_is_sent_with_its_panel_and_its_metrics(app: WebApp) -> None:
    app.step(10.0, 1)
    app.session.change_solver("explicit")
    kinds = cast(FakeServer, app.server).kinds
    kinds.clear()
    app.step(10.001, 1)
    assert [kind for kind in kinds if kind != "update"] == ["scene", "panel", "metrics", "frameError"]


def test_pages_are_told_what_compiles_even_if_no_measurement_is_due(app: WebApp) -> None:
    app.step(10.0, 1)
    for k in range(1, 7):
        app.session.history.add(1.0 + k / 60, app.session.metrics, 250.0)
    app.server.inbox.put((1, Command("choose", ("solver", "explicit"), 0)))
    app.step(10.001, 1)
    sent = cast(FakeServer, app.server).newest["metrics"]
    assert b'"note":"explicit: compiling' in sent
    assert b'"alert":""' in sent, "advice about the solver before"
    assert app.session.simulation.solver.name == "explicit"


def test_of_scenes_chosen_while_one_compiles_the_last_is_opened(app: WebApp) -> None:
    app.server.inbox.put((1, Command("choose", ("scene", "drape15"), 0)))
    app.step(10.0, 1)
    assert app.session.simulation.scene.name == "drape15"
    for name in ("poles", "flag"):  # the page still showed the first scene
        app.server.inbox.put((1, Command("choose", ("scene", name), 0)))
    app.server.inbox.put((1, Command("choose", ("solver", "explicit"), 0)))
    app.step(10.1, 1)
    assert (app.session.simulation.scene.name, app.session.simulation.solver.name) == ("flag", "verlet")


class Ended(Exception):
    """Ends the loop of a test."""


def run_loops(app: WebApp, monkeypatch: pytest.MonkeyPatch, loops: int, seconds: float) -> None:
    """Run the loop a number of times, each with the same duration on a clock of the test [s]."""
    times = iter(k * seconds for k in range(1, loops + 1))
    now = [0.0]

    def sleep(_: float) -> None:
        now[0] = next(times, np.inf)
        if now[0] == np.inf:
            raise Ended

    monkeypatch.setattr("taichi_cloth.web.app.time.sleep", sleep)
    with pytest.raises(Ended):
        app.run(lambda: now[0])


@pytest.mark.parametrize(("speed", "frames"), [("1", 80), ("1/2", 40), ("1/4", 20), ("1/8", 10)])
def test_slow_motion_runs_fewer_frames_of_the_same_length(
    app: WebApp, monkeypatch: pytest.MonkeyPatch, speed: str, frames: int
) -> None:
    app.session.speed = speed
    run_loops(app, monkeypatch, 80, 1 / 60)
    assert app.session.simulation.frame == frames
    assert app.session.simulation.seconds == pytest.approx(frames / 60)


def test_a_slow_scene_gets_more_updates_not_more_frames_in_each(app: WebApp, monkeypatch: pytest.MonkeyPatch) -> None:
    due = []
    for ms in (1.0, 20.0, 250.0):
        frames: list[int] = []
        monkeypatch.setattr(app.session, "advance", frames.append)
        app.session.physics_ms = ms
        run_loops(app, monkeypatch, 5, 1.0)
        due.append({*frames[1:]})
    assert due == [{4}, {3}, {1}]


def test_pages_show_that_a_scene_is_too_slow(app: WebApp) -> None:
    newest = cast(FakeServer, app.server).newest
    app.step(10.0, 1)
    assert b'"alert":""' in newest["metrics"]
    for k in range(1, 7):
        app.session.history.add(1.0 + k / 60, app.session.metrics, 250.0)
    app.session.simulation.set_frame(70)
    app.step(11.0, 0)
    assert b'"alert":"too slow: a frame needs 250 ms of 16.7; try ' in newest["metrics"]


def test_pages_show_why_a_diverged_cloth_is_frozen_and_continue_after_a_reset(app: WebApp) -> None:
    session, newest = app.session, cast(FakeServer, app.server).newest
    now = time.perf_counter()
    app.step(now, 1)
    session.simulation.params["gravity"] = 20.0
    session.simulation.cloth.x[0] = (np.nan, 0.0, 0.0)
    app.step(now + 10, 1)
    assert b"the cloth blew up in frame 2: gravity is 20 m/s" in newest["metrics"]
    assert b'"frozen":true' in newest["metrics"]
    for action in ("restore_defaults", "reset", "freeze"):
        send_command(app, "action", action, 0)
    app.step(now + 20, 1)
    app.step(now + 30, 1)
    assert b'"note":""' in newest["metrics"]
    assert session.simulation.frame >= 2
    assert np.isfinite(session.simulation.positions()).all()
