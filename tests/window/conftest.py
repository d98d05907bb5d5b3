"""A real screen for the real window: Xvfb to show it on, xdotool for the mouse and the keys.

Nothing here sleeps for a fixed time in the hope that something has happened: `Desk.until` follows the
program's own log (`--log`) and gives up only after `PATIENCE`.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from screen import Screen, no_window

import taichi_cloth
from taichi_cloth.view.display import window_obstacle

PATIENCE = 120.0  # [s]; no test depends on it unless it fails
BUTTONS = {"left": 1, "middle": 2, "right": 3}

Line = dict[str, Any]


class ClientMessage(ctypes.Structure):
    """XClientMessageEvent."""

    _fields_ = (
        ("type", ctypes.c_int),
        ("serial", ctypes.c_ulong),
        ("send_event", ctypes.c_int),
        ("display", ctypes.c_void_p),
        ("window", ctypes.c_ulong),
        ("message_type", ctypes.c_ulong),
        ("format", ctypes.c_int),
        ("data", ctypes.c_long * 5),
        ("rest_of_xevent", ctypes.c_long * 24),
    )


class Desk:
    """The program in its window, with a hand on mouse and keyboard. Screen points run from the bottom left, 0…1."""

    def __init__(self, screen: Screen, folder: Path, *arguments: str, command: str = "run") -> None:
        self.screen = screen
        self.folder = folder / "working"
        self.folder.mkdir()
        self.temporary = folder / "temporary"
        self.temporary.mkdir()
        self._log = folder / "log.jsonl"
        self._errors = folder / "errors.txt"
        self._environment = os.environ | {
            "DISPLAY": screen.display,
            "PYTHONPATH": str(Path(taichi_cloth.__file__).parents[1]),
            "TMPDIR": str(self.temporary),
        }
        self._read = 0
        self.last: Line = {}
        with self._errors.open("w") as errors:
            self.program = subprocess.Popen(
                [sys.executable, "-m", "taichi_cloth", command, *arguments, "--log", self._log],
                cwd=self.folder,
                env=self._environment,
                stdout=errors,
                stderr=errors,
            )
        self.until(lambda line: True, "the first picture")
        place = self.xdotool("search", "--name", "^taichi_cloth", "getwindowgeometry", "--shell")
        values = dict(pair.split("=") for pair in place.split())
        self.window = values["WINDOW"]
        self.left, self.top, self.width, self.height = (int(values[k]) for k in ("X", "Y", "WIDTH", "HEIGHT"))

    def close(self) -> None:
        if self.program.poll() is None:
            self.program.kill()
            self.program.wait()
        for button in BUTTONS.values():  # the screen is there for the next test, too
            self.xdotool("mouseup", str(button))

    # -- reading -------------------------------------------------------------------------------------------

    def lines(self) -> list[Line]:
        """Lines of the log that were not read before."""
        text = self._log.read_text() if self._log.exists() else ""
        whole = text[: text.rfind("\n") + 1].splitlines()
        new, self._read = whole[self._read :], len(whole)
        return [json.loads(line) for line in new]

    def until(self, happened: Callable[[Line], Any], what: str) -> Line:
        """The first line from now on of which `happened` is true."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            dead = self.program.poll() is not None
            for line in self.lines():
                self.last = line
                if happened(line):
                    return line
            if dead:
                pytest.fail(f"the program ended before {what}:\n{self._errors.read_text()}")
            time.sleep(0.01)
        pytest.fail(f"{what} did not happen; the last picture was {self.last}")

    def now(self) -> Line:
        """A picture that knows of all that was done up to here and is on the screen."""
        self.lines()
        shown = self.last["displayed"]
        return self.until(lambda line: line["displayed"] >= shown + 3, "three more pictures")

    def picture(self) -> NDArray[np.int16]:
        """The window as it is on the screen, (height, width, RGB)."""
        self.now()
        rows, columns = slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)
        return self.screen.pixels()[rows, columns].astype(np.int16)

    def exit_code(self) -> int:
        return self.program.wait(PATIENCE)

    def said(self) -> list[str]:
        """What the program printed, errors among it."""
        return self._errors.read_text().splitlines()

    # -- doing ---------------------------------------------------------------------------------------------

    def key(self, *names: str) -> None:
        self.xdotool("key", *names)

    @contextlib.contextmanager
    def holding(self, key: str) -> Iterator[None]:
        self.xdotool("keydown", key)
        yield
        self.xdotool("keyup", key)

    def move(self, u: float, v: float) -> None:
        """Moves the mouse, and waits until the program has seen it there."""
        x, y = round(u * self.width), round((1 - v) * self.height)
        self.xdotool("mousemove", str(self.left + x), str(self.top + y))

        def is_there(line: Line) -> bool:
            seen_x, seen_y = line["cursor"][0] * self.width, (1 - line["cursor"][1]) * self.height
            return abs(seen_x - x) < 1.5 and abs(seen_y - y) < 1.5

        self.until(is_there, f"the cursor at {u:.3f}, {v:.3f}")

    def press(self, button: str) -> Line:
        """Presses a button and returns the first picture that knows of it."""
        self.xdotool("mousedown", str(BUTTONS[button]))
        return self.until(lambda line: line["mouse"] != "idle", f"the press of the {button} button")

    def release(self, button: str) -> Line:
        self.xdotool("mouseup", str(BUTTONS[button]))
        return self.until(lambda line: line["mouse"] == "idle", f"the release of the {button} button")

    def ask_to_close(self) -> None:
        """What a window manager does when the user clicks on the window's cross; xdotool needs one for that."""
        x11 = ctypes.CDLL("libX11.so.6")
        x11.XOpenDisplay.restype = ctypes.c_void_p
        x11.XInternAtom.restype = ctypes.c_ulong
        display = ctypes.c_void_p(x11.XOpenDisplay(self.screen.display.encode()))
        protocols, delete = (x11.XInternAtom(display, name, 0) for name in (b"WM_PROTOCOLS", b"WM_DELETE_WINDOW"))
        window = ctypes.c_ulong(int(self.window))
        message = ClientMessage(type=33, window=window, message_type=protocols, format=32)
        message.data[0] = delete
        x11.XSendEvent(display, window, 0, ctypes.c_long(0), ctypes.byref(message))
        x11.XCloseDisplay(display)

    def xdotool(self, *words: str) -> str:
        return subprocess.run(
            ["xdotool", *words], env=self._environment, check=True, capture_output=True, text=True
        ).stdout


@pytest.fixture(scope="session")
def screen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Screen]:
    """An X server of our own."""
    if shutil.which("Xvfb") is None:
        no_window("Xvfb is not installed")
    screen = Screen(tmp_path_factory.mktemp("screen"))
    yield screen
    screen.close()


@pytest.fixture
def desk(screen: Screen, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Desk]]:
    """Starts the program in a window: `desk("curtain", "--frames", "5")`."""
    if shutil.which("xdotool") is None:
        no_window("xdotool is not installed")
    monkeypatch.setenv("DISPLAY", screen.display)
    obstacle = window_obstacle()
    if obstacle:
        no_window(obstacle)
    with contextlib.ExitStack() as stack:

        def start(*arguments: str, command: str = "run") -> Desk:
            desk = Desk(screen, tmp_path, *arguments, command=command)
            stack.callback(desk.close)
            return desk

        yield start
