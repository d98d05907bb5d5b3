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
    """Where they are kept: `taichi_cloth` beside Taichi's own cache, or in XDG_CACHE_HOME."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "taichi_cloth"


def kept(what: str, code: Path, make: Callable[[], Floats]) -> Floats:
    """What `make` gives, or gave in an earlier run of the same `code` file for the same `what`.

    A disk that is full or read-only, or a file that is torn, only costs the time to compute it again.
    """
    path = folder() / f"{sha256(what.encode() + code.read_bytes()).hexdigest()[:32]}.npy"
    try:
        found: Floats = np.load(path, allow_pickle=False)
        return found
    except (OSError, ValueError, EOFError):
        made = make()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as file:
            np.save(file, made)
    except OSError:
        pass
    return made
