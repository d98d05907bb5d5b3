"""Videos written by real encoders and read by real decoders."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image
from PIL.WebPImagePlugin import WebPImageFile

import taichi_cloth as tc
from taichi_cloth.render import image_files
from taichi_cloth.render.image_files import Pixels, available_formats, open_video
from taichi_cloth.system.errors import UsageError, install_command

SIZE = (65, 49)  # odd: an .mp4 file leaves out a column and a row
COLORS = ((181, 48, 60), (40, 160, 80), (30, 60, 200))
Frames = list[Pixels]


def plain(color: tuple[int, int, int], size: tuple[int, int] = SIZE) -> Pixels:
    return np.full((size[1], size[0], 3), color, np.uint8)


def read_mp4(path: Path) -> tuple[Frames, float]:
    """Return the frames of a video and its duration [s]."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=True)
    width, height = map(int, re.findall(rb"Video: h264.* (\d+)x(\d+)", done.stderr)[0])
    frames = np.frombuffer(done.stdout, np.uint8).reshape(-1, height, width, 3)
    return list(frames), imageio_ffmpeg.count_frames_and_secs(str(path))[1]


def read_webp(path: Path) -> tuple[Frames, float]:
    """Return the frames of a video and its duration [s]."""
    frames, milliseconds = [], 0
    with Image.open(path) as image:
        assert isinstance(image, WebPImageFile)
        for k in range(image.n_frames):
            image.seek(k)
            frames.append(np.asarray(image.convert("RGB")))
            milliseconds += image.info["duration"]
    return frames, milliseconds / 1000


@pytest.mark.parametrize(("kind", "read", "size"), [("MP4", read_mp4, (64, 48)), ("webp", read_webp, SIZE)])
@pytest.mark.parametrize("every", [1, 7])
def test_a_video_has_the_images_at_their_frame_rate(
    tmp_path: Path, kind: str, read: Callable[[Path], tuple[Frames, float]], size: tuple[int, int], every: int
) -> None:
    path = tmp_path / f"video.{kind}"
    with open_video(path, SIZE, every) as show:
        for color in COLORS:
            show(plain(color))
        assert not path.exists()
    frames, seconds = read(path)
    assert [frame.shape for frame in frames] == [(size[1], size[0], 3)] * 3
    assert seconds == pytest.approx(3 * every / 60, abs=0.006)  # decoders report hundredths
    for frame, color in zip(frames, COLORS, strict=True):
        assert np.abs(frame.reshape(-1, 3).mean(axis=0) - color).max() < 4
    assert [path.name for path in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("kind", ["mp4", "webp"])
@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_after_an_error_the_older_video_remains_and_no_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, error: type[BaseException]
) -> None:
    started = []
    real = subprocess.Popen

    def popen(*arguments: object, **options: object) -> object:
        started.append(real(*arguments, **options))  # type: ignore[call-overload]
        return started[-1]

    path = tmp_path / f"video.{kind}"
    path.write_text("older")
    available_formats()  # searches for programs once
    monkeypatch.setattr(subprocess, "Popen", popen)
    with pytest.raises(error), open_video(path, SIZE) as show:  # noqa: PT012
        show(plain(COLORS[0]))
        raise error
    assert path.read_text() == "older"
    assert list(tmp_path.iterdir()) == [path]
    assert len(started) == (kind == "mp4")
    assert all(process.returncode is not None for process in started)


