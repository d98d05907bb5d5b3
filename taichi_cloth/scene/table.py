"""Every key of a scene file, for people."""

from __future__ import annotations

from dataclasses import fields
from typing import get_type_hints

from .model import Scene
from .reader import range_text, section_of

Row = tuple[str, str, str, str, str, str]


def key_table() -> list[Row]:
    """A row for each key: section, key, default, unit, range, help."""
    rows: list[Row] = []
    for name, hint in get_type_hints(Scene).items():
        section, many = section_of(hint)
        title = f"[[{name}]]" if many else f"[{name}]" if section else ""
        for key in fields(section or Scene):
            if "key" in key.metadata and (section or key.name == name):
                about = key.metadata["key"]
                rows.append((title, key.name, str(key.default), about.unit, range_text(about), about.help))
    return rows
