"""Results that take seconds to compute, kept on disk for the next run."""

from __future__ import annotations

import os
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..files import whole_file

Floats = NDArray[np.float64]


def folder() -> Path:
    """`taichi_cloth` in XDG_CACHE_HOME, or in the home's `.cache`. Raises OSError for a user who has no home."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "taichi_cloth"
    except RuntimeError as error:
        raise FileNotFoundError(str(error)) from None


def kept(what: str, code: Path, make: Callable[[], Floats]) -> Floats:
    """What `make` gives, or gave in an earlier run of the same `code`, a file or a folder of them, for the same `what`.

    A disk that is full or read-only, or a file that is torn, only costs the time to compute it again.
    """
    files = sorted(code.glob("*.py")) if code.is_dir() else [code]
    text = b"".join(file.read_bytes() for file in files)
    name = f"{sha256(what.encode() + text).hexdigest()[:32]}.npy"
    try:
        found: Floats = np.load(folder() / name, allow_pickle=False)
        return found
    except (OSError, ValueError, EOFError):
        made = make()
    try:
        folder().mkdir(parents=True, exist_ok=True)
        with whole_file(folder() / name) as file:
            np.save(file, made)
    except OSError:
        pass
    return made
