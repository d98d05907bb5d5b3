"""Screenshots and clips of a session, and the recordings beside them. No display: another process draws the clips."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from taichi_cloth.record import recorded
from taichi_cloth.record.recording import Recording, read_recording
from taichi_cloth.scene import Scene
from taichi_cloth.scene.model import Camera, Cloth, Fabric, Solver, Wind
from taichi_cloth.solvers.spring import Spring
from taichi_cloth.view import keepsakes
from taichi_cloth.view.portrait import portrait
from taichi_cloth.view.raster import Raster
from taichi_cloth.view.rerun import Rerun
from taichi_cloth.view.session import Session

pytestmark = pytest.mark.usefixtures("on_lists")

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
    session.point(cursor, frozenset(buttons), SIZE, on_panel=False, widget_changed=False)


def play(session: Session) -> None:
    """Pulls, looks round, changes what can be changed; at other rates than the display's."""
    session.advance(2)
    for k in range(4):
        point(session, (0.5 + 0.05 * k, 0.5), "left")
        assert session.simulation.grabbed is not None
        session.advance(1 + k % 2)
    point(session, (0.7, 0.5))
    session.act("solver")
    session.simulation.set("gravity", 5.0)
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


def repeated(recording: Recording, then: Callable[[Rerun], None] = lambda rerun: None) -> Rerun:
    with closing(Rerun(recording)) as rerun:
        while not rerun.over:
            rerun.forward()
        then(rerun)
    return rerun


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB"))


def test_a_screenshot_is_the_last_picture_of_its_recording(session: Session) -> None:
    play(session)
    session.camera.shift = 0.3  # the panel is to be seen in the window, and not in the picture
    session.act("screenshot")
    assert session.note == str(Path("wrote out/small/shot_001.png"))
    assert sorted(path.name for path in OUT.iterdir()) == ["shot_001.png", "shot_001.toml"]
    recording = read_recording(OUT / "shot_001.toml")
    assert recording.size == SIZE
    assert recording.frames == session.simulation.frame == 12

    def look(rerun: Rerun) -> None:
        picture = portrait(Raster(*SIZE), rerun.draw_list, rerun.camera, rerun.view)
        assert (picture == pixels(OUT / "shot_001.png")).all()
        assert rerun.view == session.view == "strain"
        assert rerun.simulation.frame == 12

    assert repeated(recording, look).is_equal


def test_nothing_is_written_over(session: Session) -> None:
    OUT.mkdir(parents=True)
    (OUT / "shot_001.jpg").write_text("older")
    (OUT / "shot_002").mkdir()
    session.act("screenshot")
    session.act("screenshot")
    found = sorted(path.name for path in OUT.iterdir())
    assert found == ["shot_001.jpg", "shot_002", *(f"shot_00{k}.{kind}" for k in (3, 4) for kind in ("png", "toml"))]
    assert (OUT / "shot_001.jpg").read_text() == "older"


def test_a_clip_is_drawn_beside_its_recording_by_another_process(session: Session) -> None:
    play(session)
    session.act("clip")
    assert session.note == "a clip is on: C ends it"
    play(session)
    session.act("clip")
    film = OUT / "clip_001.mp4"
    assert session.note == f"drawing {film}"
    play(session)  # meanwhile
    assert session.finish() == f"wrote {film}"
    recording = read_recording(OUT / "clip_001.toml")
    assert (recording.first_frame, recording.frames) == (12, 12)
    assert imageio_ffmpeg.count_frames_and_secs(str(film))[0] == 13  # with the first
    assert repeated(recording).is_equal
    assert sorted(path.name for path in OUT.iterdir()) == ["clip_001.mp4", "clip_001.toml"]


def test_a_clip_in_which_nothing_moves_is_none(session: Session) -> None:
    session.act("clip")
    session.act("clip")
    assert session.note == "no clip: nothing moved"
    assert not OUT.exists()
    assert session.finish() == ""


