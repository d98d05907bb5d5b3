"""Files written atomically, numbered names of new files, caches of arrays and of files, a lock on a folder, TOML."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from errno import EISDIR
from functools import cache
from glob import escape
from hashlib import sha256
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

PACKAGE = Path(__file__).parents[1]


@contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Write a file atomically: open a hidden file next to `path` for writing, and rename it to `path` at the end.

    After an error or an interrupt the hidden file is removed, and an older file at `path` is unchanged. Raises OSError.
    """
    with atomic_path(path) as part, part.open("wb") as file:
        yield file


@contextmanager
def atomic_path(path: str | os.PathLike[str], ending: str = ".part") -> Iterator[Path]:
    """Yield the path of a hidden file that is renamed to `path` at the end, for a library that opens files by name.

    After an error or an interrupt the hidden file is removed, and an older file at `path` is unchanged. Raises OSError.
    `ending` is the suffix of the hidden file.
    """
    target = Path(path)
    if not target.name:
        raise IsADirectoryError(EISDIR, os.strerror(EISDIR), str(target))
    part = target.with_name(f".{target.name}{ending}")
    try:
        yield part
        os.replace(part, target)
    except OSError as error:  # a failed write does not name its file
        raise OSError(error.errno, error.strerror, str(target)) from None
    finally:
        part.unlink(missing_ok=True)


def next_free_path(folder: Path, name: str) -> Path:
    """Return the path `NAME_001` in a folder, or the next number for which no file exists with any suffix."""
    stems = (f"{name}_{k:03d}" for k in count(1))
    return folder / next(s for s in stems if not (folder / s).exists() and not any(folder.glob(f"{escape(s)}.*")))


# -- cache of arrays, for solutions that take seconds to an hour -------------------------------------------------------


def cache_folder() -> Path:
    """Return the cache folder: `taichi_cloth` in XDG_CACHE_HOME, or in `.cache` of the home folder.

    Raises OSError for a user without a home folder.
    """
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "taichi_cloth"
    except RuntimeError as error:
        raise FileNotFoundError(str(error)) from None


def cached(what: str, make: Callable[[], NDArray[np.float64]], files: Iterable[Path] = ()) -> NDArray[np.float64]:
    """Return the result of `make()`, read from the cache if an earlier run of the same program stored it.

    The cache key is the text `what`, the contents of `files`, and the sources of the package: a result depends on all
    code that it calls. If the cache cannot be read or written (a damaged file, a full or read-only disk), the result is
    computed again.
    """
    import numpy as np  # here, because commands like `--help` start faster without it

    parts = [what, digest_of_sources(PACKAGE), *(sha256(file.read_bytes()).hexdigest() for file in files)]
    name = f"{sha256(repr(parts).encode()).hexdigest()[:32]}.npy"
    try:
        cached: NDArray[np.float64] = np.load(cache_folder() / name, allow_pickle=False)
        return cached
    except (OSError, ValueError, EOFError):
        result = make()
    try:
        cache_folder().mkdir(parents=True, exist_ok=True)
        with atomic_file(cache_folder() / name) as file:
            np.save(file, result)
    except OSError:
        pass
    return result


@cache
def digest_of_sources(package: Path) -> str:
    """Return the SHA-256 of the names and contents of all Python files in a folder and those below it."""
    found = [[path.relative_to(package).as_posix(), path.read_bytes()] for path in sorted(package.rglob("*.py"))]
    return sha256(repr(found).encode()).hexdigest()


# -- versions of files, for caches of what they contain ----------------------------------------------------------------

Version = tuple[tuple[str, int, int], ...]  # name, time of modification [ns] and size of each file

_versions: dict[Path, Version] = {}


