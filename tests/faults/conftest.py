"""The program in its own process, and small file systems that can be full or read-only."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from taichi_cloth import __main__ as cli

Run = Callable[..., subprocess.CompletedProcess[str]]
Disk = Callable[..., Path]
Refused = Callable[[list[str], str], None]


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Refused:
    """refused(["run", …], "message"): this command ends with code 2, and with one line that contains the message."""

    def check(words: list[str], message: str) -> None:
        try:
            code: object = cli.main(words)
        except SystemExit as ended:
            code = ended.code
        out, error = capsys.readouterr()
        assert (code, out, error.count("\n")) == (2, "", 1)
        assert error.startswith("taichi-cloth")
        assert message in error

    return check


@pytest.fixture
def program(tmp_path: Path) -> Run:
    """program("render", …, XDG_CACHE_HOME="…"): runs one command in the test's folder; None removes a variable."""

    def run(*words: str, **environment: str | None) -> subprocess.CompletedProcess[str]:
        changed = {k: v for k, v in {**os.environ, **environment}.items() if v is not None}
        command = [sys.executable, *(words if words[0] == "-c" else ("-m", "taichi_cloth", *words))]
        return subprocess.run(command, cwd=tmp_path, env=changed, capture_output=True, text=True, timeout=300)

    return run


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    """disk("name", "size=64k"): mounts a tmpfs with these options in the test's folder and returns its path."""
    mounted: list[Path] = []

    def mount(name: str, options: str) -> Path:
        if not hasattr(os, "geteuid") or os.geteuid() != 0 or shutil.which("mount") is None:
            pytest.skip("only root may mount a disk")
        path = tmp_path / name
        path.mkdir(exist_ok=True)
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", path], capture_output=True, text=True)
        if done.returncode != 0:
            pytest.skip(f"no disk can be mounted here: {done.stderr.strip()}")
        mounted.append(path)
        return path

    yield mount
    for path in mounted:
        subprocess.run(["umount", path], check=True)
