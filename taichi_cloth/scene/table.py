"""Every key of a scene file, for people."""

from __future__ import annotations

from dataclasses import fields

from .model import Scene, keys_of, parts
from .values import range_text
from .writer import toml_value

Row = tuple[str, str, str, str, str, str]


def key_table() -> list[Row]:
    """A row for each key: section, key, default, unit, range, help."""
    rows = _rows("", Scene)
    for part in parts().values():
        rows += _rows(f"[[{part.name}]]" if part.many else f"[{part.name}]", part.section)
    return rows


def _rows(title: str, section: type) -> list[Row]:
    defaults = {field.name: toml_value(field.default) for field in fields(section)}
    return [
        (title, name, defaults[name], key.unit, range_text(key), key.help) for name, key in keys_of(section).items()
    ]
