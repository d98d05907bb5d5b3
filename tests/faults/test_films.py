"""Films and replays from the command line, with what may go wrong."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from taichi_cloth import cli
from taichi_cloth.guard import Guard
from taichi_cloth.record.recorded import Recorded
from taichi_cloth.record.recording import Recording
from taichi_cloth.scene import load_scene
from taichi_cloth.view import video
from taichi_cloth.view.video import film

pytestmark = pytest.mark.usefixtures("running")

SCENE = "[cloth]\nrows = 4\ncolumns = 5\n[solver]\nsubsteps = 2\niterations = 3\n[wind]\nz = 40.0\n"
RENDER = ("render", "small.toml", "--size", "64x48", "--samples", "1", "--frames", "7")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every test has a folder of its own, with a small scene in it."""
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(SCENE)


@pytest.fixture
def recording() -> Path:
    """Five frames, in two of which a particle is pulled, seen in two views."""
    path = Path("taken.toml")
    with Recorded(load_scene("small.toml")) as simulation:
        simulation.take.look("view", "strain")
        simulation.take.look("camera", 0.3, 0.2, 6.0, 0.0, 1.0, 0.0)
        for k in range(5):
            if k == 3:
                simulation.grab(19, (0.5, 0.5, 0.5))
                simulation.take.look("view", "particles")
            simulation.advance_frame()
        Recording.of(simulation, (66, 50)).write(path)
    return path


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Exit code, the last line printed, and all that is an error."""
    code = cli.main(list(words))
    said = capsys.readouterr()
    return code, (said.out.splitlines() or [""])[-1], said.err


# -- render --video --------------------------------------------------------------------------------------------


def test_a_scene_is_rendered_as_a_film(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, *RENDER, "--every", "2", "--video", "a.mp4") == (0, "4 pictures in a.mp4", "")
    assert imageio_ffmpeg.count_frames_and_secs("a.mp4")[0] == 4
    assert imageio_ffmpeg.count_frames_and_secs("a.mp4")[1] == pytest.approx(4 / 30, abs=0.006)
    assert not Path("out").exists()
    # the pictures are those of the PNG files, but for what a film loses
    assert run(capsys, *RENDER, "--every", "2", "--video", "a.webp")[0] == 0
    assert cli.main([*RENDER, "--every", "2", "--out", "o"]) == 0
    with Image.open("a.webp") as shown:
        assert shown.n_frames == 4
        for k in range(4):
            shown.seek(k)
            with Image.open(f"o/frame_{k:05d}.png") as picture:
                lost = np.asarray(shown.convert("RGB"), float) - np.asarray(picture, float)
            assert np.abs(lost).mean() < 4


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--video", "small.toml"], "small.toml: a film ends in .mp4 or .webp"),
        (["--video", "old.mp4"], "old.mp4 exists already: use --force to replace it"),
        (["--video", "gone/a.mp4"], "gone is no folder to write a.mp4 into"),
        (
            ["--video", "a.mp4", "--resume"],
            "--video writes one file: it goes without --out, --resume and --contact-sheet",
        ),
        (["--video", "a.mp4", "--size", "1x9"], "a.mp4: an .mp4 has at least 2x2 pixels"),
    ],
)
def test_what_cannot_be_filmed_is_one_line(capsys: pytest.CaptureFixture[str], more: list[str], said: str) -> None:
    Path("old.mp4").write_text("older")
    code, _, err = run(capsys, *RENDER, *more)
    assert (code, err) == (2, f"taichi-cloth: {said}\n")
    assert {path.name for path in Path().iterdir()} == {"small.toml", "old.mp4"}
    assert Path("old.mp4").read_text() == "older"


def test_without_ffmpeg_the_pip_command_is_told(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(video, "find_ffmpeg", lambda: None)
    code, _, err = run(capsys, *RENDER, "--video", "a.mp4")
    assert (code, err.count("\n")) == (2, 1)
    assert "a.mp4 needs ffmpeg: pip install 'taichi-cloth[video]', or name a .webp" in err


@pytest.mark.parametrize("kind", ["mp4", "webp"])
def test_a_full_disk_is_one_line(disk: Callable[..., Path], kind: str) -> None:
    folder = disk("small", "size=16k")
    random = np.random.default_rng(0)

    def fill() -> None:
        with film(folder / f"film.{kind}", (320, 240)) as show:
            for _ in range(10):
                show(random.integers(0, 255, (240, 320, 3), np.uint8))

    with pytest.raises(OSError, match=rf"No space left on device: '.*film\.{kind}'") as caught:
        fill()
    assert "\n" not in str(caught.value)
    assert list(folder.iterdir()) == []


def test_a_blow_up_ends_the_film_and_is_told(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = Guard.sound
    monkeypatch.setattr(Guard, "sound", lambda self: self._simulation.frame < 3 and real(self))
    code, last, err = run(capsys, *RENDER, "--video", "a.mp4")
    assert (code, last) == (1, "4 pictures in a.mp4")
    assert err.startswith("taichi-cloth: the cloth blew up in frame 3: ")
    assert err.endswith("; a.mp4 ends there\n")
    assert imageio_ffmpeg.count_frames_and_secs("a.mp4")[0] == 4


# -- replay ----------------------------------------------------------------------------------------------------


def test_a_recording_is_repeated_unseen_as_pictures_and_as_a_film(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    same = "taken.toml: 5 frames repeated: the same to the last bit"
    assert run(capsys, "replay", "taken.toml", "--check") == (0, same, "")
    assert {path.name for path in Path().iterdir()} == {"small.toml", "taken.toml"}
    assert run(capsys, "replay", "taken.toml", "--headless") == (0, same, "")
    pictures = sorted(Path("taken").iterdir())
    assert [path.name for path in pictures] == [f"frame_{k:05d}.png" for k in range(6)]
    with Image.open(pictures[0]) as picture:
        assert picture.size == (66, 50)
    assert run(capsys, "replay", "taken.toml", "--video", "a.mp4", "--size", "32x32", "--every", "5") == (0, same, "")
    assert imageio_ffmpeg.count_frames_and_secs("a.mp4")[0] == 2


def test_another_end_is_exit_code_1(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording.write_text(recording.read_text().replace("19, 0.5", "19, 0.25"))
    line = "taken.toml: 5 frames repeated: NOT the same, the positions at the end differ"
    assert run(capsys, "replay", "taken.toml", "--check") == (1, line, "")


def test_another_version_is_a_warning(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording.write_text(recording.read_text().replace('taichi = "', 'taichi = "0.'))
    code, _, err = run(capsys, "replay", "taken.toml", "--check")
    assert code == 0
    assert err.startswith("taken.toml: recorded with taichi 0.")
    assert err.endswith(": the last bits may differ\n")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("[recording]", "[rec]"), "taken.toml: not a recording: it has no [recording]"),
        (('"grab", 19', '"grab", 77'), "taken.toml: rows[2]: grab: particle 77 does not exist"),
        (('arch = "cpu"', 'arch = "abacus"'), "taken.toml: there is no arch 'abacus': cpu, "),
        (("rows = 4", "rows = 4000000"), "taken.toml: scene: cloth.rows: "),
        (("[scene]", "\0"), "taken.toml: not a recording: "),
    ],
)
def test_a_bad_recording_is_one_line(
    recording: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], said: str
) -> None:
    recording.write_text(recording.read_text().replace(*change, 1))
    code, _, err = run(capsys, "replay", "taken.toml", "--headless")
    assert code == 2
    assert err.startswith(f"taichi-cloth: {said}")
    assert err.count("\n") == 1


def test_pictures_that_are_there_stay_without_force(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("taken").mkdir()
    Path("taken/frame_00000.png").write_text("older")
    code, _, err = run(capsys, "replay", "taken.toml", "--headless")
    assert (code, err.count("\n")) == (2, 1)
    assert Path("taken/frame_00000.png").read_text() == "older"
    assert run(capsys, "replay", "taken.toml", "--headless", "--force")[0] == 0
    assert len(list(Path("taken").iterdir())) == 6


def test_a_missing_file_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = run(capsys, "replay", "gone.toml")
    assert (code, err) == (2, "taichi-cloth: gone.toml: cannot be read: No such file or directory\n")


def test_an_interrupt_leaves_no_film(folder: None) -> None:
    """Ctrl-C while the film is written: nothing half is left."""
    import os
    import signal
    import sys
    import time

    if os.name != "posix":
        pytest.skip("needs SIGINT")
    words = [sys.executable, "-m", "taichi_cloth", *RENDER[:-1], "1000000", "--video", "a.mp4"]
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        while not Path(".a.mp4.part").exists() and process.poll() is None:
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate()
    assert process.returncode == 130, err
    assert err == "taichi-cloth: interrupted; finished files are whole\n"
    assert [path.name for path in Path().iterdir()] == ["small.toml"]
