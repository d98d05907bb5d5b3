"""Errors that the command line prints as one line, helpers for messages, and old names with their new ones."""

import datetime
import difflib
import json
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any


class OutputConflict(ValueError):
    """The output folder contains files that this run must not overwrite or cannot continue. Exit code 2."""


class UsageError(ValueError):
    """The program, the scene or the machine does not support what the user requested. The message is one line.

    A ValueError. The exit code of commands is 2.
    """


class Diverged(RuntimeError):
    """The simulation diverged: particles are too fast, or positions are not finite. Exit code 1."""


def error_text(error: BaseException) -> str:
    """Return the message of an error. Errors of the system read `out/a.png: No space left on device`, without errno."""
    if not isinstance(error, OSError) or error.strerror is None:
        return str(error)
    return error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"


def one_line(text: str) -> str:
    """Return a text with line ends and control characters escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def shown_path(path: Path) -> Path:
    """Return a path for a message of one line: relative to the working folder if it is in it."""
    with suppress(OSError):  # the working folder may be gone
        if path.is_relative_to(Path.cwd()):
            return path.relative_to(Path.cwd())
    return path


def install_command(extra: str) -> str:
    """Return the command that installs the packages of an extra for the Python that runs.

    The project is not on a package index. pip installs it from a checkout, and stores from which.
    """
    # Here, because most runs need none of these.
    from importlib.metadata import PackageNotFoundError, distribution
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    python = f'"{sys.executable}"' if " " in sys.executable else sys.executable
    try:
        origin = json.loads(distribution("taichi-cloth").read_text("direct_url.json") or "{}")
    except PackageNotFoundError:
        origin = {}
    url = urlsplit(origin.get("url", ""))
    if url.scheme != "file":
        return f'{python} -m pip install ".[{extra}]" in the folder of the checkout'
    editable = "-e " if origin.get("dir_info", {}).get("editable") else ""
    return f'{python} -m pip install {editable}"{url2pathname(url.path)}[{extra}]"'


def print_note(line: str) -> None:
    """Print one line to stderr, after the name of the program."""
    print(f"taichi-cloth: {line}", file=sys.stderr, flush=True)


class SceneError(ValueError):
    """A scene or an override is invalid. The message is one line: `FILE: KEY: REASON (did you mean HINT?)`.

    A ValueError. `hint` is the nearest valid name, or "". Other mistakes of the same scene are `others`, and notes that
    a traceback shows below the message.
    """

    others: tuple["SceneError", ...] = ()
    """The other mistakes of the same scene, or of the same list."""

    def __init__(self, file: str, key: str, reason: str, hint: str = "") -> None:
        self.file, self.key, self.reason, self.hint = file, key, reason, hint
        text = ": ".join(part for part in (file, _clipped(key, 100), _clipped(reason, 400)) if part)
        super().__init__(one_line(text + (f" (did you mean {hint!r}?)" if hint else "")))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by its arguments: a process pool waits forever for an exception that cannot be unpickled."""
        return type(self), (self.file, self.key, self.reason, self.hint)


class PinError(ValueError):
    """A cloth does not have a pin. `name` is the missing group or region, `known` are the existing ones."""

    def __init__(self, reason: str, name: str = "", known: Iterable[str] = ()) -> None:
        self.name, self.known = name, tuple(known)
        super().__init__(one_line(reason))


MAX_NOTES = 10  # further mistakes that a traceback shows


class Mistakes(list[SceneError]):
    """The mistakes of one scene, in the order in which they are found. `file` is its name in messages.

    Reading continues after a mistake, with the default of the key. What follows from that default is not another
    mistake: a check of several keys is left out if one of them is wrong (`concern`).
    """

    def __init__(self, file: str) -> None:
        self.file = file

    def add(self, key: str, reason: str, hint: str = "") -> None:
        """Add a mistake, with the arguments of `SceneError`."""
        self.append(SceneError(self.file, key, reason, hint))

    @contextmanager
    def collect(self, key: str = "") -> Iterator[None]:
        """Add a SceneError that ends the block, or another ValueError as a mistake of `key`."""
        try:
            yield
        except SceneError as error:
            self += (error, *error.others)
        except PinError as error:
            self.add(key, str(error), nearest_name(error.name, error.known))
        except ValueError as error:
            self.add(key, str(error))

    def concern(self, *keys: str) -> bool:
        """Return whether one of these keys, its section or a part of it has a mistake, or was mistyped."""
        wrong = {name for error in self for name in (error.key, _sibling(error.key, error.hint)) if name}
        return any(_contains(a, b) or _contains(b, a) for a in wrong for b in keys)

    def raise_first(self) -> None:
        """Raise the first mistake if there is one, with all others."""
        if self:
            first, *others = self
            first.others = tuple(others)
            for other in others[:MAX_NOTES]:
                first.add_note(str(other))
            if len(others) > MAX_NOTES:
                first.add_note(f"and {len(others) - MAX_NOTES} more mistakes")
            raise first


def _sibling(key: str, name: str) -> str:
    """Return the key of that name in the same section, or "" without a name."""
    return key[: key.rfind(".") + 1] + name if name else ""


def _contains(outer: str, inner: str) -> bool:
    """Return whether a key, `spheres[0].center`, is another one or a part of it: `spheres`, `spheres[0]`."""
    return inner == outer or inner.startswith((f"{outer}.", f"{outer}["))


