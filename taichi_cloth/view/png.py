"""Pictures as PNG files, by zlib alone."""

from __future__ import annotations

import os
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from ..files import whole_file

SIGNATURE = b"\x89PNG\r\n\x1a\n"
Pixels = NDArray[np.uint8]  # (height, width, 3) red, green, blue; row 0 on top
TRUE_COLOUR_8_BIT = (8, 2, 0, 0, 0)  # bits, red-green-blue, deflate, filters by row, not interlaced


def encode_png(rgb: Pixels) -> bytes:
    """A PNG file of a picture, uint8 of shape (height, width, 3), row 0 on top. Raises ValueError for others."""
    if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.size == 0:
        raise ValueError(f"a picture is uint8 of shape (height, width, 3), not {rgb.dtype} of shape {rgb.shape}")
    height, width, _ = rgb.shape
    # Each row starts with its filter's number; 0 is none. Smooth shading in 8 bits is long runs of equal
    # pixels, which differences to the left (Sub) or above (Up) only break up: at level 1 they cost 20 % more
    # time and 10-25 % more bytes on pictures of a lit cloth. Level 2 saves 5 % of bytes for 5 % of time.
    rows = np.zeros((height, 1 + 3 * width), np.uint8)
    rows[:, 1:] = rgb.reshape(height, 3 * width)
    header = struct.pack(">II5B", width, height, *TRUE_COLOUR_8_BIT)
    return SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", zlib.compress(rows.data, 1)) + _chunk(b"IEND", b"")


def write_png(path: str | os.PathLike[str], rgb: Pixels) -> None:
    """Writes `path` whole or not at all. Raises ValueError as `encode_png` does, and OSError."""
    png = encode_png(rgb)
    with whole_file(path) as file:
        file.write(png)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
