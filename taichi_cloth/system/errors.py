"""Errors that the command line prints as one line, helpers for messages, and old names with their new ones."""

import datetime
import difflib
import sys
from collections.abc import Iterable


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


def print_note(line: str) -> None:
    """Print one line to stderr, after the name of the program."""
    print(f"taichi-cloth: {line}", file=sys.stderr, flush=True)


class SceneError(ValueError):
    """A scene or an override is invalid. The message is one line: `FILE: KEY: REASON (did you mean HINT?)`.

    A ValueError. `hint` is the nearest valid name, or "".
    """

    def __init__(self, file: str, key: str, reason: str, hint: str = "") -> None:
        self.file, self.key, self.reason, self.hint = file, key, reason, hint
        text = ": ".join(part for part in (file, _clipped(key, 100), _clipped(reason, 400)) if part)
        super().__init__(one_line(text + (f" (did you mean {hint!r}?)" if hint else "")))


class PinError(ValueError):
    """A cloth does not have a pin. `name` is the missing group or region, `known` are the existing ones."""

    def __init__(self, reason: str, name: str = "", known: Iterable[str] = ()) -> None:
        self.name, self.known = name, tuple(known)
        super().__init__(one_line(reason))


def short_repr(value: object) -> str:
    """Return an invalid value as text, close to how it was written and at most 60 characters long."""
    if isinstance(value, (bool, datetime.date, datetime.time)):
        return str(value).lower()
    try:
        return _clipped(repr(value), 60)
    except (ValueError, RecursionError):  # thousands of digits or brackets
        return f"a value too long to show ({type(value).__name__})"


def nearest_name(wrong: object, valid: Iterable[str]) -> str:
    """Return the valid name that is most similar to a mistyped one, or ""."""
    found = difflib.get_close_matches(str(wrong), list(valid), n=1, cutoff=0.65)
    return found[0] if found else ""


def nearest_hint(wrong: object, valid: Iterable[str]) -> str:
    """Return `; did you mean 'NAME'?` with the valid name most similar to a mistyped one, or ""."""
    found = nearest_name(wrong, valid)
    return f"; did you mean {found!r}?" if found else ""


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
RENAMED_SOLVERS = {"spring": "explicit"}
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
