"""Films by real encoders, read back by real decoders."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from taichi_cloth.errors import WrongUse
from taichi_cloth.view import video
from taichi_cloth.view.png import Pixels
from taichi_cloth.view.video import film, kinds

SIZE = (65, 49)  # odd: an .mp4 leaves out a column and a row
COLOURS = ((181, 48, 60), (40, 160, 80), (30, 60, 200))
Frames = list[Pixels]


def plain(colour: tuple[int, int, int], size: tuple[int, int] = SIZE) -> Pixels:
    return np.full((size[1], size[0], 3), colour, np.uint8)


def read_mp4(path: Path) -> tuple[Frames, float]:
    """Its pictures and its length [s]."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=True)
    width, height = map(int, re.findall(rb"Video: h264.* (\d+)x(\d+)", done.stderr)[0])
    pictures = np.frombuffer(done.stdout, np.uint8).reshape(-1, height, width, 3)
    return list(pictures), imageio_ffmpeg.count_frames_and_secs(str(path))[1]


def read_webp(path: Path) -> tuple[Frames, float]:
    pictures, milliseconds = [], 0
    with Image.open(path) as image:
        for k in range(image.n_frames):
            image.seek(k)
            pictures.append(np.asarray(image.convert("RGB")))
            milliseconds += image.info["duration"]
    return pictures, milliseconds / 1000


@pytest.mark.parametrize(("kind", "read", "size"), [("mp4", read_mp4, (64, 48)), ("webp", read_webp, SIZE)])
@pytest.mark.parametrize("every", [1, 7])
def test_a_film_has_the_pictures_it_was_shown_at_their_pace(
    tmp_path: Path, kind: str, read: Callable[[Path], tuple[Frames, float]], size: tuple[int, int], every: int
) -> None:
    path = tmp_path / f"film.{kind}"
    with film(path, SIZE, every) as show:
        for colour in COLOURS:
            show(plain(colour))
        assert not path.exists()
    pictures, seconds = read(path)
    assert [picture.shape for picture in pictures] == [(size[1], size[0], 3)] * 3
    assert seconds == pytest.approx(3 * every / 60, abs=0.006)  # decoders tell hundredths
    for picture, colour in zip(pictures, COLOURS, strict=True):
        assert np.abs(picture.reshape(-1, 3).mean(axis=0) - colour).max() < 4
    assert [path.name for path in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("kind", ["mp4", "webp"])
@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_an_error_leaves_the_older_film_and_no_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, error: type[BaseException]
) -> None:
    started = []
    real = subprocess.Popen

    def popen(*words: object, **options: object) -> object:
        started.append(real(*words, **options))  # type: ignore[call-overload]
        return started[-1]

    path = tmp_path / f"film.{kind}"
    path.write_text("older")
    kinds()  # looks for programs, once
    monkeypatch.setattr(subprocess, "Popen", popen)
    with pytest.raises(error), film(path, SIZE) as show:  # noqa: PT012
        show(plain(COLOURS[0]))
        raise error
    assert path.read_text() == "older"
    assert list(tmp_path.iterdir()) == [path]
    assert len(started) == (kind == "mp4")
    assert all(process.returncode is not None for process in started)


@pytest.mark.skipif(os.name != "posix", reason="a shell script stands for ffmpeg")
def test_what_the_encoder_says_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cross = tmp_path / "ffmpeg"
    cross.write_text("#!/bin/sh\necho ' V....D libx264 H.264'\n[ $# -eq 2 ] || echo 'No such filter' >&2\nexit 1\n")
    cross.chmod(0o755)
    monkeypatch.setattr(video.shutil, "which", lambda name: str(cross))
    path = tmp_path / "film.mp4"

    def one_picture() -> None:
        with film(path, SIZE) as show:
            show(plain(COLOURS[0]))

    with pytest.raises(OSError, match=r"ffmpeg: No such filter: '.*film\.mp4'$"):
        one_picture()
    assert list(tmp_path.iterdir()) == [cross]


@pytest.fixture
def bare(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """bare("imageio_ffmpeg"): as if these packages were not installed, nor any ffmpeg on the system."""
    real = video.find_spec

    def take_away(*packages: str) -> None:
        monkeypatch.setattr(video.shutil, "which", lambda name: None)
        monkeypatch.setattr(video, "find_spec", lambda name: None if name in packages else real(name))

    return take_away


def test_without_ffmpeg_the_pip_command_is_told(tmp_path: Path, bare: Callable[..., None]) -> None:
    assert kinds() == [".mp4", ".webp"]
    bare("imageio_ffmpeg")
    assert kinds() == [".webp"]
    with pytest.raises(WrongUse) as caught:
        film(tmp_path / "a.mp4", SIZE)
    assert str(caught.value).endswith("a.mp4 needs ffmpeg: pip install 'taichi-cloth[video]', or name a .webp")
    bare("imageio_ffmpeg", "PIL")
    assert kinds() == []
    with pytest.raises(WrongUse, match=r"a\.webp needs Pillow: pip install pillow$"):
        film(tmp_path / "a.webp", SIZE)


@pytest.mark.skipif(os.name != "posix", reason="a shell script stands for ffmpeg")
def test_an_ffmpeg_that_writes_no_h264_is_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    poor = tmp_path / "ffmpeg"
    poor.write_text("#!/bin/sh\necho ' V..... mpeg4'\n")
    poor.chmod(0o755)
    monkeypatch.setattr(video.shutil, "which", lambda name: str(poor))
    assert video.find_ffmpeg() == imageio_ffmpeg.get_ffmpeg_exe()


@pytest.mark.parametrize("name", ["film.avi", "film", "film.MP4", "mp4"])
def test_other_endings_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(WrongUse, match=r"a film ends in \.mp4 or \.webp"):
        film(tmp_path / name, SIZE)
