"""Image and video files, and contact sheets: several images in one.

PNG files are written with zlib alone, .mp4 files with H.264 by the program ffmpeg, animated .webp files by Pillow.
"""

from __future__ import annotations

import errno
import os
import shutil
import signal
import struct
import subprocess
import tempfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import cache
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ..scene.keys import Vec3
from ..system.errors import UsageError, install_command
from ..system.files import atomic_file

SIGNATURE = b"\x89PNG\r\n\x1a\n"
Pixels = NDArray[np.uint8]  # (height, width, 3): red, green, blue; top row first
TRUE_COLOR_8_BIT = (8, 2, 0, 0, 0)  # bit depth, RGB, deflate, filter per row, not interlaced


def encode_png(rgb: Pixels) -> bytes:
    """Return an image, uint8 (height, width, 3) with the top row first, as a PNG file.

    Raises ValueError for another type or shape and for an empty image.
    """
    if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.size == 0:
        raise ValueError(f"image must be uint8 of shape (height, width, 3), not {rgb.dtype} of shape {rgb.shape}")
    height, width, _ = rgb.shape
    # Each row starts with the number of its filter; 0 is none. Smooth shading in 8 bits gives long runs of equal
    # pixels. Differences to the left (Sub) or above (Up) only break them up: at compression level 1 they cost 20 % more
    # time and 10–25 % more bytes on images of a lit cloth. Level 2 saves 5 % of the bytes for 5 % more time.
    rows = np.zeros((height, 1 + 3 * width), np.uint8)
    rows[:, 1:] = rgb.reshape(height, 3 * width)
    header = struct.pack(">II5B", width, height, *TRUE_COLOR_8_BIT)
    return SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", zlib.compress(rows.data, 1)) + _chunk(b"IEND", b"")


def write_png(path: str | os.PathLike[str], rgb: Pixels) -> None:
    """Write a PNG file; a partial file never remains. Raises ValueError like `encode_png`, and OSError."""
    png = encode_png(rgb)
    with atomic_file(path) as file:
        file.write(png)


