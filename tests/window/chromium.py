"""A real browser without a window, spoken to through a pipe in the words of its DevTools protocol."""

from __future__ import annotations

import base64
import io
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from screen import no_window

NAMES = ("chromium", "chromium-browser", "google-chrome")
SIZE = 640, 360  # [pixels]
OPTIONS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--remote-debugging-pipe")
START = "import os, sys; _, r, w, *words = sys.argv; os.dup2(int(r), 3); os.dup2(int(w), 4); os.execvp(words[0], words)"
PATIENCE = 60_000  # [ms]
READY = f"""new Promise((done, fail) => {{
  const end = Date.now() + {PATIENCE};
  const look = () => %s ? done(true) : Date.now() > end ? fail("it does not come true") : setTimeout(look, 20);
  look();
}})"""
TOLD = ("Runtime.exceptionThrown", "Log.entryAdded", "Network.requestWillBeSent")

Said = dict[str, Any]


class Pipe:
    """The way to a browser, which all its pages share."""

    def __init__(self, program: str, folder: Path) -> None:
        # It reads from its file descriptor 3 and writes to 4.
        to_read, self._write = os.pipe()
        self._read, to_write = os.pipe()
        words = [program, *OPTIONS, f"--user-data-dir={folder}", f"--window-size={SIZE[0]},{SIZE[1]}", "about:blank"]
        self._process = subprocess.Popen(
            [sys.executable, "-c", START, str(to_read), str(to_write), *words],
            pass_fds=[to_read, to_write],
            stderr=subprocess.DEVNULL,
        )
        os.close(to_read)
        os.close(to_write)
        self._number, self._rest = 0, b""
        self.pages: dict[str, Browser] = {}  # by the number of their session

    def say(self, method: str, session: dict[str, str], params: Said) -> Said:
        """Asks for something, and returns the answer."""
        self._number += 1
        words = {"id": self._number, "method": method, "params": params, **session}
        os.write(self._write, json.dumps(words).encode() + b"\0")
        while True:
            message = self._next()
            if message.get("id") == self._number:
                assert "error" not in message, message
                return dict(message["result"])
            page = self.pages.get(message.get("sessionId", ""))
            if page is not None and message.get("method") in TOLD:
                page.hear(message["method"], message["params"])

    def _next(self) -> Said:
        while b"\0" not in self._rest:
            more = os.read(self._read, 1 << 16)
            assert more, "the browser ended"
            self._rest += more
        line, _, self._rest = self._rest.partition(b"\0")
        return dict(json.loads(line))

    def close(self) -> None:
        self._process.terminate()
        self._process.wait()
        os.close(self._write)
        os.close(self._read)


class Browser:
    """One of its pages. `errors` and `requests` are those since it was opened."""

    def __init__(self, pipe: Pipe, size: tuple[int, int] = SIZE) -> None:
        """`size` of its picture [pixels]."""
        self._pipe = pipe
        self.size = size
        self.errors: list[str] = []
        self.requests: list[str] = []
        self._target = pipe.say("Target.createTarget", {}, {"url": "about:blank"})["targetId"]
        told = pipe.say("Target.attachToTarget", {}, {"targetId": self._target, "flatten": True})
        self._session = {"sessionId": told["sessionId"]}
        pipe.pages[told["sessionId"]] = self
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.say(f"{domain}.enable")
        self.say("Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=1, mobile=False)
        self.say("Emulation.setFocusEmulationEnabled", enabled=True)  # of several pages none is in the background

    def say(self, method: str, **params: Any) -> Said:
        """Asks for something, and returns the answer."""
        return self._pipe.say(method, self._session, params)

    def another(self) -> Browser:
        """A second page beside this one."""
        return Browser(self._pipe, self.size)

    def kill(self) -> None:
        """Ends the page without a word to it."""
        self._pipe.say("Target.closeTarget", {}, {"targetId": self._target})

    def hear(self, method: str, params: Said) -> None:
        if method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(params["exceptionDetails"]))
        elif params["entry"]["level"] == "error":
            self.errors.append(params["entry"]["text"])

    def open(self, place: Path | str, tail: str = "", ready: str = "document.querySelector('output')?.value") -> None:
        """Shows a file or an address, and comes back when JavaScript says that it is `ready`."""
        self.say("Page.navigate", url="about:blank")
        self.errors, self.requests = [], []
        self.say("Page.navigate", url=(place if isinstance(place, str) else place.as_uri()) + tail)
        self.value(READY % ready)

    def value(self, code: str) -> Any:
        """What JavaScript says in the page; of a promise, when it is kept."""
        told = self.say("Runtime.evaluate", expression=code, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in told, told
        return told["result"].get("value")

    def until(self, code: str) -> None:
        """Waits until it is true."""
        self.value(READY % f"({code})")

    def picture(self) -> NDArray[np.uint8]:
        """What is to be seen, (height, width, RGB)."""
        png = base64.b64decode(self.say("Page.captureScreenshot")["data"])
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """`kind`: Pressed, Released, Moved or Wheel, at a pixel."""
        self.say("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, **more)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """With the left button."""
        self.mouse("Pressed", *start, button="left", clickCount=1)
        self.mouse("Moved", *end, button="left", buttons=1)
        self.mouse("Released", *end, button="left", clickCount=1)

    def key(self, code: str, key: str) -> None:
        for kind in ("keyDown", "keyUp"):
            self.say("Input.dispatchKeyEvent", type=kind, code=code, key=key)


def chromium(folder: Path) -> Pipe:
    """A browser whose files are in a folder. Where there is none the test is skipped, or fails where it must not be."""
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        no_window("Chromium is not installed")
    return Pipe(program, folder)
