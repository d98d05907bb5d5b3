"""A folder's lock: one holder at a time, and nothing left of it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from taichi_cloth import lock
from taichi_cloth.lock import NAME, locked


def test_one_at_a_time_and_nothing_left(tmp_path: Path) -> None:
    for _ in range(2):
        with locked(tmp_path):
            with pytest.raises(BlockingIOError), locked(tmp_path):
                pass
            assert (tmp_path / NAME).exists()
        assert list(tmp_path.iterdir()) == []


def test_a_file_that_a_killed_run_left_keeps_nobody_out(tmp_path: Path) -> None:
    (tmp_path / NAME).touch()
    with locked(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="elsewhere an open file is not removed")
def test_a_file_that_its_holder_removes_while_the_next_one_opens_it_is_no_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken, real = [], lock._lock

    def removed_before(file: int) -> None:
        taken.append(file)
        if len(taken) == 1:
            (tmp_path / NAME).unlink()
        real(file)

    monkeypatch.setattr(lock, "_lock", removed_before)
    with locked(tmp_path):
        assert len(taken) == 2
        with pytest.raises(BlockingIOError), locked(tmp_path):
            pass
