"""Videos and replays from the command line, and their errors."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from taichi_cloth import __main__ as cli
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.render import image_files as video
from taichi_cloth.render.image_files import open_video
from taichi_cloth.simulation.recording import Recorder
from taichi_cloth.simulation.rollback import DivergenceGuard
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import install_command

pytestmark = pytest.mark.usefixtures("running")

SCENE = "[cloth]\nrows = 4\ncolumns = 5\n[solver]\nsubsteps = 2\niterations = 3\n[wind]\nz = 40.0\n"
RENDER = ("render", "small.toml", "--size", "64x48", "--samples", "1", "--frames", "7")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every test has its own folder with a small scene."""
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(SCENE)


@pytest.fixture
def recording() -> Path:
    """Five frames; a particle is moved in two of them. Two views."""
    path = Path("taken.toml")
    with Simulation(load_scene("small.toml")) as simulation:
        recorder = Recorder(simulation)
        recorder.record_view("view", "strain")
        recorder.record_view("camera", 0.3, 0.2, 6.0, 0.0, 1.0, 0.0)
        for k in range(5):
            if k == 3:
                simulation.grab(19).move_to((0.5, 0.5, 0.5))
                recorder.record_view("view", "particles")
            simulation.step()
        recorder.save(path, (66, 50))
    return path


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Return the exit code, the last line on stdout, and stderr."""
    code = cli.main(list(words))
    printed = capsys.readouterr()
    return code, (printed.out.splitlines() or [""])[-1], printed.err


# -- render --video --------------------------------------------------------------------------------------------


def test_a_scene_is_rendered_to_a_video(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, *RENDER, "--every", "2", "--video", "a.mp4") == (0, "4 images in a.mp4", "")
    assert imageio_ffmpeg.count_frames_and_secs("a.mp4")[0] == 4
    assert imageio_ffmpeg.count_frames_and_secs("a.mp4")[1] == pytest.approx(4 / 30, abs=0.006)
    assert not Path("out").exists()
    # the images equal the PNG files up to compression loss
    assert run(capsys, *RENDER, "--every", "2", "--video", "a.webp")[0] == 0
    assert cli.main([*RENDER, "--every", "2", "--out", "o"]) == 0
    with Image.open("a.webp") as shown:
        assert shown.n_frames == 4  # type: ignore[attr-defined]
        for k in range(4):
            shown.seek(k)
            with Image.open(f"o/frame_{k:05d}.png") as image:
                lost = np.asarray(shown.convert("RGB"), float) - np.asarray(image, float)
            assert np.abs(lost).mean() < 4


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--video", "small.toml"], "small.toml: a video file must end in .mp4 or .webp"),
        (["--video", "old.mp4"], "old.mp4 already exists; use --force to replace it"),
        (["--video", "small.toml/a.mp4"], "cannot write a.mp4: small.toml is not a folder"),
        (
            ["--video", "a.mp4", "--resume"],
            "--video writes one file: it cannot be combined with --out, --resume or --contact-sheet",
        ),
        (["--video", "a.mp4", "--size", "1x9"], "a.mp4: an .mp4 file must have at least 2x2 pixels"),
    ],
)
def test_an_invalid_video_option_is_one_line(capsys: pytest.CaptureFixture[str], more: list[str], message: str) -> None:
    Path("old.mp4").write_text("older")
    code, _, err = run(capsys, *RENDER, *more)
    assert (code, err) == (2, f"taichi-cloth: {message}\n")
    assert {path.name for path in Path().iterdir()} == {"small.toml", "old.mp4"}
    assert Path("old.mp4").read_text() == "older"


def test_without_ffmpeg_the_error_names_the_pip_command(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(video, "find_ffmpeg", lambda: None)
    code, _, err = run(capsys, *RENDER, "--video", "a.mp4")
    assert (code, err.count("\n")) == (2, 1)
    assert f"a.mp4 needs ffmpeg: {install_command('video')}, or choose a .webp file" in err


@pytest.mark.parametrize("kind", ["mp4", "webp"])
def test_a_full_disk_is_one_line(disk: Callable[..., Path], kind: str) -> None:
    folder = disk("small", "size=16k")
    random = np.random.default_rng(0)

    def fill() -> None:
        with open_video(folder / f"video.{kind}", (320, 240)) as show:
            for _ in range(10):
                show(random.integers(0, 255, (240, 320, 3), np.uint8))

    with pytest.raises(OSError, match=rf"No space left on device: '.*video\.{kind}'") as caught:
        fill()
    assert "\n" not in str(caught.value)
    assert list(folder.iterdir()) == []


def test_divergence_ends_the_video_and_is_reported(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = DivergenceGuard.check_and_snapshot
    monkeypatch.setattr(DivergenceGuard, "check_and_snapshot", lambda self: self._simulation.frame < 3 and real(self))
    code, last, err = run(capsys, *RENDER, "--video", "a.mp4")
    assert (code, last) == (1, "4 images in a.mp4")
    assert err.startswith("taichi-cloth: the cloth blew up in frame 3: ")
    assert err.endswith("; a.mp4 ends with that frame\n")
    assert imageio_ffmpeg.count_frames_and_secs("a.mp4")[0] == 4


# -- replay ----------------------------------------------------------------------------------------------------


def test_a_recording_is_replayed_without_drawing_as_images_and_as_a_video(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    same = "taken.toml: 5 frames replayed: final positions are bit-identical"
    assert run(capsys, "replay", "taken.toml", "--check") == (0, same, "")
    assert {path.name for path in Path().iterdir()} == {"small.toml", "taken.toml"}
    assert run(capsys, "replay", "taken.toml", "--headless") == (0, same, "")
    images = sorted(Path("taken").iterdir())
    assert [path.name for path in images] == [f"frame_{k:05d}.png" for k in range(6)]
    with Image.open(images[0]) as image:
        assert image.size == (66, 50)
    assert run(capsys, "replay", "taken.toml", "--video", "a.mp4", "--size", "32x32", "--every", "5") == (0, same, "")
    assert imageio_ffmpeg.count_frames_and_secs("a.mp4")[0] == 2


def test_different_final_positions_exit_with_code_1(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording.write_text(recording.read_text().replace('"move_grab", 0, 0.5', '"move_grab", 0, 0.25'))
    line = "taken.toml: 5 frames replayed: final positions DIFFER from the recording"
    assert run(capsys, "replay", "taken.toml", "--check") == (1, line, "")


def test_another_taichi_version_prints_a_warning(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording.write_text(recording.read_text().replace('taichi = "', 'taichi = "0.'))
    code, _, err = run(capsys, "replay", "taken.toml", "--check")
    assert code == 0
    assert err.startswith("taken.toml: recorded with taichi 0.")
    assert err.endswith("; the last bits may differ\n")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[recording]", "[rec]"), "taken.toml: not a recording: it has no [recording]"),
        (('"grab", 19', '"grab", 77'), "taken.toml: rows[2]: grab: particle index must be in 0..19, not 77"),
        (('arch = "cpu"', 'arch = "abacus"'), "taken.toml: unknown arch 'abacus': cpu, "),
        (("rows = 4", "rows = 4000000"), "taken.toml: scene: cloth.rows: "),
        (("[scene]", "\0"), "taken.toml: not a recording: "),
    ],
)
def test_an_invalid_recording_is_one_line(
    recording: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], message: str
) -> None:
    recording.write_text(recording.read_text().replace(*change, 1))
    code, _, err = run(capsys, "replay", "taken.toml", "--headless")
    assert code == 2
    assert err.startswith(f"taichi-cloth: {message}")
    assert err.count("\n") == 1


def test_existing_images_are_kept_without_force(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
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


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("clip.mp4", b"\0\0\0\x20ftyp\xd9", "clip.mp4 is a video: give the recording clip.toml beside it"),
        ("a b/Clip.WEBP", None, "Clip.WEBP is a video: give the recording Clip.toml beside it"),
        ("shot.png", b"\x89PNG", "shot.png is an image: give the recording shot.toml beside it"),
        ("state.npz", b"PK\3\4\xff", "state.npz: not a recording: not UTF-8 text (byte 4)"),
        (
            "empty.toml",
            b"",
            "empty.toml: not a recording: it has no [recording]; `taichi-cloth run FILE` opens a scene",
        ),
        ("folder", None, "folder: not a recording: it is a folder"),
    ],
)
def test_a_file_that_is_no_recording_is_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str, content: bytes | None, message: str
) -> None:
    Path("folder").mkdir()
    if content is not None:
        Path(name).write_bytes(content)
    code, out, err = run(capsys, "replay", name)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert message in err


def test_an_interrupt_leaves_no_partial_video(folder: None) -> None:
    """Ctrl-C while the video is written."""
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
    assert err == "taichi-cloth: interrupted; files that were written are complete\n"
    assert [path.name for path in Path().iterdir()] == ["small.toml"]
