"""A real server in a process of its own."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

START = 120.0  # [s] kernels are compiled first


class Server:
    """`taichi-cloth web …`, from the line that says where it is."""

    def __init__(self, folder: Path, *words: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "taichi_cloth", "web", *words, "--port", "0"],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=folder,
        )
        self.said = ""
        assert self.process.stdout is not None
        while not (found := re.search(r"open (http://\S*?:(\d+)/\S*) in a browser", self.said)):
            line = self.process.stdout.readline()
            assert line, self.said
            self.said += line
        self.address, self.port = found[1], int(found[2])

    def get(self, path: str, port: int | None = None) -> tuple[int, str]:
        """Status and text of what a path answers."""
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port or self.port}{path}", timeout=30) as answer:
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as error:
            with error:
                return error.code, error.read().decode()

    @property
    def memory(self) -> float:
        """[MB] that it holds now; Linux tells."""
        status = Path(f"/proc/{self.process.pid}/status").read_text(encoding="utf-8")
        return int(re.findall(r"VmRSS:\s+(\d+)", status)[0]) / 1024

    def stop(self, number: int = signal.SIGTERM) -> tuple[int, str]:
        """Ends it, and returns its exit code and what it said last."""
        self.process.send_signal(number)
        rest, _ = self.process.communicate(timeout=8)
        return self.process.returncode, rest
