"""Progress of long runs, on a terminal and in a log."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from taichi_cloth.system.console import check_output_file, frames_progress, new_file
from taichi_cloth.system.errors import UsageError


class Terminal(io.StringIO):
    """A terminal that stores what is printed."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_shows_that_kernels_are_compiled_until_the_first_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", terminal := Terminal())
    with frames_progress(3) as advance:
        assert "compiling kernels" in terminal.getvalue()
        advance(0)
        advance(1)
        end = len(terminal.getvalue())
        advance(2)
    last = terminal.getvalue()[end:]
    assert "3/3" in last
    assert "frames/s" in last
    assert "compiling" not in last


def test_the_rate_is_that_of_the_frames_after_the_first(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    times = iter([100.0, 100.5, 101.0])  # [s] at the end of each frame
    monkeypatch.setattr("time.perf_counter", lambda: next(times))
    with frames_progress(3) as advance:
        for k in range(3):
            advance(k)
    assert capsys.readouterr().out.splitlines() == ["frame 1/3", "frame 2/3, 2 frames/s", "frame 3/3, 2 frames/s"]


def test_a_log_has_few_lines(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    times = iter(range(40))
    monkeypatch.setattr("time.perf_counter", lambda: float(next(times)))
    with frames_progress(40) as advance:
        for k in range(40):
            advance(k)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 8
    assert lines[0] == "frame 5/40, 1 frames/s"
    assert lines[-1] == "frame 40/40, 1 frames/s"


def test_a_file_may_be_in_a_missing_folder_which_is_made_when_it_is_written(tmp_path: Path) -> None:
    check_output_file(tmp_path / "a" / "b" / "c.csv", force=False)
    assert list(tmp_path.iterdir()) == []
    with new_file(tmp_path / "a" / "b" / "c.csv") as file:
        file.write(b"1")
    assert (tmp_path / "a" / "b" / "c.csv").read_bytes() == b"1"
    (tmp_path / "file").touch()
    for name in ("file/c.csv", "file/a/c.csv"):
        with pytest.raises(UsageError, match=r"^cannot write c\.csv: .*file(/a)? is not a folder$"):
            check_output_file(tmp_path / name, force=True)
