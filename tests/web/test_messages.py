"""The messages to pages, decoded by a reader of the tests."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.render.colors import pattern_colors
from taichi_cloth.scene.fabric_schema import Look
from taichi_cloth.scene.schema import Scene
from taichi_cloth.viewer import toolkit
from taichi_cloth.viewer.session import Session
from taichi_cloth.web.protocol import MessageBuilder, pack_message


def test_lines_for_the_user_name_the_controls_of_the_page() -> None:
    """A phone has no keys."""
    notes = [*toolkit.UNDONE, toolkit.FROZEN_DRAG, toolkit.PIN_MOVED, toolkit.ONLY_PINS, toolkit.PULLED_TOO_FAR]
    assert [toolkit.without_keys(note) for note in notes] == [
        "undone; press Freeze to continue",
        "undone, and slider changes since; press Freeze to continue",
        "frozen: hold it and press Freeze or Step, and what you drag follows",
        "pin moved; Undo puts it back",
        "only pins of the scene here: the key P unpins them",
        "pulled too far; a larger Grab radius grabs more",
    ]
    texts = "".join(path.read_text("utf-8") for path in Path(toolkit.__file__).parent.glob("*.py"))
    assert [key for key in toolkit.CONTROLS if texts.count(key) < 2] == [], "no line has these words any more"


def test_a_page_gets_the_note_with_the_names_of_its_controls(session: Session) -> None:
    session.pin(20)
    session.act("undo")
    message = Decoded(MessageBuilder(session, 0).metrics(1.0, 30.0, 1)).head
    assert (message["note"], message["noteKind"]) == ("undone; press Freeze to continue", "success")
    assert "error of a frame: not measured: see Measure errors" in message["statistics"].splitlines()


class Decoded:
    """A decoded message."""

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
    session = Session(small(), "serial")
    yield session
    session.close()


def decode_update(builder: MessageBuilder) -> tuple[Decoded, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return head, poses, markers, positions and remaining triangles of an update."""
    message = Decoded(builder.update())
    poses = message.take("<f4", message.head["poses"], 4, 4).transpose(0, 2, 1)
    markers = message.take("<f4", message.head["markers"], 3)
    steps = message.take("<u2", builder._untorn.particle_count, 3)
    bits = message.take("u1", message.head["present"])
    count = builder._untorn.triangle_count
    present = np.unpackbits(bits, bitorder="little")[:count].astype(bool) if len(bits) else np.ones(count, bool)
    assert message.rest == b""
    return message, poses, markers, np.array(message.head["low"]) + np.array(message.head["step"]) * steps, present


def test_the_scene_message_has_everything_that_stays_constant(session: Session) -> None:
    scene, topology = session.simulation.scene, session.simulation.topology
    message = Decoded(MessageBuilder(session, 7).scene())
    head = message.head
    assert (head["sceneId"], head["name"], head["particles"]) == (7, "curtain", 72)
    message.take("<f4", head["solidVertices"], 6)
    rest = message.take("<f4", head["springs"])
    message.take("<u4", sum(solid["corners"] for solid in head["solids"]))
    owner = message.take("<u4", head["vertices"])
    corners = message.take("<u4", head["triangles"], 3)
    ends = message.take("<u4", head["springs"], 2)
    colors = message.take("u1", head["vertices"], 3)
    assert message.rest == b""
    assert (owner[corners] == topology.triangles).all()
    assert colors[corners] == pytest.approx(255 * pattern_colors(topology, scene.look).reshape(-1, 3, 3), abs=0.51)
    assert np.linalg.norm(np.diff(topology.flat[ends], axis=1)[:, 0], axis=1) == pytest.approx(rest, rel=1e-6)
    assert head["springs"] == topology.family_counts["structural"]
    shortened, relaxed, stretched, unknown = head["strainColors"]
    assert shortened[2] > shortened[0], "blue where shortened"
    assert min(relaxed) > 200, "almost white where relaxed"
    assert stretched[0] > stretched[2], "red where stretched"
    assert len(set(unknown)) == 1, "gray where not measured"


