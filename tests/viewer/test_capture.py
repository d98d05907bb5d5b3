"""Screenshots and clips of a session, and their recordings. No display: another process renders the clips."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from taichi_cloth.render.image import RenderPlan, render_pixels
from taichi_cloth.render.rasterizer import Rasterizer
from taichi_cloth.scene import Scene
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Camera, Cloth, Solver, Wind
from taichi_cloth.simulation import recording as recording_module
from taichi_cloth.simulation.copies import FrameErrorMeter
from taichi_cloth.simulation.recording import Recording, read_recording
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers.explicit import Explicit
from taichi_cloth.system.errors import install_command
from taichi_cloth.viewer import capture
from taichi_cloth.viewer.charts import statistics
from taichi_cloth.viewer.replay import ReplaySession, session_images
from taichi_cloth.viewer.session import Session

pytestmark = pytest.mark.usefixtures("serial_layout")

SMALL = Scene(
    name="small",
    cloth=Cloth(rows=5, columns=6, width=1.0, height=1.0, center=(0.0, 1.0, 0.0)),
    solver=Solver(substeps=3, iterations=4),
    wind=Wind(z=1.0),
    camera=Camera(eye=(0.0, 1.0, 4.0), target=(0.0, 1.0, 0.0)),
)
SIZE = (96, 64)
OUT = Path("out/small")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def session() -> Iterator[Session]:
    with closing(Session(SMALL)) as session:
        session.size = SIZE
        yield session


def point(session: Session, cursor: tuple[float, float], *buttons: str) -> None:
    session.on_pointer(cursor, frozenset(buttons), SIZE, on_panel=False, widget_changed=False)


def play(session: Session) -> None:
    """Drag, orbit, and change settings, with different numbers of frames per displayed frame."""
    session.advance(2)
    for k in range(4):
        point(session, (0.5 + 0.05 * k, 0.5), "left")
        assert len(session.simulation.grabbed) > 0
        session.advance(1 + k % 2)
    point(session, (0.7, 0.5))
    session.act("solver")
    session.simulation.params["gravity"] = 5.0
    session.advance(1)
    session.act("freeze")
    session.advance(3)
    session.act("step")
    session.act("view")
    session.act("wind")
    session.act("freeze")
    point(session, (0.7, 0.5), "right")
    point(session, (0.6, 0.4), "right")
    point(session, (0.6, 0.4))
    session.advance(2)


def replayed(recording: Recording, then: Callable[[ReplaySession], None] = lambda replay: None) -> ReplaySession:
    with closing(ReplaySession(recording)) as replay:
        while not replay.is_over:
            replay.replay_frame()
        then(replay)
    return replay


def test_the_result_of_a_replay_stays_while_it_is_replayed_again(session: Session) -> None:
    play(session)
    session.act("screenshot")
    verdicts: list[tuple[str, bool | None]] = []

    def again(replay: ReplaySession) -> None:
        replay.act("reset")
        replay.run_deferred()
        replay.replay_frame()
        verdicts.append((replay.verdict, replay.is_equal))

    replay = replayed(read_recording(OUT / "shot_001.toml"), again)
    assert replay.was_equal is True
    assert verdicts == [(f"{replay.recording.frames} frames replayed: final positions are bit-identical", None)]


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def test_a_screenshot_is_the_last_image_of_its_recording(session: Session) -> None:
    play(session)
    session.camera.view_shift = 0.3  # makes room for the panel in the window, but not in the image
    session.act("screenshot")
    assert session.note == str(Path("wrote out/small/shot_001.png")) + " and its recording, shot_001.toml"
    assert sorted(path.name for path in OUT.iterdir()) == ["shot_001.png", "shot_001.toml"]
    recording = read_recording(OUT / "shot_001.toml")
    assert recording.size == SIZE
    assert recording.frames == session.simulation.frame == 12

    def look(replay: ReplaySession) -> None:
        image = render_pixels(Rasterizer(*SIZE), replay.draw_list, replay.camera, replay.view)
        assert (image == pixels(OUT / "shot_001.png")).all()
        assert replay.view == session.view == "strain"
        assert replay.simulation.frame == 12

    assert replayed(recording, look).is_equal


def test_existing_files_are_not_overwritten(session: Session) -> None:
    OUT.mkdir(parents=True)
    (OUT / "shot_001.jpg").write_text("older")
    (OUT / "shot_002").mkdir()
    session.act("screenshot")
    session.act("screenshot")
    found = sorted(path.name for path in OUT.iterdir())
    assert found == ["shot_001.jpg", "shot_002", *(f"shot_00{k}.{kind}" for k in (3, 4) for kind in ("png", "toml"))]
    assert (OUT / "shot_001.jpg").read_text() == "older"


def test_another_process_renders_a_clip_beside_its_recording(
    session: Session, capsys: pytest.CaptureFixture[str]
) -> None:
    play(session)
    session.act("clip")
    assert session.note == "recording a clip: press C to stop"
    play(session)
    session.act("clip")
    video = OUT / "clip_001.mp4"
    assert session.note == f"rendering {video}"
    play(session)  # while it is rendered
    assert session.finish() == f"wrote {video}"
    assert capsys.readouterr().out in ("", f"rendering {video}, 13 images; Ctrl-C stops it\n")  # or it was done
    recording = read_recording(OUT / "clip_001.toml")
    assert (recording.first_frame, recording.frames) == (12, 12)
    assert imageio_ffmpeg.count_frames_and_secs(str(video))[0] == 13  # including the first
    assert replayed(recording).is_equal
    assert sorted(path.name for path in OUT.iterdir()) == ["clip_001.mp4", "clip_001.toml"]


def test_images_of_a_clip_in_the_view_error_have_its_colors(session: Session) -> None:
    session.view = "error"
    session.advance(2)
    session.restart_recording()
    session.advance(3)
    colors: list[Any] = []
    assert replay_of(session, lambda replay: colors.append(replay.draw_list.errors)).is_equal
    assert colors[0] is None  # the first image is the start of the clip
    with Simulation(SMALL) as alone, closing(FrameErrorMeter(SMALL)) as meter:
        alone.step(2)
        for errors in colors[1:]:
            np.testing.assert_allclose(errors, meter.measure_frame(alone).by_particle, rtol=1e-3)


def test_errors_that_cannot_be_measured_are_told_and_leave_the_cloth_plain(
    session: Session, capsys: pytest.CaptureFixture[str]
) -> None:
    light = replace(SMALL.cloth, width=0.2, area_density=1e-3)
    session.simulation.switch_scene(replace(SMALL, cloth=light, fabric=Fabric(warp=1e9, weft=1e9)))
    session.view = "error"
    session.advance(2)
    colors: list[Any] = []
    replay_of(session, lambda replay: colors.append(replay.draw_list.errors))
    assert colors == [None] * 3
    assert capsys.readouterr().err.startswith("error of a frame: not measured: small: explicit needs ")


def replay_of(session: Session, on_image: Callable[[ReplaySession], None]) -> ReplaySession:
    """Render the recording of a session, and call `on_image` after every image."""
    session.act("screenshot")
    recording = read_recording(OUT / "shot_001.toml")
    plan = RenderPlan(OUT, recording.frames + 1, width=SIZE[0], height=SIZE[1])
    with closing(ReplaySession(recording)) as replay:
        session_images(replay, plan, lambda image: on_image(replay), lambda frame: None)
    return replay


def test_a_replay_names_the_fabric_in_use(session: Session) -> None:
    session.change_fabric("denim")
    session.restart_recording()
    session.advance(1)
    session.change_fabric("silk")
    session.advance(1)
    names: list[tuple[str, str]] = []

    def look(replay: ReplaySession) -> None:
        names.append((replay.fabric, statistics(replay, {"drawing": 1.0}, 60.0).splitlines()[0]))

    replay_of(session, look)
    assert names[0] == ("", "small · verlet 3×4 · denim · shaded")  # that of the recorded scene
    assert names[-1] == ("silk", "small · verlet 3×4 · silk · shaded")


def test_a_clip_without_a_video_format_says_how_to_get_one(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture, "available_formats", list)
    session.act("clip")
    session.advance(1)
    session.act("clip")
    assert session.finish() == f"wrote {OUT / 'clip_001'}, as images; for a video: {install_command('video')}"
    assert len(list((OUT / "clip_001").glob("*.png"))) == 2


def test_a_clip_without_frames_is_not_written(session: Session) -> None:
    session.act("clip")
    session.act("clip")
    assert session.note == "no clip written: it has no frames"
    assert not OUT.exists()
    assert session.finish() == ""


@pytest.fixture
def failing_popen(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Make `Popen` fail. Return the commands that it was called with."""
    started: list[list[str]] = []

    def popen(arguments: list[object], **options: object) -> object:
        started.append([str(argument) for argument in arguments])
        raise OSError(11, "no more processes")

    monkeypatch.setattr(capture, "subprocess", SimpleNamespace(Popen=popen, DEVNULL=None, PIPE=None, STDOUT=None))
    return started


