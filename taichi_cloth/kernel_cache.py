"""The folder in which Taichi keeps compiled kernels from one run to the next.

Taichi 1.7 ends the process (SIGSEGV, SIGABRT) at its exit where it cannot make that folder, and on the first kernel
where the index in it is damaged; a lock that a killed process left there keeps it from ever reading or writing again.
"""

from __future__ import annotations

import atexit
import contextlib
import shutil
import struct
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

INDEX, LOCK = "ticache.tcb", "ticache.lock"
LONGEST_LOCK = 60.0  # [s] Taichi holds it while it reads or writes the folder: seconds at most


def sound_folder(usual: Path, before_exit: Callable[[], None]) -> Path:
    """`usual`, made ready for Taichi, or else a temporary folder for this process alone.

    `before_exit` must end Taichi, which writes into its folder once more: then the temporary one is removed.
    Raises OSError where there is no room for temporary files either.
    """
    try:
        usual.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=usual):
            pass
        _mend(usual)
        return usual
    except OSError:
        folder = tempfile.mkdtemp(prefix="taichi_cloth_kernels_")

    def remove() -> None:
        before_exit()
        shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return Path(folder)


def _mend(folder: Path) -> None:
    """Takes away a dead process's lock, and a damaged index, whose kernels are compiled again. Raises OSError."""
    lock, index = folder / LOCK, folder / INDEX
    with contextlib.suppress(FileNotFoundError):
        if time.time() - lock.stat().st_mtime > LONGEST_LOCK:
            lock.unlink()
    with contextlib.suppress(FileNotFoundError):
        if not index_is_sound(index.read_bytes()):
            index.unlink()


def index_is_sound(content: bytes) -> bool:
    """Whether every length in Taichi 1.7's index fits; what it notices itself, a whole length or a version that is
    another's, counts as sound.

    The index is its length, a version of three 16-bit numbers, the size of the folder, and a count of kernels, each
    with its name twice, its size and two times. Lengths and counts have 64 bits and stand before what they count.
    """
    head = struct.calcsize("<Q3HQQ")
    if len(content) < head:
        return True
    whole, *version, _, kernels = struct.unpack_from("<Q3HQQ", content)
    length = len(content)
    if whole != length or version[:2] != [1, 7]:
        return True
    at = head
    for _ in range(kernels):
        for _ in range(2):
            if at + 8 > length:
                return False
            at += 8 + int.from_bytes(content[at : at + 8], "little")
        at += 3 * 8
        if at > length:
            return False
    return at == length