def short_repr(value: object) -> str:
    """Return an invalid value as text, close to how it was written and at most 60 characters long."""
    if isinstance(value, (bool, datetime.date, datetime.time)):
        return str(value).lower()
    try:
        return _clipped(" ".join(repr(value).split()), 60)
    except (ValueError, RecursionError):  # thousands of digits or brackets
        return f"a value too long to show ({type(value).__name__})"


OTHER_WORDS = {  # names that other programs use
    "density": "area_density", "mass": "area_density", "position": "center", "path": "file", "height": "length",
    "half_extents": "size", "r": "radius", "resolution": "rows",
}  # fmt: skip


def nearest_name(wrong: object, valid: Iterable[str]) -> str:
    """Return the valid name that a wrong one means: the same words in another order, or the most similar; or "".

    Capitals do not count, nor does the order of two letters.
    """
    text, names = str(wrong).lower(), list(valid)
    section, dot, key = text.rpartition(".")
    meant = section + dot + OTHER_WORDS.get(key, key)
    found = [name for name in names if name.lower() == meant or _words(name.lower()) == _words(text)]
    found = found or [name for name in names if _is_swapped(name.lower(), text)]
    found = found or difflib.get_close_matches(text, names, n=1, cutoff=0.65)
    return found[0] if found else ""


def _is_swapped(name: str, text: str) -> bool:
    """Return whether a text is a name in which two letters changed places."""
    wrong = sum(a != b for a, b in zip(name, text, strict=False))
    return sorted(name) == sorted(text) and wrong == 2


def _words(name: str) -> list[str]:
    return sorted(re.split("[-_]", name))


def nearest_hint(wrong: object, valid: Iterable[str]) -> str:
    """Return `; did you mean 'NAME'?` with the valid name most similar to a mistyped one, or ""."""
    found = nearest_name(wrong, valid)
    return f"; did you mean {found!r}?" if found else ""


FEW_NAMES = 12  # are all listed in a message, although one of them is near


def choose_from(wrong: object, valid: Iterable[str], renamed: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return the rest of a message after an unknown name: `: NAME, NAME; did you mean 'NAME'?`, or its new name.

    Many names are listed only if none of them is near.
    """
    if isinstance(wrong, str) and wrong in renamed:
        return f": it was renamed to {renamed[wrong]!r}"
    names = list(valid)
    hint = nearest_hint(wrong, names)
    return f": {', '.join(names)}{hint}" if len(names) <= FEW_NAMES or not hint else hint


def _clipped(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 1] + "…"


RENAMED_SECTIONS = {"springs": "verlet", "limit": "strain_limit", "tear": "tearing", "grips": "attachments"}

# By section; "" for all colliders and attachments.
RENAMED_KEYS = {
    ("cloth", "lumping"): "mass_lumping",
    ("cloth", "weight"): "corner_mass",
    ("cloth", "weight_at"): "corner_mass_at",
    ("cloth", "sheets"): "layers",
    ("cloth", "gap"): "layer_spacing",
    ("cloth", "turn"): "layer_rotation",
    ("regions", "low"): "min",
    ("regions", "high"): "max",
    ("maps", "stiffness_lo"): "stiffness_min",
    ("maps", "stiffness_hi"): "stiffness_max",
    ("maps", "max_distance_lo"): "max_distance_min",
    ("maps", "max_distance_hi"): "max_distance_max",
    ("fabric", "bend"): "bend_spring",
    ("fabric", "bending"): "bending_stiffness",
    ("strain_limit", "sweeps"): "iterations",
    ("self_collision", "stick"): "static_friction",
    ("self_collision", "contacts"): "primitives",
    ("look", "cloth"): "color",
    ("look", "check"): "second_color",
    ("look", "check_cells"): "pattern_scale",
    ("", "sway"): "oscillation",
    ("", "rock"): "rocking",
    ("", "path"): "keyframes",
    ("", "swept"): "continuous",
    ("", "against"): "collide_with",
    ("", "drawn"): "display_size",
}
RENAMED_SOLVERS = {"spring": "explicit", "projective": "implicit"}
RENAMED_LAYOUTS = {"list": "serial", "lanes": "simd", "gather": "parallel"}
RENAMED_OPTIONS = {
    "--path": "--layout",
    "--only": "--filter",
    "--starts": "--runs",
    "--full": "--all",
    "--long": "--soak",
    "--up": "--up-axis",
    "--pictures": "--image-dir",
    "--embed": "--print-iframe",
    "--stages": "--features",
    "--clip": "--frames A:B",
    "--html": "--out FILE.html",
}
RENAMED_COMMANDS = {"bake": "export --frames A:B"}


def new_key(name: str) -> str:
    """Return the new name of a key or section, or of an override `section_key`; empty if it was never renamed."""
    if name in RENAMED_SECTIONS:
        return RENAMED_SECTIONS[name]
    for old, new in RENAMED_SECTIONS.items():
        if name.startswith(f"{old}_"):
            rest = name.removeprefix(f"{old}_")
            return f"{new}_{RENAMED_KEYS.get((new, rest), rest)}"
    for (section, old), new in RENAMED_KEYS.items():
        if name == f"{section}_{old}" or (not section and name.endswith(f"_{old}")):
            return f"{name.removesuffix(old)}{new}"
    return next((new for (_, old), new in RENAMED_KEYS.items() if name == old), "")
