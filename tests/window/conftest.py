"""A real screen for the real window: Xvfb for the display, xdotool for mouse and keys.

No test sleeps for a fixed time: `AppWindow.wait_until` follows the log of the program (`--log`), up to `TIMEOUT`.
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
from taichi_cloth.viewer.toolkit import window_obstacle

TIMEOUT = 120.0  # [s] reached only by tests that fail
AGAIN = 5.0  # [s] after which an event that was not seen is sent again
BUTTONS = {"left": 1, "middle": 2, "right": 3}

Entry = dict[str, Any]  # of the log, for one displayed frame


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


class AppWindow:
    """The program in its window, with mouse and keyboard. Screen points run from the bottom left, 0…1."""

    def __init__(
        self, screen: Screen, folder: Path, *arguments: str, command: str = "run", errors: bool = False
    ) -> None:
        self.screen = screen
        self.working_folder = folder / "working"
        self.working_folder.mkdir()
        self.temporary_folder = folder / "temporary"
        self.temporary_folder.mkdir()
        self._log = folder / "log.jsonl"
        self._errors = folder / "errors.txt"
        self._environment = os.environ | {
            "DISPLAY": screen.display,
            "PYTHONPATH": str(Path(taichi_cloth.__file__).parents[1]),
            "TMPDIR": str(self.temporary_folder),
        }
        self._read = 0
        self.last_entry: Entry = {}
        options = [] if errors or command == "replay" else ["--no-errors"]  # a second process for each window
        with self._errors.open("w") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "taichi_cloth", command, *arguments, *options, "--log", self._log],
                cwd=self.working_folder,
                env=self._environment,
                stdout=output,
                stderr=output,
            )
        self.wait_until(lambda line: True, "the first displayed frame")
        geometry = self.xdotool("search", "--name", "^taichi_cloth", "getwindowgeometry", "--shell")
        values = dict(pair.split("=") for pair in geometry.split())
        self.window_id = values["WINDOW"]
        self.left, self.top, self.width, self.height = (int(values[k]) for k in ("X", "Y", "WIDTH", "HEIGHT"))

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        for button in BUTTONS.values():  # the next test uses the same screen
            self.xdotool("mouseup", str(button))

    # -- output --------------------------------------------------------------------------------------------------------

    def new_entries(self) -> list[Entry]:
        """Return the entries of the log that were not read before."""
        text = self._log.read_text() if self._log.exists() else ""
        whole = text[: text.rfind("\n") + 1].splitlines()
        new, self._read = whole[self._read :], len(whole)
        return [json.loads(line) for line in new]

    def wait_until(
        self, condition: Callable[[Entry], Any], what: str, again: Callable[[], object] | None = None
    ) -> Entry:
        """Return the first entry from now on for which `condition` is true. Call `again` every `AGAIN` until then."""
        end = time.monotonic() + TIMEOUT
        next_call = time.monotonic() + AGAIN
        while time.monotonic() < end:
            ended = self.process.poll() is not None
            for line in self.new_entries():
                self.last_entry = line
                if condition(line):
                    return line
            if ended:
                pytest.fail(f"the program ended before {what}:\n{self._errors.read_text()}")
            if again and time.monotonic() > next_call:
                again()
                next_call += AGAIN
            time.sleep(0.01)
        pytest.fail(f"{what} did not happen; the last entry was {self.last_entry}")

    def latest_entry(self) -> Entry:
        """Return the entry of a displayed frame that includes all input up to now."""
        self.new_entries()
        displayed = self.last_entry["displayed"]
        return self.wait_until(lambda line: line["displayed"] >= displayed + 3, "three more displayed frames")

    def screenshot(self) -> NDArray[np.int16]:
        """Return the window as it is on the screen, (height, width, RGB)."""
        self.latest_entry()
        rows, columns = slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)
        return self.screen.pixels()[rows, columns].astype(np.int16)

    def exit_code(self) -> int:
        """Wait until the program ends. Return its exit code."""
        return self.process.wait(TIMEOUT)

    def output(self) -> list[str]:
        """Return the lines that the program printed, including errors."""
        return self._errors.read_text().splitlines()

    # -- input ---------------------------------------------------------------------------------------------------------

    def press_key(self, *names: str) -> None:
        self.xdotool("key", *names)

    @contextlib.contextmanager
    def hold_key(self, key: str) -> Iterator[None]:
        self.xdotool("keydown", key)
        yield
        self.xdotool("keyup", key)

    def move_mouse(self, u: float, v: float) -> None:
        """Move the mouse, and wait until the program reports the new position.

        A single event may be lost on a busy machine. A hand sends many, so the mouse arrives anew until it is seen.
        """
        x, y = round(u * self.width), round((1 - v) * self.height)

        def arrive() -> None:
            for beside in (1, 0):  # a position where the mouse already is would be no event
                self.xdotool("mousemove", str(self.left + x + beside), str(self.top + y))

        arrive()

        def has_arrived(line: Entry) -> bool:
            seen_x, seen_y = line["cursor"][0] * self.width, (1 - line["cursor"][1]) * self.height
            return abs(seen_x - x) < 1.5 and abs(seen_y - y) < 1.5

        self.wait_until(has_arrived, f"the cursor at {u:.3f}, {v:.3f}", arrive)

    def press_mouse(self, button: str) -> Entry:
        """Press a button. Return the first entry that includes it."""
        self.xdotool("mousedown", str(BUTTONS[button]))
        return self.wait_until(lambda line: line["mouse"] != "idle", f"the press of the {button} button")

    def release_mouse(self, button: str) -> Entry:
        """Release a button. Return the first entry that includes it."""
        self.xdotool("mouseup", str(BUTTONS[button]))
        return self.wait_until(lambda line: line["mouse"] == "idle", f"the release of the {button} button")

    def request_close(self) -> None:
        """Close the window as a window manager does. xdotool needs a window manager for that."""
        x11 = ctypes.CDLL("libX11.so.6")
        x11.XOpenDisplay.restype = ctypes.c_void_p
        x11.XInternAtom.restype = ctypes.c_ulong
        display = ctypes.c_void_p(x11.XOpenDisplay(self.screen.display.encode()))
        protocols, delete = (x11.XInternAtom(display, name, 0) for name in (b"WM_PROTOCOLS", b"WM_DELETE_WINDOW"))
        window = ctypes.c_ulong(int(self.window_id))
        message = ClientMessage(type=33, window=window, message_type=protocols, format=32)
        message.data[0] = delete
        x11.XSendEvent(display, window, 0, ctypes.c_long(0), ctypes.byref(message))
        x11.XCloseDisplay(display)

    def xdotool(self, *arguments: str) -> str:
        """Run xdotool and return its output."""
        return subprocess.run(
            ["xdotool", *arguments], env=self._environment, check=True, capture_output=True, text=True
        ).stdout


@pytest.fixture(scope="session")
def screen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Screen]:
    """A virtual screen."""
    if shutil.which("Xvfb") is None:
        no_window("Xvfb is not installed")
    screen = Screen(tmp_path_factory.mktemp("screen"))
    yield screen
    screen.close()


@pytest.fixture
def open_window(screen: Screen, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., AppWindow]]:
    """Start the program in a window: `open_window("curtain", "--frames", "5")`."""
    if shutil.which("xdotool") is None:
        no_window("xdotool is not installed")
    monkeypatch.setenv("DISPLAY", screen.display)
    obstacle = window_obstacle()
    if obstacle:
        no_window(obstacle)
    with contextlib.ExitStack() as stack:

        def start(*arguments: str, **how: Any) -> AppWindow:
            app = AppWindow(screen, tmp_path, *arguments, **how)
            stack.callback(app.close)
            return app

        yield start
