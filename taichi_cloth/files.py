"""Files that are whole or not there."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from glob import escape
from itertools import count
from pathlib import Path
from typing import BinaryIO


@contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Opens a hidden file beside `path` for writing, and renames it to `path` at the end.

    After an error or an interrupt nothing is left and an older file at `path` is untouched. Raises OSError.
    """
    with whole_path(path) as part, part.open("wb") as file:
        yield file


@contextmanager
def whole_path(path: str | os.PathLike[str], ending: str = ".part") -> Iterator[Path]:
    """The hidden file itself, for a library that opens files by their names; `ending` is that of its name."""
    target = Path(path)
    part = target.with_name(f".{target.name}{ending}")
    try:
        yield part
        os.replace(part, target)
    except OSError as error:  # a write that fails does not know its file's name
        raise OSError(error.errno, error.strerror, str(target)) from None
    finally:
        part.unlink(missing_ok=True)


def new_name(folder: Path, name: str) -> Path:
    """`NAME_001`, or with the first number after it of which nothing is there, whatever the ending."""
    stems = (f"{name}_{k:03d}" for k in count(1))
    return folder / next(s for s in stems if not (folder / s).exists() and not any(folder.glob(f"{escape(s)}.*")))
