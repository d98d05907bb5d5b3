"""What pages are told, by a reader of our own."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taichi_cloth.scene import load_scene
from taichi_cloth.scene.model import Look, Scene
from taichi_cloth.view.patterns import pattern_colours
from taichi_cloth.view.session import Session
from taichi_cloth.web.telling import Telling, packed


class Told:
    """A message, read."""

    def __init__(self, message: bytes) -> None:
        length = int.from_bytes(message[:4], "little")
        self.head: dict[str, Any] = json.loads(message[4 : 4 + length])
        assert length % 4 == 0
        self.rest = message[4 + length :]

    def take(self, kind: str, *shape: int) -> np.ndarray:
        array = np.frombuffer(self.rest, kind, int(np.prod(shape))).reshape(shape)
        self.rest = self.rest[array.nbytes :]
        return array


def small(name: str = "curtain", **more: Any) -> Scene:
    scene = load_scene(name)
    return replace(scene, cloth=replace(scene.cloth, rows=8, columns=9), **more)


@pytest.fixture
def session() -> Iterator[Session]:
    session = Session(small(), "list")
    yield session
    session.close()


def moment(telling: Telling) -> tuple[Told, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Head, poses, beads, places and triangles that are left."""
    told = Told(telling.moment())
    poses = told.take("<f4", told.head["poses"], 4, 4).transpose(0, 2, 1)
    beads = told.take("<f4", told.head["beads"], 3)
    steps = told.take("<u2", telling._whole.particle_count, 3)
    bits = told.take("u1", told.head["there"])
    count = telling._whole.triangle_count
    there = np.unpackbits(bits, bitorder="little")[:count].astype(bool) if len(bits) else np.ones(count, bool)
    assert told.rest == b""
    return told, poses, beads, np.array(told.head["low"]) + np.array(told.head["step"]) * steps, there


def test_a_scene_is_all_that_stays(session: Session) -> None:
    scene, topology = session.simulation.scene, session.simulation.topology
    told = Told(Telling(session, 7).scene())
    head = told.head
    assert (head["of"], head["name"], head["particles"]) == (7, "curtain", 72)
    told.take("<f4", head["solidVertices"], 6)
    rest = told.take("<f4", head["springs"])
    told.take("<u4", sum(solid["corners"] for solid in head["solids"]))
    owner = told.take("<u4", head["vertices"])
    corners = told.take("<u4", head["triangles"], 3)
    ends = told.take("<u4", head["springs"], 2)
    tint = told.take("u1", head["vertices"], 3)
    assert told.rest == b""
    assert (owner[corners] == topology.triangles).all()
    assert tint[corners] == pytest.approx(255 * pattern_colours(topology, scene.look).reshape(-1, 3, 3), abs=0.51)
    assert np.linalg.norm(np.diff(topology.flat[ends], axis=1)[:, 0], axis=1) == pytest.approx(rest, rel=1e-6)
    assert head["springs"] == topology.family_counts["structural"]
    assert head["ramp"][0][2] > head["ramp"][0][0], "blue where shortened"
    assert head["ramp"][-1][0] > head["ramp"][-1][2], "red where stretched"


def test_a_moment_is_where_everything_is(session: Session) -> None:
    telling = Telling(session, 0)
    for _ in range(3):
        session.advance(2)
        told, poses, _, x, there = moment(telling)
        here = session.simulation.positions()
        assert (np.abs(x - here) <= 0.5 * np.ptp(here, axis=0) / 65535 + 1e-12).all()
        assert told.head["frame"] == session.simulation.frame
        ball = session.simulation.bodies()[0]
        assert poses[0][:3, 3] == pytest.approx(ball.center, abs=1e-6)
        assert there.all()
    session.simulation.set("sphere_radius", 1.2)  # twice the scene's
    assert moment(telling)[1][0][:3, :3] == pytest.approx(2 * ball.axes, abs=1e-6)


def test_what_is_held_and_what_was_pinned_has_a_bead(session: Session) -> None:
    telling = Telling(session, 0)
    session.pin(40)
    assert moment(telling)[2] == pytest.approx(session.simulation.positions()[[40]], abs=1e-6)
    look = session.camera
    at, _ = look.to_screen(session.simulation.positions()[60], 1.0)
    assert session.hand(3).take(look, (at[0, 0], at[0, 1]), (500, 500), 0.0)
    told, _, beads, _, _ = moment(telling)
    assert told.head["held"] == 1
    assert beads == pytest.approx(session.simulation.positions()[[60, 40]], abs=1e-6)
    assert telling.holds


def test_what_a_tear_took_is_not_there_and_a_mended_cloth_is_another(session: Session) -> None:
    session.close()
    torn = Session(load_scene("tear", rows=8, columns=8, area_density=9.0), "list")
    try:
        telling = Telling(torn, 0)
        for _ in range(40):
            torn.advance(1)
            _, _, _, _, there = moment(telling)
            left = torn.simulation.topology.triangles
            assert {*map(tuple, telling._whole.triangles[there].tolist())} == {*map(tuple, left.tolist())}
        assert not there.all()
        assert telling.holds
        torn.act("reset")
        assert not telling.holds
    finally:
        torn.close()


def test_other_stages_methods_and_scenes_are_another(session: Session) -> None:
    for change in (
        lambda: session.switch({"ground": False}),
        lambda: session.change_solver("spring"),
        lambda: session.change_fabric("denim"),
        lambda: session.open_scene("drape15"),
    ):
        telling = Telling(session, 0)
        assert telling.holds
        change()
        assert session.note == ""
        assert not telling.holds


def test_the_panel_and_the_figures_are_those_of_the_window(session: Session) -> None:
    telling = Telling(session, 0)
    panel = Told(telling.panel(["curtain", "flag"])).head
    assert [slider["label"] for slider in panel["sliders"]][:3] == ["Gravity", "Wind X", "Wind Z"]
    assert panel["stages"] == {"spheres": ["Spheres", True], "ground": ["Ground", True]}
    session.simulation.set("gravity", 3.0)
    session.advance(1)
    session.measure()
    figures = Told(telling.figures(1.5, 30.0, 2)).head
    assert figures["values"]["gravity"] == 3.0
    assert "sending 1.5" in figures["numbers"]
    assert figures["row"][1] == session.measures.kinetic_energy


def test_a_title_stays_a_title() -> None:
    session = Session(small(title="</script><b>\U0001f9f5", look=Look(pole=True)), "list")
    try:
        assert Told(Telling(session, 0).scene()).head["title"] == "</script><b>\U0001f9f5"
    finally:
        session.close()
    assert packed({"a": "ä"})[4:] == b'{"a":"\\u00e4"}  '