def test_an_update_has_all_positions_and_poses(session: Session) -> None:
    builder = MessageBuilder(session, 0)
    for _ in range(3):
        session.advance(2)
        message, poses, _, x, present = decode_update(builder)
        here = session.simulation.positions()
        assert (np.abs(x - here) <= 0.5 * np.ptp(here, axis=0) / 65535 + 1e-12).all()
        assert message.head["frame"] == session.simulation.frame
        sphere = session.simulation.colliders()[0]
        assert poses[0][:3, 3] == pytest.approx(sphere.center, abs=1e-6)
        assert present.all()
    session.simulation.params["sphere_radius"] = 1.2  # twice the scene's
    assert decode_update(builder)[1][0][:3, :3] == pytest.approx(2 * sphere.axes, abs=1e-6)


def test_dragged_and_pinned_particles_have_markers(session: Session) -> None:
    builder = MessageBuilder(session, 0)
    session.pin(40)
    assert decode_update(builder)[2] == pytest.approx(session.simulation.positions()[[40]], abs=1e-6)
    camera = session.camera
    screen, _ = camera.to_screen(session.simulation.positions()[60], 1.0)
    assert session.dragger_of(3).begin(camera, (screen[0, 0], screen[0, 1]), (500, 500), 0.0)
    message, _, markers, _, _ = decode_update(builder)
    assert message.head["dragged"] == 1
    assert markers == pytest.approx(session.simulation.positions()[[60, 40]], abs=1e-6)
    assert builder.is_valid


def test_torn_triangles_are_left_out_and_a_reset_needs_a_new_scene_message(session: Session) -> None:
    session.close()
    torn = Session(load_scene("tear", rows=8, columns=8, area_density=9.0), "serial")
    try:
        builder = MessageBuilder(torn, 0)
        for _ in range(40):
            torn.advance(1)
            _, _, _, _, present = decode_update(builder)
            left = torn.simulation.topology.triangles
            assert {*map(tuple, builder._untorn.triangles[present].tolist())} == {*map(tuple, left.tolist())}
        assert not present.all()
        assert builder.is_valid
        torn.act("reset")
        assert not builder.is_valid
    finally:
        torn.close()


def test_other_features_solvers_fabrics_and_scenes_need_a_new_scene_message(session: Session) -> None:
    for change in (
        lambda: session.set_features({"ground": False}),
        lambda: session.change_solver("explicit"),
        lambda: session.change_fabric("denim"),
        lambda: session.open_scene("drape15"),
    ):
        builder = MessageBuilder(session, 0)
        assert builder.is_valid
        change()
        assert session.note == ""
        assert not builder.is_valid


def test_panel_and_metrics_equal_those_of_the_window(session: Session) -> None:
    builder = MessageBuilder(session, 0)
    panel = Decoded(builder.panel(["curtain", "flag"])).head
    assert [slider["label"] for slider in panel["sliders"]][:3] == ["Gravity", "Wind X", "Wind Z"]
    assert panel["features"] == {"spheres": ["Spheres", True], "ground": ["Ground", True]}
    session.simulation.params["gravity"] = 3.0
    session.advance(1)
    session.measure()
    metrics = Decoded(builder.metrics(1.5, 30.0, 2)).head
    assert metrics["parameters"]["gravity"] == 3.0
    assert "sending 1.5" in metrics["statistics"]
    assert metrics["row"][1] == session.metrics.kinetic_energy


def test_titles_are_escaped() -> None:
    session = Session(small(title="</script><b>\U0001f9f5", look=Look(pole=True)), "serial")
    try:
        assert Decoded(MessageBuilder(session, 0).scene()).head["title"] == "</script><b>\U0001f9f5"
    finally:
        session.close()
    assert pack_message({"a": "ä"})[4:] == b'{"a":"\\u00e4"}  '


def test_the_error_of_each_particle_is_sent_as_a_share_of_the_largest(session: Session) -> None:
    builder = MessageBuilder(session, 1)
    before = Decoded(builder.frame_error())
    assert (before.head["labels"], before.rest) == ([], b"")
    errors = np.linspace(0, 0.004, 72)
    session.draw_list.errors, session.draw_list.error_frame = errors, 61
    message = Decoded(builder.frame_error())
    assert message.head["labels"] == ["5mm", "2.5mm", "0"]
    assert message.head["frame"] == 61
    shares = message.take("u1", 72)
    np.testing.assert_allclose(shares / 255 * 0.005, errors, atol=0.005 / 255)
    assert message.rest == b""
