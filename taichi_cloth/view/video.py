"""Pictures as a film: H.264 in an .mp4 by the program ffmpeg, or an animated .webp by Pillow."""

from __future__ import annotations

import errno
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import cache
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

from ..errors import WrongUse
from ..files import whole_file
from .png import Pixels

FRAME_RATE = 60  # pictures a second, if every frame is shown
QUALITY = 18  # x264's constant rate factor; differences cannot be seen from here on down
WEBP_QUALITY = 80

Show = Callable[[Pixels], None]


def kinds() -> list[str]:
    """The endings of films that can be made here, the better first; none where both programs are missing."""
    return [".mp4"] * bool(find_ffmpeg()) + [".webp"] * bool(find_spec("PIL"))


def check_kind(path: Path) -> None:
    """Raises WrongUse for a film that cannot be made here."""
    if path.suffix not in (".mp4", ".webp"):
        raise WrongUse(f"{path}: a film ends in .mp4 or .webp")
    if path.suffix not in kinds():
        needs, package = ("ffmpeg", "'taichi-cloth[video]'") if path.suffix == ".mp4" else ("Pillow", "pillow")
        other = ", or name a .webp" if ".webp" in kinds() else ""
        raise WrongUse(f"{path} needs {needs}: pip install {package}{other}")


def find_ffmpeg() -> str | None:
    """An ffmpeg that writes H.264: the system's, or the one of the package imageio-ffmpeg."""
    found = [shutil.which("ffmpeg")]
    if find_spec("imageio_ffmpeg"):
        from imageio_ffmpeg import get_ffmpeg_exe

        with suppress(RuntimeError):  # it has none for this system
            found.append(get_ffmpeg_exe())
    return next((exe for exe in found if exe and _writes_h264(exe)), None)


@cache
def _writes_h264(exe: str) -> bool:
    try:
        told = subprocess.run([exe, "-hide_banner", "-encoders"], stdin=subprocess.DEVNULL, capture_output=True)
    except OSError:
        return False
    return b" libx264 " in told.stdout


def film(path: Path, size: tuple[int, int], every: int = 1) -> AbstractContextManager[Show]:
    """A function that takes picture after picture, uint8 of shape (height, width, 3), each `every` frames of 1/60 s.

    The file is there, whole, at the end of the block; after an error or an interrupt nothing is left of it. An .mp4
    has even sizes: an odd last row or column is left out. Raises WrongUse as `check_kind` does, and OSError.
    """
    check_kind(path)
    return _mp4(path, size, every) if path.suffix == ".mp4" else _webp(path, every)


@contextmanager
def _mp4(path: Path, size: tuple[int, int], every: int) -> Iterator[Show]:
    width, height = (max(2, n // 2 * 2) for n in size)
    if min(size) < 2:
        raise WrongUse(f"{path}: an .mp4 has at least 2x2 pixels")
    exe = find_ffmpeg()
    assert exe is not None
    with whole_file(path) as file, tempfile.TemporaryFile() as errors:
        pixels = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{FRAME_RATE}/{every}")
        # Players take a film that does not say for BT.601 or BT.709 by its size: it says.
        colours = [
            "-vf",
            "scale=out_color_matrix=bt709:out_range=tv",
            "-pix_fmt",
            "yuv420p",
            "-colorspace",
            "bt709",
            "-color_range",
            "tv",
        ]
        codec = ("-an", "-c:v", "libx264", "-crf", str(QUALITY), "-movflags", "+faststart", "-f", "mp4")
        command = [exe, "-y", "-loglevel", "error", *pixels, "-i", "-", *colours, *codec, file.name]
        with _running(command, errors) as ffmpeg:
            pipe = ffmpeg.stdin
            assert pipe is not None

            def show(picture: Pixels) -> None:
                try:
                    pipe.write(picture[:height, :width].tobytes())
                except OSError:  # it has ended; why is in its last words
                    raise _failure(ffmpeg, errors) from None

            yield show
            with suppress(OSError):
                pipe.close()
            if ffmpeg.wait() != 0:
                raise _failure(ffmpeg, errors)


@contextmanager
def _running(command: list[str], errors: IO[bytes]) -> Iterator[subprocess.Popen[bytes]]:
    """A process that takes what is written into it, and has ended with the block."""
    process = None
    try:
        with _no_interrupt():
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,  # Ctrl-C is for us, who end it
            )
        yield process
    finally:
        if process is not None:
            process.kill()
            with suppress(OSError):  # what was left to write
                process.communicate()


@contextmanager
def _no_interrupt() -> Iterator[None]:
    """Ctrl-C waits until a process that is being started is known: it would go on alone."""
    caught: list[int] = []
    before = {}
    with suppress(ValueError):  # not in the main thread, which alone is interrupted
        for number in (signal.SIGINT, signal.SIGTERM):
            before[number] = signal.signal(number, lambda number, frame: caught.append(number))
    try:
        yield
    finally:
        for known, handler in before.items():
            signal.signal(known, handler)
    for first in caught[:1]:
        signal.raise_signal(first)


def _failure(ffmpeg: subprocess.Popen[bytes], errors: IO[bytes]) -> OSError:
    ffmpeg.wait()
    errors.seek(0)
    words = errors.read().decode(errors="replace").strip().splitlines() or [f"ended with code {ffmpeg.returncode}"]
    full = next((line for line in words if "No space left" in line), None)
    return OSError(errno.ENOSPC if full else errno.EIO, f"ffmpeg: {full or words[0]}")


@contextmanager
def _webp(path: Path, every: int) -> Iterator[Show]:
    """Pillow wants all pictures at once: they wait in memory."""
    from PIL import Image

    pictures: list[Any] = []
    with whole_file(path) as file:
        yield lambda picture: pictures.append(Image.fromarray(picture))
        # Whole milliseconds, spread so that the film is as long as it should be.
        ends = [round(1000 * every * k / FRAME_RATE) for k in range(len(pictures) + 1)]
        durations = [end - start for start, end in pairwise(ends)]
        first, *rest = pictures
        options = {"duration": durations, "loop": 0, "quality": WEBP_QUALITY, "method": 2}
        first.save(file, format="WEBP", save_all=True, append_images=rest, **options)
