"""Session, panel, recording, rewind, frame error, moved colliders, `compare` and web pages in the default layout.

Most tests of these use the serial layout, which compiles faster (`serial_layout`). Each test here repeats one of them
in the layout that the program selects itself.
"""

from __future__ import annotations

import base64
import json
import re
import zlib
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taichi_cloth.__main__ import main
from taichi_cloth.evaluation.bench import scene_error
from taichi_cloth.export.clip import export
from taichi_cloth.export.output import Output
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.kernels.tensor_fields import simd_available
from taichi_cloth.scene import Scene
from taichi_cloth.scene.schema import FRAME_SECONDS
from taichi_cloth.simulation.copies import FrameErrorMeter
from taichi_cloth.simulation.recording import Recorder, read_recording
from taichi_cloth.simulation.rollback import REWIND_EVERY, RewindBuffer
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.viewer.charts import statistics
from taichi_cloth.viewer.panel import Panel
from taichi_cloth.viewer.replay import ReplaySession
from taichi_cloth.viewer.session import Session

SIZE = (1280, 720)
ROWS, COLUMNS = 8, 9
FREE = ROWS * COLUMNS - 2  # an unpinned particle at the lower right


@pytest.fixture
def scene() -> Scene:
    return load_scene("curtain", rows=ROWS, columns=COLUMNS)


def default_layout() -> str:
    """Return the layout of a grid with nine columns if none is requested."""
    return "simd" if simd_available() else "serial"


def has_default_layout(simulation: Simulation) -> bool:
    return simulation.solver.layout_name == default_layout()


def serial_positions(scene: Scene, frames: int) -> np.ndarray:
    """Return the positions after some frames in the serial layout."""
    with Simulation(scene, "serial") as simulation:
        for _ in range(frames):
            simulation.step()
        return simulation.positions()


def test_a_session_grabs_and_releases_a_particle(scene: Scene, tmp_path: Path) -> None:
    with closing(Session(scene, out=tmp_path)) as session:
        simulation = session.simulation
        assert has_default_layout(simulation)
        session.advance(5)
        np.testing.assert_allclose(simulation.positions(), serial_positions(scene, 5), atol=1e-4)
        u, v = session.camera.to_screen(simulation.positions()[FREE], SIZE[0] / SIZE[1])[0][0]
        idle: dict[str, Any] = {"on_panel": False, "widget_changed": False}
        session.on_pointer((float(u), float(v)), frozenset({"left"}), SIZE, **idle)
        [grabbed] = simulation.grabbed
        before = simulation.positions()[grabbed]
        session.on_pointer((float(u) + 0.05, float(v)), frozenset({"left"}), SIZE, **idle)
        session.advance(1)
        assert np.linalg.norm(simulation.positions()[grabbed] - before) > 0.01
        session.on_pointer((float(u), float(v)), frozenset(), SIZE, **idle)
        assert len(simulation.grabbed) == 0
        session.act("reset")
        assert simulation.frame == 0


class FakeGui:
    """A toolkit that moves one slider and changes nothing else."""

    def __init__(self, slider: str, value: float) -> None:
        self.slider, self.value = slider, value

    @contextmanager
    def sub_window(self, name: str, *rect: float) -> Iterator[None]:
        yield

    def slider_float(self, label: str, value: float, low: float, high: float) -> float:
        return self.value if label.split()[0] == self.slider else value

    def slider_int(self, label: str, value: int, low: int, high: int) -> int:
        return value

    def checkbox(self, label: str, value: bool) -> bool:
        return value

    def button(self, label: str) -> bool:
        return False

    def text(self, text: str, color: Any = None) -> None:
        pass


def test_a_slider_of_the_panel_changes_the_motion(scene: Scene, tmp_path: Path) -> None:
    heights = []
    for gravity in (0.0, 20.0):
        with closing(Session(scene, out=tmp_path)) as session:
            assert has_default_layout(session.simulation)
            gui = FakeGui("Gravity", gravity)
            assert Panel(SIZE, tmp_path / "imgui.ini").draw(gui, session, statistics(session, {"drawing": 12.3}, 59.9))
            session.run_deferred()
            assert session.simulation.params["gravity"] == gravity
            session.advance(10)
            heights.append(float(session.simulation.positions()[:, 1].mean()))
    assert heights[1] < heights[0]  # they would be equal to the last bit if the slider had no effect