@pytest.fixture
def no_child(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """What would be started."""
    started: list[list[str]] = []

    def popen(words: list[object], **options: object) -> object:
        started.append([str(word) for word in words])
        raise OSError(11, "no more processes")

    monkeypatch.setattr(keepsakes, "subprocess", SimpleNamespace(Popen=popen, DEVNULL=None, PIPE=None, STDOUT=None))
    return started


def test_another_scene_ends_the_clip(session: Session, no_child: list[list[str]]) -> None:
    session.act("clip")
    session.advance(1)
    session.act("next_scene")
    assert session.simulation.scene.name != "small"
    assert not session.keepsakes.clip_is_on
    assert session.note == "no clip: no more processes"
    assert [path.name for path in OUT.iterdir()] == ["clip_001.toml"]  # it can still be drawn


@pytest.mark.parametrize(
    ("kinds", "words"),
    [([".mp4", ".webp"], ["--video", "clip_001.mp4"]), ([".webp"], ["--video", "clip_001.webp"]), ([], ["--headless"])],
)
def test_a_clip_is_the_best_film_that_can_be_made(
    session: Session, no_child: list[list[str]], monkeypatch: pytest.MonkeyPatch, kinds: list[str], words: list[str]
) -> None:
    monkeypatch.setattr(keepsakes, "kinds", lambda: kinds)
    session.act("clip")
    session.advance(1)
    session.act("clip")
    [command] = no_child
    k = command.index(words[0])
    assert [Path(word).name for word in command[k : k + len(words)]] == words


def test_what_cannot_be_written_is_told_and_the_session_goes_on(session: Session) -> None:
    Path("out").write_text("in the way")
    session.act("screenshot")
    assert session.note.startswith("no screenshot: ")
    session.act("clip")
    session.advance(2)
    session.act("clip")
    assert session.note.startswith("no clip: ")
    session.advance(1)
    assert session.simulation.frame == 3


def test_a_long_session_is_recorded_anew_and_still_repeated(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorded, "LONG", 20)
    play(session)
    play(session)
    assert session.simulation.take.first_frame > 0
    session.act("screenshot")
    recording = read_recording(OUT / "shot_001.toml")
    assert recording.first_frame + recording.frames == session.simulation.frame
    assert repeated(recording).is_equal


def test_a_blow_up_and_what_follows_are_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Spring, "least_substeps", lambda self, damping_time: 2)
    stiff = Scene(
        name="small", cloth=SMALL.cloth, solver=Solver(name="spring", substeps=2), fabric=Fabric(warp=5e4, weft=5e4)
    )
    with closing(Session(stiff)) as session:
        point(session, (0.5, 0.5), "left")
        for _ in range(60):
            session.advance(1)
        assert "blew up" in session.note
        session.simulation.set("substeps", 40)
        session.act("freeze")
        session.advance(3)
        session.act("screenshot")
        end = session.simulation.frame
    rerun = repeated(read_recording(OUT / "shot_001.toml"))
    assert rerun.is_equal
    assert rerun.simulation.frame == end
    assert rerun.repeated > end  # the frame that blew up, too


# -- looking on ------------------------------------------------------------------------------------------------


@pytest.fixture
def rerun(session: Session) -> Iterator[Rerun]:
    play(session)
    session.act("screenshot")
    with closing(Rerun(read_recording(OUT / "shot_001.toml"))) as rerun:
        yield rerun


def test_the_user_may_look_on_and_cannot_disturb(rerun: Rerun) -> None:
    for action in ("reset", "solver", "wind", "next_scene", "hide", "clip"):
        rerun.act(action)
    point(rerun, (0.5, 0.5), "left")
    point(rerun, (0.5, 0.5), "left", "right")
    point(rerun, (0.4, 0.4), "right")
    rerun.act("freeze")
    rerun.advance(4)
    assert rerun.repeated == 0
    rerun.act("step")
    assert rerun.repeated == 1
    rerun.act("freeze")
    assert rerun.verdict == "ended after 1 of 12 frames: nothing to compare"
    rerun.advance(6)
    rerun.advance(60)
    assert (rerun.over, rerun.frozen, rerun.is_equal) == (True, True, True)
    assert rerun.note == rerun.verdict == "12 frames repeated: the same to the last bit"


def test_from_its_end_on_it_is_the_users(rerun: Rerun) -> None:
    rerun.advance(12)
    assert rerun.over
    assert not rerun.hidden
    rerun.act("freeze")
    rerun.simulation.set("gravity", 1.0)
    rerun.advance(2)
    assert rerun.simulation.frame == 14
    rerun.act("screenshot")  # and the whole is one recording again
    recording = read_recording(OUT / "shot_002.toml")
    assert recording.frames == 14
    assert repeated(recording).is_equal
