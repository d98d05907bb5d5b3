"""Session, panel, recording, compare and web pages on the path that users get.

Most tests of what is above the solvers take the list of springs, which compiles faster (`on_lists`). Each of these does
the same once on the path that the program takes by itself.
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

from taichi_cloth.accuracy import gallery
from taichi_cloth.cli import main
from taichi_cloth.export.clip import export
from taichi_cloth.export.output import Output
from taichi_cloth.kernels.probe_simd import simd_works
from taichi_cloth.record.recorded import Recorded
from taichi_cloth.record.recording import Recording, read_recording
from taichi_cloth.scene import Scene, load_scene
from taichi_cloth.simulation import Simulation
from taichi_cloth.view.panel import Panel, numbers
from taichi_cloth.view.rerun import Rerun
from taichi_cloth.view.session import Session

SIZE = (1280, 720)
ROWS, COLUMNS = 8, 9
FREE = ROWS * COLUMNS - 2  # a particle low on the right, that is not pinned


@pytest.fixture
def scene() -> Scene:
    return load_scene("curtain", rows=ROWS, columns=COLUMNS)


def is_default(simulation: Simulation) -> bool:
    """Whether it is on the path of a grid of nine columns where nobody asks for one."""
    return simulation.solver.path == ("lanes" if simd_works() else "list")


def on_list(scene: Scene, frames: int) -> np.ndarray:
    """Where the cloth is after so many frames on the list of springs."""
    with Simulation(scene, "list") as simulation:
        for _ in range(frames):
            simulation.advance_frame()
        return simulation.positions()


def test_a_session_takes_a_particle_and_lets_go(scene: Scene, tmp_path: Path) -> None:
    with closing(Session(scene, out=tmp_path)) as session:
        simulation = session.simulation
        assert is_default(simulation)
        session.advance(5)
        np.testing.assert_allclose(simulation.positions(), on_list(scene, 5), atol=1e-4)
        u, v = session.camera.to_screen(simulation.positions()[FREE], SIZE[0] / SIZE[1])[0][0]
        idle: dict[str, Any] = {"on_panel": False, "widget_changed": False}
        session.point((float(u), float(v)), frozenset({"left"}), SIZE, **idle)
        held = simulation.grabbed
        assert held is not None
        before = simulation.positions()[held]
        session.point((float(u) + 0.05, float(v)), frozenset({"left"}), SIZE, **idle)
        session.advance(1)
        assert np.linalg.norm(simulation.positions()[held] - before) > 0.01
        session.point((float(u), float(v)), frozenset(), SIZE, **idle)
        assert simulation.grabbed is None
        session.act("reset")
        assert simulation.frame == 0


class Toolkit:
    """Moves one slider, and leaves all else as it is."""

    def __init__(self, slider: str, value: float) -> None:
        self.slider, self.value = slider, value

    @contextmanager
    def sub_window(self, name: str, *place: float) -> Iterator[None]:
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


def test_a_slider_of_the_panel_reaches_the_cloth(scene: Scene, tmp_path: Path) -> None:
    fallen = []
    for gravity in (0.0, 20.0):
        with closing(Session(scene, out=tmp_path)) as session:
            assert is_default(session.simulation)
            toolkit = Toolkit("Gravity", gravity)
            assert Panel(SIZE, tmp_path / "imgui.ini").draw(toolkit, session, numbers(session, 12.3, 59.9))
            session.do_asked()
            assert session.simulation.get("gravity") == gravity
            session.advance(10)
            fallen.append(float(session.simulation.positions()[:, 1].mean()))
    assert fallen[1] < fallen[0]  # to the last bit alike if the slider did not reach the cloth


def test_a_recording_is_repeated_to_the_last_bit(scene: Scene, tmp_path: Path) -> None:
    with Recorded(scene) as simulation:
        assert is_default(simulation)
        for k in range(8):
            simulation.grab(FREE, simulation.topology.start[FREE] + [0.0, 0.0, 0.02 * k])
            simulation.advance_frame()
        simulation.release()
        simulation.set("gravity", 4.1)
        for _ in range(4):
            simulation.advance_frame()
        Recording.of(simulation, SIZE).write(tmp_path / "done.toml")
        end = simulation.positions()
    with closing(Rerun(read_recording(tmp_path / "done.toml"))) as rerun:
        assert is_default(rerun.simulation)
        while not rerun.over:
            rerun.forward()
        assert rerun.is_equal
        np.testing.assert_array_equal(rerun.simulation.positions(), end)


@pytest.mark.usefixtures("running")
def test_two_runs_are_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gallery, "FRAMES", 15)
    out = tmp_path / "out"
    small = ["--set", f"rows={ROWS},columns={COLUMNS}", "--size", "202x60", "--frames", "6", "--every", "5"]
    assert main(["compare", "curtain", *small, "--out", str(out), "--b", "iterations=1"]) == 0
    told = json.loads((out / "compare.json").read_text(encoding="utf-8"))
    path = "lanes" if simd_works() else "list"
    assert [told[name]["method"].split(" · ")[-1] for name in "ab"] == [path, path]
    assert len(told["apart"]) == 6
    assert 0 < told["apart"][-1] < 0.1
    assert sorted(file.name for file in out.glob("*.png")) == ["frame_00000.png", "frame_00001.png"]


def test_a_page_holds_where_the_cloth_was(scene: Scene, tmp_path: Path) -> None:
    """Its places are those of the simulation to half a step of 16 bits."""
    clip, frames = [], 6
    with Simulation(scene) as simulation:
        assert is_default(simulation)
        export(simulation, Output(tmp_path / "c.html", "html", frames, clip=True), lambda k: None)
        simulation.reset()
        for _ in range(frames):
            clip.append(simulation.positions())
            simulation.advance_frame()
    page = (tmp_path / "c.html").read_text(encoding="utf-8")
    parts = [re.search(rf'id="{name}">(.*?)</script>', page, re.DOTALL) for name in ("head", "data")]
    head, data = (part[1] for part in parts if part is not None)
    told = json.loads(head)
    shape = told["samples"], told["particles"], 3
    # Before them are vertices, poses and corners of colliders, then the particles and triangles of the cloth.
    before = 24 * told["solidVertices"] + 64 * told["poses"] + 4 * told["solidCorners"]
    before += 4 * told["vertices"] + 12 * told["triangles"]
    steps = np.frombuffer(zlib.decompress(base64.b64decode(data)), "<u2", int(np.prod(shape)), before).reshape(shape)
    for _ in range(2):
        steps = np.cumsum(steps, axis=0, dtype=np.uint16)
    x = np.array(told["low"]) + np.array(told["step"]) * steps
    assert (np.abs(x - clip) <= 0.5 * np.ptp(np.array(clip), axis=(0, 1)) / 65535 + 1e-12).all()
