"""The one error a scene can have, and how it is put into words."""

from __future__ import annotations

import datetime
import difflib
from collections.abc import Iterable
from typing import Any

from ..errors import one_line


class SceneError(ValueError):
    """A scene file or an override is wrong: which file, which key, why, and the nearest valid name if there is one.

    Its text is a single line: `FILE: KEY: REASON (did you mean HINT?)`.
    """

    def __init__(self, file: str, key: str, reason: str, hint: str = "") -> None:
        self.file, self.key, self.reason, self.hint = file, key, reason, hint
        text = ": ".join(part for part in (file, _clipped(key, 100), _clipped(reason, 400)) if part)
        super().__init__(one_line(text + (f" (did you mean {hint!r}?)" if hint else "")))


class PinError(ValueError):
    """A cloth has no such pin; `name` is what was asked for by name, of those that are `known`."""

    def __init__(self, reason: str, name: str = "", known: Iterable[str] = ()) -> None:
        self.name, self.known = name, tuple(known)
        super().__init__(one_line(reason))


def shown(value: Any) -> str:
    """A wrong value much as it was written, but never long."""
    if isinstance(value, (bool, datetime.date, datetime.time)):
        return str(value).lower()
    try:
        return _clipped(repr(value), 60)
    except (ValueError, RecursionError):  # thousands of digits, or of brackets
        return f"something too long to show ({type(value).__name__})"


def nearest(wrong: str, valid: Iterable[str]) -> str:
    """The valid name most like a mistyped one, or nothing."""
    found = difflib.get_close_matches(wrong, list(valid), n=1, cutoff=0.65)
    return found[0] if found else ""


def _clipped(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"