def test_a_recording_is_replayed_bit_for_bit(scene: Scene, tmp_path: Path) -> None:
    with Simulation(scene) as simulation:
        assert has_default_layout(simulation)
        recorder = Recorder(simulation)
        grab = simulation.grab(FREE)
        for k in range(8):
            grab.move_to(simulation.topology.start[FREE] + [0.0, 0.0, 0.02 * k])
            simulation.step()
        grab.release()
        simulation.params["gravity"] = 4.1
        for _ in range(4):
            simulation.step()
        recorder.save(tmp_path / "done.toml", SIZE)
        end = simulation.positions()
    with closing(ReplaySession(read_recording(tmp_path / "done.toml"))) as session:
        assert has_default_layout(session.simulation)
        while not session.is_over:
            session.replay_frame()
        assert session.is_equal
        np.testing.assert_array_equal(session.simulation.positions(), end)


@pytest.mark.usefixtures("running")
def test_two_runs_are_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_error, "FRAMES", 15)
    out = tmp_path / "out"
    small = ["--set", f"rows={ROWS},columns={COLUMNS}", "--size", "202x60", "--frames", "6", "--every", "5"]
    assert main(["compare", "curtain", *small, "--out", str(out), "--b", "iterations=1"]) == 0
    report = json.loads((out / "compare.json").read_text(encoding="utf-8"))
    assert [report[name]["method"].split(" · ")[-1] for name in "ab"] == [default_layout()] * 2
    assert len(report["rms_distance"]) == 6
    assert 0 < report["rms_distance"][-1] < 0.1
    assert sorted(file.name for file in out.glob("*.png")) == ["frame_00000.png", "frame_00001.png"]


def test_a_page_has_the_positions_of_the_simulation(scene: Scene, tmp_path: Path) -> None:
    """They are equal to half a step of 16 bits."""
    clip, frames = [], 6
    with Simulation(scene) as simulation:
        assert has_default_layout(simulation)
        export(simulation, Output(tmp_path / "c.html", "html", frames, clip=True), lambda k: None)
        simulation.reset()
        for _ in range(frames):
            clip.append(simulation.positions())
            simulation.step()
    page = (tmp_path / "c.html").read_text(encoding="utf-8")
    parts = [re.search(rf'id="{name}">(.*?)</script>', page, re.DOTALL) for name in ("head", "data")]
    head_text, data_text = (part[1] for part in parts if part is not None)
    head = json.loads(head_text)
    shape = head["samples"], head["particles"], 3
    # Vertices, poses and corners of colliders come first, then particles and triangles of the cloth, then positions.
    before = 24 * head["solidVertices"] + 64 * head["poses"] + 4 * head["solidCorners"]
    before += 4 * head["vertices"] + 12 * head["triangles"]
    data = zlib.decompress(base64.b64decode(data_text))
    steps = np.frombuffer(data, "<u2", int(np.prod(shape)), before).reshape(shape)
    for _ in range(2):
        steps = np.cumsum(steps, axis=0, dtype=np.uint16)
    x = np.array(head["low"]) + np.array(head["step"]) * steps
    assert (np.abs(x - clip) <= 0.5 * np.ptp(np.array(clip), axis=(0, 1)) / 65535 + 1e-12).all()


def test_rewind_goes_on_with_the_same_bits(scene: Scene) -> None:
    with Simulation(scene) as simulation:
        assert has_default_layout(simulation)
        rewind = RewindBuffer(simulation)
        for _ in range(4 * REWIND_EVERY):
            simulation.step()
            rewind.add()
        end = simulation.positions()
        rewind.go_back(2 * REWIND_EVERY * FRAME_SECONDS)
        assert simulation.frame == 2 * REWIND_EVERY
        simulation.step(2 * REWIND_EVERY)
        np.testing.assert_array_equal(simulation.positions(), end)


def test_the_error_of_a_frame_is_measured_and_changes_no_bit(scene: Scene) -> None:
    with Simulation(scene) as simulation, Simulation(scene) as other, closing(FrameErrorMeter(scene)) as meter:
        assert has_default_layout(simulation)
        for _ in range(4):
            found = meter.measure_frame(simulation)
            other.step()
        np.testing.assert_array_equal(simulation.positions(), other.positions())
        assert found.reference_has_converged
        assert 0.0 < found.error < found.motion


def test_a_moved_ball_pushes_the_cloth(scene: Scene) -> None:
    with Simulation(scene) as simulation, Simulation(scene, "serial") as serial:
        assert has_default_layout(simulation)
        path = [np.array([0.0, 1.8, 1.5 - 0.1 * k]) for k in range(15)]
        for one in (simulation, serial):
            for center in path:
                one.move_collider(0, center)
                one.step()
        np.testing.assert_allclose(simulation.colliders()[0].center, path[-1], atol=1e-9)
        np.testing.assert_allclose(simulation.positions(), serial.positions(), atol=1e-3)
        assert np.abs(simulation.positions() - serial_positions(scene, len(path))).max() > 0.1