def test_opening_another_scene_ends_the_clip(session: Session, failing_popen: list[list[str]]) -> None:
    session.act("clip")
    session.advance(1)
    session.act("next_scene")
    assert session.simulation.scene.name != "small"
    assert not session.capture.clip_is_on
    assert session.note == "clip failed: no more processes"
    assert [path.name for path in OUT.iterdir()] == ["clip_001.toml"]  # it can still be rendered


@pytest.mark.parametrize(
    ("formats", "arguments"),
    [([".mp4", ".webp"], ["--video", "clip_001.mp4"]), ([".webp"], ["--video", "clip_001.webp"]), ([], ["--headless"])],
)
def test_a_clip_has_the_best_available_video_format(
    session: Session,
    failing_popen: list[list[str]],
    monkeypatch: pytest.MonkeyPatch,
    formats: list[str],
    arguments: list[str],
) -> None:
    monkeypatch.setattr(capture, "available_formats", lambda: formats)
    session.act("clip")
    session.advance(1)
    session.act("clip")
    [command] = failing_popen
    k = command.index(arguments[0])
    assert [Path(argument).name for argument in command[k : k + len(arguments)]] == arguments


def test_write_errors_are_reported_and_the_session_continues(session: Session) -> None:
    Path("out").write_text("in the way")
    session.act("screenshot")
    assert session.note.startswith("screenshot failed: ")
    session.act("clip")
    session.advance(2)
    session.act("clip")
    assert session.note.startswith("clip failed: ")
    session.advance(1)
    assert session.simulation.frame == 3


