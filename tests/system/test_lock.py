"""The lock of a folder: one holder at a time, and no file remains."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from taichi_cloth.system import files
from taichi_cloth.system.files import LOCK_FILE, folder_lock


def test_one_holder_at_a_time_and_no_file_remains(tmp_path: Path) -> None:
    for _ in range(2):
        with folder_lock(tmp_path):
            with pytest.raises(BlockingIOError), folder_lock(tmp_path):
                pass
            assert (tmp_path / LOCK_FILE).exists()
        assert list(tmp_path.iterdir()) == []


def test_the_lock_file_of_a_killed_run_does_not_block(tmp_path: Path) -> None:
    (tmp_path / LOCK_FILE).touch()
    with folder_lock(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="other systems do not remove an open file")
def test_a_lock_file_removed_while_the_next_holder_opens_it_is_no_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken, real = [], files._lock

    def removed_before(file: int) -> None:
        taken.append(file)
        if len(taken) == 1:
            (tmp_path / LOCK_FILE).unlink()
        real(file)

    monkeypatch.setattr(files, "_lock", removed_before)
    with folder_lock(tmp_path):
        assert len(taken) == 2
        with pytest.raises(BlockingIOError), folder_lock(tmp_path):
            pass
