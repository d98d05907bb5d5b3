"""A real server in its own process."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path


class Server:
    """The process of `taichi-cloth web …`, once it has printed its address."""

    def __init__(self, folder: Path, *arguments: str, errors: bool = False) -> None:
        options = [] if errors else ["--no-errors"]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "taichi_cloth", "web", *arguments, "--port", "0", *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=folder,
        )
        self.output = ""
        assert self.process.stdout is not None
        while not (found := re.search(r"open (http://\S*?:(\d+)/\S*) in a browser", self.output)):
            line = self.process.stdout.readline()
            assert line, self.output
            self.output += line
        self.address, self.port = found[1], int(found[2])

    def get(self, path: str, port: int | None = None) -> tuple[int, str]:
        """Return status and text of the response to a GET request."""
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port or self.port}{path}", timeout=30) as answer:
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as error:
            with error:
                return error.code, error.read().decode()

    @property
    def memory(self) -> float:
        """Resident memory [MB], on Linux."""
        status = Path(f"/proc/{self.process.pid}/status").read_text(encoding="utf-8")
        return int(re.findall(r"VmRSS:\s+(\d+)", status)[0]) / 1024

    def stop(self, number: int = signal.SIGTERM) -> tuple[int, str]:
        """Send a signal. Return the exit code, and the output since the address."""
        self.process.send_signal(number)
        rest, _ = self.process.communicate(timeout=8)
        return self.process.returncode, rest