@pytest.mark.skipif(os.name != "posix", reason="a shell script replaces ffmpeg")
def test_the_error_output_of_the_encoder_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = tmp_path / "ffmpeg"
    broken.write_text("#!/bin/sh\necho ' V....D libx264 H.264'\n[ $# -eq 2 ] || echo 'No such filter' >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setattr(image_files.shutil, "which", lambda name: str(broken))
    path = tmp_path / "video.mp4"

    def write_one_frame() -> None:
        with open_video(path, SIZE) as show:
            show(plain(COLORS[0]))

    with pytest.raises(OSError, match=r"ffmpeg: No such filter: '.*video\.mp4'$"):
        write_one_frame()
    assert list(tmp_path.iterdir()) == [broken]


@pytest.fixture
def without(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Hide packages, and any ffmpeg on the system: `without("imageio_ffmpeg")`."""
    real = image_files.find_spec

    def hide(*packages: str) -> None:
        monkeypatch.setattr(image_files.shutil, "which", lambda name: None)
        monkeypatch.setattr(image_files, "find_spec", lambda name: None if name in packages else real(name))

    return hide


def test_without_ffmpeg_the_error_has_the_pip_command(tmp_path: Path, without: Callable[..., None]) -> None:
    assert available_formats() == [".mp4", ".webp"]
    without("imageio_ffmpeg")
    assert available_formats() == [".webp"]
    with pytest.raises(UsageError) as caught:
        open_video(tmp_path / "a.mp4", SIZE)
    assert str(caught.value).endswith(f"a.mp4 needs ffmpeg: {install_command('video')}, or choose a .webp file")
    without("imageio_ffmpeg", "PIL")
    assert available_formats() == []
    with pytest.raises(UsageError) as caught:
        open_video(tmp_path / "a.webp", SIZE)
    assert str(caught.value).endswith(f"a.webp needs Pillow: {install_command('video')}")


@pytest.mark.skipif(os.name != "posix", reason="a shell script replaces ffmpeg")
def test_an_ffmpeg_without_h264_is_skipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without_h264 = tmp_path / "ffmpeg"
    without_h264.write_text("#!/bin/sh\necho ' V..... mpeg4'\n")
    without_h264.chmod(0o755)
    monkeypatch.setattr(image_files.shutil, "which", lambda name: str(without_h264))
    assert image_files.find_ffmpeg() == imageio_ffmpeg.get_ffmpeg_exe()


@pytest.mark.parametrize("name", ["video.avi", "video", "mp4"])
def test_other_suffixes_are_rejected(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match=r"a video file must end in \.mp4 or \.webp"):
        open_video(tmp_path / name, SIZE)


# -- a video of a simulation -------------------------------------------------------------------------------------------


def small() -> tc.Scene:
    return tc.load_scene("drape15", rows=5, columns=6)


@pytest.mark.usefixtures("serial_layout")
def test_a_video_of_a_simulation_has_the_images_of_its_frames(tmp_path: Path) -> None:
    size = (64, 48)
    with tc.Simulation(small()) as simulation, tc.Simulation(small()) as same:
        pulled, grab = simulation.grab(29), same.grab(29)

        def pull(k: int) -> None:
            pulled.move_to((0.1 * k, 1.0, 0.5))

        tc.render_video(simulation, tmp_path / "a.webp", 7, size, every=3, on_frame=pull)
        frames, seconds = read_webp(tmp_path / "a.webp")
        assert (len(frames), seconds, simulation.frame) == (3, pytest.approx(9 / 60, abs=0.001), 7)
        for k in range(7):
            if k % 3 == 0:
                lost = frames[k // 3].astype(float) - tc.render_image(same, size).pixels
                assert np.abs(lost).mean() < 4
            same.step()
            grab.move_to((0.1 * k, 1.0, 0.5))
        assert (simulation.positions() == same.positions()).all()
        tc.render_video(
            simulation, tmp_path / "a.mp4", 2, size, "wireframe", eye=(0.0, 1.0, 3.0), target=(0.0, 1.0, 0.0)
        )
        assert len(read_mp4(tmp_path / "a.mp4")[0]) == 2


@pytest.mark.usefixtures("serial_layout")
@pytest.mark.parametrize(
    ("name", "options", "error", "line"),
    [
        ("a.avi", {}, UsageError, r"a.avi: a video file must end in \.mp4 or \.webp"),
        ("a.mp4", {}, UsageError, "a.mp4 needs ffmpeg: .* pip install"),
        ("a.webp", {"view": "error"}, UsageError, "the view 'error' measures each frame: use `taichi-cloth render"),
        ("a.webp", {"view": "shadde"}, ValueError, "unknown view 'shadde'.*did you mean 'shaded'"),
        ("a.webp", {"size": (0, 9)}, ValueError, "size must be"),
        ("a.webp", {"frames": 0}, ValueError, "frames must be an integer from 1, not 0"),
        ("a.webp", {"every": 1.5}, ValueError, "every must be an integer from 1, not 1.5"),
    ],
)
def test_a_video_that_cannot_be_written_is_refused_before_the_first_frame(
    tmp_path: Path,
    without: Callable[..., None],
    name: str,
    options: dict[str, Any],
    error: type[Exception],
    line: str,
) -> None:
    without("imageio_ffmpeg")
    with tc.Simulation(small()) as simulation:
        with pytest.raises(error, match=line):
            tc.render_video(simulation, tmp_path / "new" / name, **({"frames": 2} | options))
        assert simulation.frame == 0
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("serial_layout")
def test_a_video_of_a_cloth_that_blows_up_is_not_written(tmp_path: Path) -> None:
    with tc.Simulation(small()) as simulation:

        def throw(k: int) -> None:
            if k == 2:
                simulation.set_state(simulation.positions(), (0.0, -1e6, 0.0))  # [m/s]

        with pytest.raises(tc.Diverged, match="the cloth blew up in frame 4"):
            tc.render_video(simulation, tmp_path / "a.webp", 8, (16, 9), on_frame=throw)
    assert list(tmp_path.iterdir()) == []


CHANGES: list[Callable[[tc.Simulation], object]] = [
    lambda simulation: simulation.step(),
    lambda simulation: simulation.reset(),
    lambda simulation: simulation.switch_solver("xpbd"),
]


@pytest.mark.usefixtures("serial_layout")
@pytest.mark.parametrize("change", CHANGES, ids=["step", "reset", "switch_solver"])
def test_on_frame_may_not_step_or_change_the_scene(tmp_path: Path, change: Callable[[tc.Simulation], object]) -> None:
    with tc.Simulation(small()) as simulation:
        line = r"^on_frame may move grabs and change parameters, but not step, reset or change the scene$"
        with pytest.raises(tc.UsageError, match=line):
            tc.render_video(simulation, tmp_path / "a.webp", 4, (16, 9), on_frame=lambda _: change(simulation))
        with pytest.raises(tc.UsageError, match=line):
            simulation.export_clip(tmp_path / "a.pc2", 4, on_frame=lambda _: change(simulation))
    assert list(tmp_path.iterdir()) == []