def file_version(path: Path) -> Version:
    """Return the version of a file, or of all files that match a name with `*`, as it was at the first request.

    So a cache keeps what a running simulation has read, even while the file is edited. Empty if there is no file.
    """
    if path not in _versions:
        try:
            files = sorted(path.parent.glob(path.name)) if "*" in path.name else [path]
            status = [(file.name, file.stat()) for file in files]
        except (OSError, ValueError):  # whoever reads the file reports it
            return ()
        _versions[path] = tuple((name, one.st_mtime_ns, one.st_size) for name, one in status)
    return _versions[path]


@contextmanager
def new_versions(*paths: Path) -> Iterator[None]:
    """Let `file_version` look at these files again. If the block fails, the earlier versions remain in use."""
    earlier = {path: _versions.pop(path) for path in paths if path in _versions}
    try:
        yield
    except BaseException:
        _versions.update(earlier)
        raise


# -- lock on a folder --------------------------------------------------------------------------------------------------

LOCK_FILE = ".lock"


@contextlib.contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Lock an existing folder within the block. The lock file is removed at the end.

    On a file system without locks this has no effect. Raises BlockingIOError if another process holds the lock, and
    OSError if the file cannot be created.
    """
    path = folder / LOCK_FILE
    file = _acquire(path)
    try:
        yield
    finally:
        # Remove the file before the lock is released; Windows cannot remove an open file.
        if sys.platform == "win32":
            os.close(file)
        with contextlib.suppress(OSError):
            path.unlink()
        if sys.platform != "win32":
            os.close(file)


def _acquire(path: Path) -> int:
    """Return the descriptor of the locked file. Raises BlockingIOError, OSError."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _lock(file)
            # The previous owner may have removed the file after we opened it. The next process would create another.
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file), path.stat()):
                    return file
        except BaseException:
            os.close(file)
            raise
        os.close(file)


if sys.platform == "win32":
    import msvcrt

    def _lock(file: int) -> None:
        try:
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(*error.args) from None
else:
    import fcntl

    def _lock(file: int) -> None:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise
        except OSError:  # no locks on this file system
            pass


# -- TOML --------------------------------------------------------------------------------------------------------------

MAX_DOTS = 100  # in one key; those of a scene have one
_BETWEEN_KEYS = re.compile(r"[,=\[\]{}#\n]|\.\.")  # a key has no two adjacent dots


def parse_toml(text: str) -> dict[str, object]:
    """Parse a TOML text. Raises ValueError if it is invalid, and RecursionError if it is nested too deeply.

    `tomllib` copies the start of a dotted key for each dot, which takes quadratic time: hours for half a million dots.
    Keys with more than `MAX_DOTS` are therefore rejected first.
    """
    if any(part.count(".") > MAX_DOTS for part in _BETWEEN_KEYS.split(text)):
        raise ValueError(f"more than {MAX_DOTS} dots in one key")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        if repeated := re.fullmatch(r"Cannot (?:overwrite|declare) .*\(at line (\d+), column \d+\)", str(error)):
            number = int(repeated[1])
            key = text.split("\n")[number - 1].partition("=")[0].strip()
            raise ValueError(f"{key} is set twice (line {number})") from None
        if (at := re.search(r"at line (\d+)", str(error))) and (hint := _toml_hint(text.split("\n")[int(at[1]) - 1])):
            raise ValueError(f"{error}; {hint}") from None
        raise


def _toml_hint(line: str) -> str:
    """Return what to write instead of a line that is no TOML, or ""."""
    value = line.partition("=")[2].partition("#")[0].strip()
    if value in ("True", "False"):
        return f"write {value.lower()}"
    if re.fullmatch(r"[A-Za-z_][\w-]*", value):
        return f'text needs quotes: "{value}"'
    if re.fullmatch(r"[-+]?\d+,\d+", value):
        return f"write {value.replace(',', '.')}"
    if unit := re.fullmatch(r"([-+]?\d+(?:\.\d+)?)\s*[A-Za-z/°%²³]+", value):
        return f"write {unit[1]}, without a unit"
    return ""
