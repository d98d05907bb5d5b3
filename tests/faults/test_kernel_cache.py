"""A damaged cache of compiled kernels causes recompilation, never a crash."""

from __future__ import annotations

import os
import struct
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from taichi_cloth.system.taichi_runtime import INDEX, LOCK, LOCK_TIMEOUT, is_index_consistent, usable_cache_folder

Run = Callable[..., subprocess.CompletedProcess[str]]

ONE_KERNEL = """
from taichi_cloth.system import taichi_runtime as runtime
runtime.start()
import taichi as ti
field = ti.field(ti.f32, 4)
field.fill(2.0)
print(field[3])
"""


@pytest.fixture
def works(program: Run, tmp_path: Path) -> Callable[..., None]:
    """works(XDG_CACHE_HOME="…"): compiles and runs one kernel, and checks that no temporary folder remains."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()

    def once(**environment: str | None) -> None:
        done = program("-c", ONE_KERNEL, TMPDIR=str(temporary), **environment)
        assert (done.returncode, done.stdout, done.stderr) == (0, "2.0\n", "")
        assert list(temporary.iterdir()) == []

    return once


def test_a_file_in_place_of_the_cache_folder(program: Run, tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("mine")
    words = ["render", "drape15", "--frames", "1", "--size", "96x54", "--out", "o"]
    done = program(*words, XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "cache").read_text() == "mine"


def test_a_read_only_cache_folder(works: Callable[..., None], disk: Callable[..., Path]) -> None:
    works(XDG_CACHE_HOME=str(disk("cache", "size=64k,ro")))


def test_a_cache_folder_on_a_full_disk(works: Callable[..., None], disk: Callable[..., Path]) -> None:
    cache = disk("cache", "size=16k")
    for _ in range(2):  # the second reads what the first wrote
        works(XDG_CACHE_HOME=str(cache))


@pytest.mark.skipif(os.name != "posix", reason="Taichi uses another folder on other systems")
def test_a_user_without_a_home_folder(program: Run) -> None:
    nobody = "import os\ndef home(path): return path\nos.path.expanduser = home\n"
    done = program("-c", nobody + ONE_KERNEL, HOME=None, XDG_CACHE_HOME=None)
    assert (done.returncode, done.stdout, done.stderr) == (0, "2.0\n", "")


def test_truncated_kernels_a_damaged_index_and_the_lock_of_a_dead_process(
    works: Callable[..., None], tmp_path: Path
) -> None:
    works(XDG_CACHE_HOME=str(tmp_path))
    [folder] = tmp_path.glob("**/ticache")
    good = (folder / INDEX).read_bytes()
    for kernel in folder.glob("*.tic"):
        kernel.write_bytes(kernel.read_bytes()[:-100])
    works(XDG_CACHE_HOME=str(tmp_path))
    kernels_at = 8 + 3 * 2 + 8
    (folder / INDEX).write_bytes(good[:kernels_at] + struct.pack("<Q", 1 << 60) + good[kernels_at + 8 :])
    (folder / LOCK).touch()
    yesterday = time.time() - 86400
    for file in (folder / LOCK, *folder.glob("*.tic")):
        os.utime(file, (yesterday, yesterday))
    works(XDG_CACHE_HOME=str(tmp_path))
    assert not (folder / LOCK).exists()
    assert len((folder / INDEX).read_bytes()) == len(good)  # written again
    assert is_index_consistent((folder / INDEX).read_bytes())


def test_the_lock_of_a_process_that_writes_for_long_remains(tmp_path: Path) -> None:
    """While it writes, new kernels appear, and the lock stays as it is."""
    lock, kernel = tmp_path / LOCK, tmp_path / "a.tic"
    past = time.time() - 2 * LOCK_TIMEOUT
    for file in (lock, kernel):
        file.touch()
    os.utime(lock, (past, past))
    usable_cache_folder(tmp_path, lambda: None)
    assert lock.exists()
    os.utime(kernel, (past, past))
    usable_cache_folder(tmp_path, lambda: None)
    assert not lock.exists()


def index(*names: str) -> bytes:
    """An index as Taichi 1.7.4 writes it."""
    kernels = b"".join(2 * (struct.pack("<Q", len(n)) + n.encode()) + struct.pack("<3Q", 1, 2, 3) for n in names)
    rest = struct.pack("<3HQQ", 1, 7, 4, 100, len(names)) + kernels
    return struct.pack("<Q", 8 + len(rest)) + rest


def test_every_length_in_an_index_is_checked() -> None:
    content = index("first", "second")
    assert is_index_consistent(content)
    assert is_index_consistent(index())
    assert is_index_consistent(content[:-3])  # Taichi itself detects a truncated index by its total length
    lengths = [22, 30, 30 + 8 + 5]  # offsets of the number of kernels, and of both lengths of the first name
    for at in lengths:
        for byte in range(8):
            damaged: Any = bytearray(content)
            damaged[at + byte] ^= 0xFF
            assert not is_index_consistent(bytes(damaged))
