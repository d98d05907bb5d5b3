"""The one error a scene can have."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class SceneError(ValueError):
    """A scene file or an override is wrong: which file, which key, why, and the nearest valid name if there is one.

    Its text is a single line.
    """

    def __init__(self, file: str, key: str, reason: str, hint: str = "") -> None:
        self.file, self.key, self.reason, self.hint = file, key, reason, hint
        text = ": ".join(part for part in (file, key, reason) if part)
        super().__init__(one_line(text + (f" (did you mean {hint!r}?)" if hint else "")))


def one_line(text: str) -> str:
    """Control characters and line ends written as escapes, and nothing longer than a few lines of a terminal."""
    line = "".join(c if c.isprintable() else c.encode("unicode_escape", "replace").decode() for c in text)
    return line if len(line) <= 500 else line[:497] + "…"


def nearest(wrong: str, valid: Iterable[str]) -> str:
    """The valid name most like a mistyped one, or nothing."""
    found = difflib.get_close_matches(wrong, list(valid), n=1, cutoff=0.65)
    return found[0] if found else ""