def test_a_long_recording_restarts_and_can_still_be_replayed(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording_module, "LONG", 20)
    play(session)
    play(session)
    assert session.recorder.first_frame > 0
    session.act("screenshot")
    recording = read_recording(OUT / "shot_001.toml")
    assert recording.first_frame + recording.frames == session.simulation.frame
    assert replayed(recording).is_equal


def test_divergence_and_the_frames_after_it_are_replayed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Explicit, "min_stable_substeps", lambda self, damping_time: 2)
    stiff = Scene(
        name="small", cloth=SMALL.cloth, solver=Solver(name="explicit", substeps=2), fabric=Fabric(warp=5e4, weft=5e4)
    )
    with closing(Session(stiff)) as session:
        point(session, (0.5, 0.5), "left")
        for _ in range(60):
            session.advance(1)
        assert "blew up" in session.note
        session.simulation.params["substeps"] = 40
        session.act("freeze")
        session.advance(3)
        session.act("screenshot")
        end = session.simulation.frame
    replay = replayed(read_recording(OUT / "shot_001.toml"))
    assert replay.is_equal
    assert replay.simulation.frame == end
    assert replay.frames_replayed > end  # including the frame that diverged


# -- replay ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def replay(session: Session) -> Iterator[ReplaySession]:
    play(session)
    session.act("screenshot")
    with closing(ReplaySession(read_recording(OUT / "shot_001.toml"))) as replay:
        yield replay


def test_during_replay_only_the_view_can_be_changed(replay: ReplaySession) -> None:
    for action in ("reset", "solver", "wind", "next_scene", "hide", "clip"):
        replay.act(action)
    point(replay, (0.5, 0.5), "left")
    point(replay, (0.5, 0.5), "left", "right")
    point(replay, (0.4, 0.4), "right")
    replay.act("freeze")
    replay.advance(4)
    assert replay.frames_replayed == 0
    replay.act("step")
    assert replay.frames_replayed == 1
    replay.act("freeze")
    assert replay.verdict == "stopped after 1 of 12 frames: final positions not compared"
    replay.advance(6)
    replay.advance(60)
    assert (replay.is_over, replay.frozen, replay.is_equal) == (True, True, True)
    assert replay.verdict == "12 frames replayed: final positions are bit-identical"
    assert replay.note == f"{replay.verdict}; R replays again"


def test_after_the_replay_the_user_controls_the_session(replay: ReplaySession) -> None:
    replay.advance(12)
    assert replay.is_over
    assert not replay.hidden
    replay.act("freeze")
    replay.simulation.params["gravity"] = 1.0
    replay.advance(2)
    assert replay.simulation.frame == 14
    replay.act("screenshot")  # all frames are one recording again
    recording = read_recording(OUT / "shot_002.toml")
    assert recording.frames == 14
    assert replayed(recording).is_equal
