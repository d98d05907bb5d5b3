"""A virtual screen whose pixels can be read, for the tests of the window and for `screenshots/make.py`."""

from __future__ import annotations

import os
import struct
import subprocess
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
from numpy.typing import NDArray


def no_window(reason: str) -> NoReturn:
    """Skip the test, or fail if REQUIRE_WINDOW=1 requires a window."""
    if os.environ.get("REQUIRE_WINDOW") == "1":
        pytest.fail(f"REQUIRE_WINDOW=1, but {reason}")
    pytest.skip(reason)


class Screen:
    """An X server without a monitor. Its frame buffer is a file."""

    def __init__(self, folder: Path) -> None:
        read, write = os.pipe()
        self._file = folder / "Xvfb_screen0"
        # Without -noreset the server restarts when its last client disconnects, and rejects connections meanwhile.
        options = ["-noreset", "-nolisten", "tcp", "-screen", "0", "1400x900x24"]
        self.server = subprocess.Popen(
            ["Xvfb", "-displayfd", str(write), "-fbdir", folder, *options],
            pass_fds=[write],
            stderr=subprocess.DEVNULL,
        )
        os.close(write)
        with os.fdopen(read) as answer:  # empty if the server ends
            self.display = ":" + answer.readline().strip()

    def pixels(self) -> NDArray[np.uint8]:
        """Return the image on the screen, (height, width, RGB). The file has the format of `xwd`."""
        data = self._file.read_bytes()
        header = struct.unpack(">25I", data[:100])
        size, width, height, row_bytes, colors = (header[k] for k in (0, 4, 5, 12, 19))
        rows = np.frombuffer(data, np.uint8, height * row_bytes, size + 12 * colors).reshape(height, row_bytes)
        return rows[:, : 4 * width].reshape(height, width, 4)[:, :, 2::-1]

    def close(self) -> None:
        self.server.terminate()
        self.server.wait()
