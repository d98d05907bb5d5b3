"""TOML from people: read in a time that grows with its length, not with its square."""

from __future__ import annotations

import re
import tomllib
from typing import Any

MOST_DOTS = 100  # in one key: a scene's have one
_BETWEEN_KEYS = re.compile(r"[,=\[\]{}#\n]|\.\.")  # two dots side by side are in no key


def parse_toml(text: str) -> dict[str, Any]:
    """What a TOML text says. Raises ValueError where it is none, and RecursionError where it is nested too deeply.

    `tomllib` copies the beginning of a dotted key for each of its dots: half a million of them are hours.
    """
    if any(part.count(".") > MOST_DOTS for part in _BETWEEN_KEYS.split(text)):
        raise ValueError(f"more than {MOST_DOTS} dots in one key")
    return tomllib.loads(text)
