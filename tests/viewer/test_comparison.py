"""Two sessions side by side with shared input, without a display."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.simulation.copies import FrameError
from taichi_cloth.viewer import error_process
from taichi_cloth.viewer.comparison import Comparison
from taichi_cloth.viewer.comparison_window import ORDER_NOTE, VERLET_NOTE, apart, explanations, help_lines, statistics
from taichi_cloth.viewer.error_process import Answer, ErrorProcess, Job
from taichi_cloth.viewer.toolkit import Refusal

pytestmark = pytest.mark.usefixtures("serial_layout")

SIZE = (1200, 500)
ASPECT = SIZE[0] / 2 / SIZE[1]
SMALL = {"rows": 10, "columns": 11}


@pytest.fixture
def comparison(tmp_path: Path) -> Iterator[Comparison]:
    comparison = Comparison(
        load_scene("drape15", **SMALL), load_scene("drape15", iterations=40, **SMALL), ASPECT, tmp_path
    )
    yield comparison
    comparison.close()


def point(comparison: Comparison, cursor: tuple[float, float], *buttons: str) -> None:
    comparison.on_pointer(cursor, frozenset(buttons), SIZE, on_panel=False, widget_changed=False)


def cursor_on(comparison: Comparison, side: int, particle: int) -> tuple[float, float]:
    """Return the screen point, in both images together, of a particle of one side."""
    position = comparison.sides[side].simulation.positions()[particle]
    u, v = comparison.left.camera.to_screen(position, ASPECT)[0][0]
    return (float(u) + side) / 2, float(v)


@pytest.mark.parametrize("side", [0, 1])
def test_a_grab_on_one_side_is_mirrored_on_the_other(comparison: Comparison, side: int) -> None:
    here, there = (comparison.sides[k].simulation for k in (side, 1 - side))
    start = cursor_on(comparison, side, 60)
    point(comparison, start)
    point(comparison, start, "left")
    assert here.grabbed.tolist() == there.grabbed.tolist() == [60]
    point(comparison, (start[0] + 0.03, start[1] + 0.1), "left")
    comparison.advance(2)
    assert cursor_on(comparison, side, 60) == pytest.approx((start[0] + 0.03, start[1] + 0.1), abs=5e-3)
    np.testing.assert_allclose(there.positions()[60], here.positions()[60], atol=1e-6)
    point(comparison, (1.0 - side, 0.5), "left")  # the drag continues beyond the seam
    assert here.grabbed.tolist() == [60]
    point(comparison, (1.0 - side, 0.5))
    assert (len(here.grabbed), len(there.grabbed)) == (0, 0)


def test_a_ball_dragged_on_one_side_moves_on_the_other(tmp_path: Path) -> None:
    scenes = load_scene("curtain", **SMALL), load_scene("curtain", iterations=40, **SMALL)
    with closing(Comparison(*scenes, ASPECT, tmp_path)) as comparison:
        here, there = (side.simulation for side in comparison.sides)
        for simulation in (here, there):
            simulation.move_collider(0, (2.4, 1.0, 0.5))
        comparison.advance(1)
        (u, v), *_ = comparison.left.camera.to_screen(here.colliders()[0].center[None], ASPECT)[0]
        point(comparison, (u / 2, v))
        point(comparison, (u / 2, v), "left")
        point(comparison, (u / 2, v + 0.1), "left")
        comparison.advance(5)
        centers = [simulation.colliders()[0].center for simulation in (here, there)]
        assert centers[0][1] > 1.1
        assert centers[1] == pytest.approx(centers[0], abs=1e-9)


def test_both_sides_show_the_requested_view(tmp_path: Path) -> None:
    scenes = load_scene("drape15", **SMALL), load_scene("drape15", iterations=40, **SMALL)
    with closing(Comparison(*scenes, ASPECT, tmp_path, view="strain")) as comparison:
        assert [side.view for side in comparison.sides] == ["strain", "strain"]
        assert comparison.view == "strain"


def test_errors_are_measured_on_both_sides(comparison: Comparison) -> None:
    comparison.request("errors")
    assert all(side.meter for side in comparison.sides)
    assert sum("error of a frame: not measured yet" in line for line in statistics(comparison, 1.0)) == 2
    frame = comparison.left.simulation.frame
    assert any(line.startswith(f"frame {frame}: RMS distance ") for line in statistics(comparison, 1.0))
    comparison.act("errors")
    assert not any(side.meter for side in comparison.sides)


def test_shared_actions_affect_both_sides_and_the_solver_changes_on_one(comparison: Comparison) -> None:
    comparison.advance(3)
    assert [side.simulation.frame for side in comparison.sides] == [3, 3]
    assert comparison.rms_distance > 0  # 5 iterations and 40
    comparison.act("freeze")
    comparison.advance(3)
    comparison.act("step")
    assert [side.simulation.frame for side in comparison.sides] == [4, 4]
    comparison.set_parameter("gravity", 3.0)
    assert [side.simulation.params["gravity"] for side in comparison.sides] == [3.0, 3.0]
    point(comparison, (0.9, 0.9))
    comparison.act("solver")
    assert comparison.left.simulation.solver.name == "verlet"
    assert comparison.right.simulation.solver.name != "verlet"
    comparison.act("next_scene")  # not supported in a comparison: no effect
    comparison.act("reset")
    assert [(side.simulation.frame, side.simulation.scene.name) for side in comparison.sides] == [(0, "drape15")] * 2
    assert comparison.rms_distance < 1e-6
    assert comparison.left.camera is comparison.right.camera


def test_a_screenshot_has_both_sides(comparison: Comparison, tmp_path: Path) -> None:
    comparison.request("screenshot")  # nothing was drawn yet
    assert not list(tmp_path.iterdir())
    comparison.image = np.full((4, 6, 3), 7, np.uint8)
    for number in (1, 2):
        comparison.request("screenshot")
        file = tmp_path / "compare_drape15" / f"shot_00{number}.png"
        assert comparison.note == f"wrote {file.relative_to(tmp_path.parent)}"
        assert (np.asarray(Image.open(file)) == comparison.image).all()
    for path in (tmp_path / "compare_drape15").iterdir():
        path.unlink()
    (tmp_path / "compare_drape15").rmdir()
    (tmp_path / "compare_drape15").touch()  # no folder can have this name
    comparison.request("screenshot")
    assert comparison.note.startswith("screenshot failed: ")


@pytest.mark.parametrize(
    ("action", "line"),
    [
        ("clip", "C: start/stop clip: not in a comparison"),
        ("charts", "K: charts on/off: not in a comparison"),
    ],
)
def test_a_key_that_a_comparison_does_not_support_says_so(comparison: Comparison, action: str, line: str) -> None:
    comparison.request(action)
    assert comparison.note == line
    assert isinstance(comparison.note, Refusal)


def test_the_key_for_help_lists_the_keys_instead_of_statistics(comparison: Comparison) -> None:
    comparison.request("help")
    assert comparison.shows_keys
    assert {"  N      step one frame", "  T      next solver", "  S      take screenshot"} <= set(help_lines())
    comparison.request("help")
    assert not comparison.shows_keys
    comparison.request("help")
    comparison.request("quit")
    assert (comparison.shows_keys, comparison.running) == (False, True)
    comparison.request("quit")
    assert not comparison.running


def test_the_estimates_for_a_second_are_shown_and_explained(comparison: Comparison) -> None:
    """More iterations of `verlet` have the smaller error of a frame, and can be farther from the springs after 1 s."""
    assert explanations(comparison) == []
    comparison.request("errors")
    assert explanations(comparison) == []
    found = FrameError(7, 0.0017, 0.01, 1e-6, 0.0005, 0.0018, np.zeros(110), 0.01)
    for view in ("shaded", "error"):
        for side, error, growth in zip(comparison.sides, (0.0017, 0.0011), (0.011, 0.040), strict=True):
            assert side.meter is not None
            side.view, side.meter.answer = view, Answer(replace(found, error=error), growth)
        lines = [line.strip() for line in statistics(comparison, 1.0)]
        assert [line for line in lines if line.startswith("estimate")] == [
            "estimate for 1 s without input: 11 mm",
            "estimate for 1 s without input: 40 mm",
        ]
        assert "verlet: more iterations stretch the cloth less, and" in lines
    assert explanations(comparison) == [ORDER_NOTE, VERLET_NOTE]
    assert comparison.right.meter is not None
    comparison.right.meter.answer = Answer(replace(found, error=0.0011), 0.009)
    assert explanations(comparison) == [VERLET_NOTE]
    comparison.right.meter.answer = Answer(refusal="its reference diverges")
    assert explanations(comparison) == [VERLET_NOTE]
    comparison.left.change_solver("lines")
    comparison.right.change_solver("lines")
    assert explanations(comparison) == []


@pytest.mark.parametrize(("frames", "apart_by"), [((300, 360), ""), ((300, 361), "61"), ((2713, 157), "2556")])
def test_errors_of_distant_frames_are_not_compared_in_silence(
    comparison: Comparison, monkeypatch: pytest.MonkeyPatch, frames: tuple[int, int], apart_by: str
) -> None:
    assert apart(comparison) == ""  # nothing was measured
    for side, frame in zip(comparison.sides, frames, strict=True):
        side.meter = SimpleNamespace(error=SimpleNamespace(frame=frame), close=lambda: None)  # type: ignore[assignment]
    line = apart(comparison)
    assert line == (line and f"the errors are of frames {apart_by} apart")
    assert bool(line) == bool(apart_by)


class SlowMeter(ErrorProcess):
    """Takes some frames to measure one, without a process."""

    def __init__(self, frames: int) -> None:
        super().__init__()
        self.sent: list[int] = []
        self._takes, self._left = frames, 0

    def _send(self, job: Job) -> None:
        self.sent.append(job.start.frame)
        self._is_busy, self._left = True, self._takes

    def receive(self) -> None:
        self._left -= 1
        self._is_busy = self._left > 0


def test_errors_of_both_sides_are_of_the_same_frames(comparison: Comparison, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(error_process, "FRAMES_BEFORE", 2)
    monkeypatch.setattr(error_process, "SETTLED_SECONDS", 0.0)
    meters = [SlowMeter(frames) for frames in (3, 17)]
    for side, meter in zip(comparison.sides, meters, strict=True):
        side.meter = meter
    for frames in (1, 2, 3) * 10:
        comparison.advance(frames)
    assert len(meters[0].sent) > 2
    assert meters[0].sent == meters[1].sent


def test_a_side_that_cannot_be_measured_does_not_stop_the_other(
    comparison: Comparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(error_process, "FRAMES_BEFORE", 2)
    monkeypatch.setattr(error_process, "SETTLED_SECONDS", 0.0)
    left, right = (SlowMeter(1) for _ in range(2))
    comparison.left.meter, comparison.right.meter = left, right
    comparison.advance(2)
    right.answer = Answer(refusal="too stiff", is_final=True)
    for _ in range(6):
        comparison.advance(1)
    assert len(left.sent) >= 3
    assert right.sent == []


def test_divergence_on_one_side_freezes_both(comparison: Comparison) -> None:
    comparison.advance(1)
    comparison.right.simulation.cloth.x[0] = (np.nan, 0.0, 0.0)
    comparison.advance(1)
    assert comparison.left.frozen
    assert comparison.right.frozen
    assert "blew up" in comparison.note


def test_the_note_is_about_what_happened_last(comparison: Comparison) -> None:
    left, right = comparison.sides
    left.note = "wind off: G turns it on"
    right.simulation.cloth.x[0] = [np.nan] * 3
    comparison.advance(1)
    assert comparison.note.startswith("the cloth blew up")
    left.note = "an old note"
    comparison._active = right
    comparison.request("pin")
    assert comparison.note == "nothing to pin: no cloth under the cursor"


def test_other_grids_are_grabbed_at_the_same_point_of_the_sheet(tmp_path: Path) -> None:
    comparison = Comparison(
        load_scene("drape15", **SMALL), load_scene("drape15", rows=19, columns=21), ASPECT, tmp_path
    )
    start = cursor_on(comparison, 0, 60)
    point(comparison, start)
    point(comparison, start, "left")
    row, column = divmod(60, 11)
    assert comparison.right.simulation.grabbed.tolist() == [2 * row * 21 + 2 * column]
    comparison.close()