def _chunk(kind: bytes, data: bytes) -> bytes:
    """Return a PNG chunk: length, type, data, checksum."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


@contextmanager
def background_writer() -> Iterator[Callable[[Path, Pixels], None]]:
    """Provide a function that writes a PNG file in a second thread, while the next frame is computed.

    At most two images wait to be written; a further call blocks. At the end of the block all files have been written.
    An error of an earlier image is raised by a later call, or at the end of the block.
    """
    with ThreadPoolExecutor(1, "png") as executor:
        pending: list[Future[None]] = []

        def write(path: Path, pixels: Pixels) -> None:
            if len(pending) == 2:
                pending.pop(0).result()
            pending.append(executor.submit(write_png, path, pixels))

        yield write
        for future in pending:
            future.result()


def contact_sheet(
    images: Sequence[Pixels], columns: int, factor: int = 1, *, gap: int = 8, background: Vec3 = (1.0, 1.0, 1.0)
) -> Pixels:
    """Return one image of several, all of one size: each reduced by `factor`, row by row in a grid of `columns`.

    A `gap` [pixels] in the color `background` (factors 0…1) separates and surrounds the images. Images are uint8
    (height, width, 3). Pixel columns and rows that are left over when dividing by `factor` are cut off at the right and
    the bottom. Raises ValueError for no images, images of different sizes, and numbers that are too small or too large.
    """
    if len({image.shape for image in images}) != 1:
        raise ValueError("a contact sheet needs at least one image, and all images of one size")
    if columns < 1 or gap < 0 or not 1 <= factor <= min(images[0].shape[:2]):
        raise ValueError(
            "a contact sheet needs columns >= 1, gap >= 0 and 1 <= factor <= shorter side of the images, "
            f"not {columns}, {gap} and {factor}"
        )
    small = [_reduced(image, factor) for image in images]
    height, width, _ = small[0].shape
    rows = -(-len(small) // columns)
    size = (gap + rows * (gap + height), gap + columns * (gap + width), 3)
    sheet = np.full(size, np.rint(255 * np.array(background)), np.uint8)
    for k, image in enumerate(small):
        row, column = divmod(k, columns)
        top, left = gap + row * (gap + height), gap + column * (gap + width)
        sheet[top : top + height, left : left + width] = image
    return sheet


def _reduced(image: Pixels, factor: int) -> Pixels:
    """Return the means over squares of `factor` × `factor` pixels."""
    height, width = (extent // factor for extent in image.shape[:2])
    squares = image[: height * factor, : width * factor].reshape(height, factor, width, factor, 3)
    means: Pixels = np.rint(squares.mean(axis=(1, 3))).astype(np.uint8)
    return means


FRAME_RATE = 60  # [1/s] images per second, if every frame is shown
QUALITY = 18  # constant rate factor of x264; at this value and below the loss is not visible
WEBP_QUALITY = 80

AppendImage = Callable[[Pixels], None]


def available_formats() -> list[str]:
    """Return the suffixes of the video formats that can be written here, the better format first.

    Empty if neither ffmpeg nor Pillow is installed.
    """
    return [".mp4"] * bool(find_ffmpeg()) + [".webp"] * bool(find_spec("PIL"))


def check_format(path: Path) -> None:
    """Raise UsageError for a video file that cannot be written here."""
    suffix = path.suffix.lower()
    if suffix not in (".mp4", ".webp"):
        raise UsageError(f"{path}: a video file must end in .mp4 or .webp")
    if suffix not in available_formats():
        package = "ffmpeg" if suffix == ".mp4" else "Pillow"
        other = ", or choose a .webp file" if ".webp" in available_formats() else ""
        raise UsageError(f"{path} needs {package}: {install_command('video')}{other}")


def find_ffmpeg() -> str | None:
    """Return the path of an ffmpeg with H.264: of the system, else of the package imageio-ffmpeg; None without one."""
    found = [shutil.which("ffmpeg")]
    if find_spec("imageio_ffmpeg"):
        from imageio_ffmpeg import get_ffmpeg_exe

        with suppress(RuntimeError):  # the package has none for this platform
            found.append(get_ffmpeg_exe())
    return next((exe for exe in found if exe and _writes_h264(exe)), None)


@cache
def _writes_h264(exe: str) -> bool:
    """Return whether an ffmpeg has the encoder libx264."""
    try:
        result = subprocess.run([exe, "-hide_banner", "-encoders"], stdin=subprocess.DEVNULL, capture_output=True)
    except OSError:
        return False
    return b" libx264 " in result.stdout


def open_video(path: Path, size: tuple[int, int], every: int = 1) -> AbstractContextManager[AppendImage]:
    """Return a context manager that provides a function `show(image)`, which appends an image to a video file.

    Images are uint8 (height, width, 3); `size`: width and height [pixels]. Each is shown for `every` frames of 1/60 s.
    The file appears at the end of the block; after an error or an interrupt no partial file remains. An .mp4 file has
    even width and height: an odd last column or row is left out. Raises UsageError like `check_format` and for an .mp4
    file below 2×2 pixels, and OSError.
    """
    check_format(path)
    return _mp4(path, size, every) if path.suffix.lower() == ".mp4" else _webp(path, every)


@contextmanager
def _mp4(path: Path, size: tuple[int, int], every: int) -> Iterator[AppendImage]:
    width, height = (max(2, n // 2 * 2) for n in size)
    if min(size) < 2:
        raise UsageError(f"{path}: an .mp4 file must have at least 2x2 pixels")
    exe = find_ffmpeg()
    assert exe is not None
    with atomic_file(path) as file, tempfile.TemporaryFile() as errors:
        pixels = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{FRAME_RATE}/{every}")
        # State the color matrix: without it players guess BT.601 or BT.709 from the image size.
        colors = [
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
        command = [exe, "-y", "-loglevel", "error", *pixels, "-i", "-", *colors, *codec, file.name]
        with _running(command, errors) as ffmpeg:
            pipe = ffmpeg.stdin
            assert pipe is not None

            def show(image: Pixels) -> None:
                try:
                    pipe.write(image[:height, :width].tobytes())
                except OSError:  # ffmpeg has ended; its error output has the reason
                    raise _failure(ffmpeg, errors) from None

            yield show
            with suppress(OSError):
                pipe.close()
            if ffmpeg.wait() != 0:
                raise _failure(ffmpeg, errors)


@contextmanager
def _running(command: list[str], errors: IO[bytes]) -> Iterator[subprocess.Popen[bytes]]:
    """Start a process with a pipe to its standard input; it has ended when the block ends."""
    process = None
    try:
        with _no_interrupt():
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,  # Ctrl-C must not reach it: this function ends it
            )
        yield process
    finally:
        if process is not None:
            process.kill()
            with suppress(OSError):  # data that was not written yet cannot be flushed
                process.communicate()


@contextmanager
def _no_interrupt() -> Iterator[None]:
    """Delay Ctrl-C and SIGTERM until the end of the block.

    An interrupt while a process is started would leave it running, because nothing refers to it yet.
    """
    received: list[int] = []
    handlers = {}
    with suppress(ValueError):  # not the main thread; only that one is interrupted
        for number in (signal.SIGINT, signal.SIGTERM):
            handlers[number] = signal.signal(number, lambda number, frame: received.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    for interrupt in received[:1]:
        signal.raise_signal(interrupt)


def _failure(ffmpeg: subprocess.Popen[bytes], errors: IO[bytes]) -> OSError:
    """Wait for ffmpeg to end, and return an error with the first line of its error output, or with "No space left"."""
    ffmpeg.wait()
    errors.seek(0)
    lines = errors.read().decode(errors="replace").strip().splitlines() or [f"ended with code {ffmpeg.returncode}"]
    full = next((line for line in lines if "No space left" in line), None)
    return OSError(errno.ENOSPC if full else errno.EIO, f"ffmpeg: {full or lines[0]}")


@contextmanager
def _webp(path: Path, every: int) -> Iterator[AppendImage]:
    """Write an animated .webp file at the end of the block. Pillow needs all images at once, so they stay in memory."""
    from PIL import Image

    images: list[Any] = []
    with atomic_file(path) as file:
        yield lambda image: images.append(Image.fromarray(image))
        # Durations are integers in milliseconds, rounded so that the total length is correct.
        ends = [round(1000 * every * k / FRAME_RATE) for k in range(len(images) + 1)]
        durations = [end - start for start, end in pairwise(ends)]
        first, *rest = images
        options = {"duration": durations, "loop": 0, "quality": WEBP_QUALITY, "method": 2}
        first.save(file, format="WEBP", save_all=True, append_images=rest, **options)
