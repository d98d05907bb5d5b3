"""A real browser without a window, controlled through a pipe by its DevTools protocol."""

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
START = "import os, sys; _, r, w, *argv = sys.argv; os.dup2(int(r), 3); os.dup2(int(w), 4); os.execvp(argv[0], argv)"
TIMEOUT = 120_000  # [ms] reached only by tests that fail
READY = f"""new Promise((done, fail) => {{
  const end = Date.now() + {TIMEOUT};
  const poll = () => %s ? done(true) : Date.now() > end ? fail("timeout") : setTimeout(poll, 20);
  poll();
}})"""
EVENTS = ("Runtime.exceptionThrown", "Log.entryAdded", "Network.requestWillBeSent")

Message = dict[str, Any]


class Pipe:
    """The connection to a browser, shared by all its pages."""

    def __init__(self, program: str, folder: Path) -> None:
        # The browser reads from its file descriptor 3 and writes to 4.
        to_read, self._write = os.pipe()
        self._read, to_write = os.pipe()
        command = [program, *OPTIONS, f"--user-data-dir={folder}", f"--window-size={SIZE[0]},{SIZE[1]}", "about:blank"]
        self._process = subprocess.Popen(
            [sys.executable, "-c", START, str(to_read), str(to_write), *command],
            pass_fds=[to_read, to_write],
            stderr=subprocess.DEVNULL,
        )
        os.close(to_read)
        os.close(to_write)
        self._number, self._rest = 0, b""
        self.pages: dict[str, Browser] = {}  # by session

    def call(self, method: str, session: dict[str, str], params: Message) -> Message:
        """Call a method of the protocol and return its result."""
        self._number += 1
        request = {"id": self._number, "method": method, "params": params, **session}
        os.write(self._write, json.dumps(request).encode() + b"\0")
        while True:
            message = self._next()
            if message.get("id") == self._number:
                assert "error" not in message, message
                return dict(message["result"])
            page = self.pages.get(message.get("sessionId", ""))
            if page is not None and message.get("method") in EVENTS:
                page.on_event(message["method"], message["params"])

    def _next(self) -> Message:
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
    """One page of a browser. `errors` and `requests` are those since the page was opened."""

    def __init__(self, pipe: Pipe, size: tuple[int, int] = SIZE) -> None:
        """`size`: of the page [pixels]."""
        self._pipe = pipe
        self.size = size
        self.errors: list[str] = []
        self.requests: list[str] = []
        self._target = pipe.call("Target.createTarget", {}, {"url": "about:blank"})["targetId"]
        attached = pipe.call("Target.attachToTarget", {}, {"targetId": self._target, "flatten": True})
        self._session = {"sessionId": attached["sessionId"]}
        pipe.pages[attached["sessionId"]] = self
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.call(
            "Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=1, mobile=False
        )
        self.call("Emulation.setFocusEmulationEnabled", enabled=True)  # so that no page is in the background

    def call(self, method: str, **params: Any) -> Message:
        """Call a method of the protocol and return its result."""
        return self._pipe.call(method, self._session, params)

    def another(self) -> Browser:
        """Open a second page."""
        return Browser(self._pipe, self.size)

    def kill(self) -> None:
        """Close the page without running its handlers."""
        self._pipe.call("Target.closeTarget", {}, {"targetId": self._target})

    def on_event(self, method: str, params: Message) -> None:
        """Store an error or a request."""
        if method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(params["exceptionDetails"]))
        elif params["entry"]["level"] == "error":
            self.errors.append(params["entry"]["text"])

    def open(self, target: Path | str, tail: str = "", ready: str = "document.querySelector('output')?.value") -> None:
        """Open a file or an address. Return when the JavaScript expression `ready` is true."""
        self.call("Page.navigate", url="about:blank")
        self.errors, self.requests = [], []
        self.call("Page.navigate", url=(target if isinstance(target, str) else target.as_uri()) + tail)
        self.value(READY % ready)

    def value(self, code: str) -> Any:
        """Return the value of a JavaScript expression; of a promise, once it is fulfilled."""
        answer = self.call("Runtime.evaluate", expression=code, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def until(self, code: str) -> None:
        """Wait until a JavaScript expression is true."""
        self.value(READY % f"({code})")

    def picture(self) -> NDArray[np.uint8]:
        """Return a screenshot, (height, width, RGB)."""
        png = base64.b64decode(self.call("Page.captureScreenshot")["data"])
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """Send a mouse event at a pixel. `kind`: Pressed, Released, Moved or Wheel."""
        self.call("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, **more)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag with the left button."""
        self.mouse("Pressed", *start, button="left", clickCount=1)
        self.mouse("Moved", *end, button="left", buttons=1)
        self.mouse("Released", *end, button="left", clickCount=1)

    def key(self, code: str, key: str) -> None:
        """Press and release a key."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, code=code, key=key)


def chromium(folder: Path) -> Pipe:
    """Start a browser whose files are in a folder. Without one, skip the test, or fail if REQUIRE_WINDOW=1."""
    program = next((path for path in map(shutil.which, NAMES) if path), "")
    if not program:
        no_window("Chromium is not installed")
    return Pipe(program, folder)
