"""TOML of scenes: parsing in linear time, writing a scene with all its keys, and the table of all keys."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import fields

from .keys import keys_of, range_text, without_numpy
from .schema import GRID_KEYS, Cloth, Scene, sections

MAX_DOTS = 100  # in one key; those of a scene have one
_BETWEEN_KEYS = re.compile(r"[,=\[\]{}#\n]|\.\.")  # a key has no two adjacent dots


def parse_toml(text: str) -> dict[str, object]:
    """Parse a TOML text. Raises ValueError if it is invalid, and RecursionError if it is nested too deeply.

    `tomllib` copies the start of a dotted key for each dot, which takes quadratic time: hours for half a million dots.
    Keys with more than `MAX_DOTS` are therefore rejected first.
    """
    if any(part.count(".") > MAX_DOTS for part in _BETWEEN_KEYS.split(text)):
        raise ValueError(f"more than {MAX_DOTS} dots in one key")
    return tomllib.loads(text)


def scene_to_toml(scene: Scene, table: str = "") -> str:
    """Return a scene as a TOML text that `load_scene` reads back to an equal scene.

    With `table` the scene is written as a table of that name, as part of a larger file.
    """
    prefix = f"{table}." if table else ""
    lines = [f"[{table}]"] * bool(table) + _keys(scene)
    for part in sections().values():
        value = getattr(scene, part.name)
        if part.is_array:
            for element in value:
                lines += ["", f"[[{prefix}{part.name}]]", *_keys(element)]
        elif value is not None:
            lines += ["", f"[{prefix}{part.name}]", *_keys(value)]
    return "\n".join(lines) + "\n"


def toml_value(value: object) -> str:
    """Return a value of a scene in TOML syntax."""
    value = without_numpy(value)  # whose numbers have a `repr` that is no TOML
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, str):  # TOML basic strings have the escapes of JSON
        return json.dumps(value, ensure_ascii=False)
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _keys(section: object) -> list[str]:
    """Return a line for each key of a section, with its unit as a comment. Cloth from a mesh file has no grid keys."""
    cls: type = type(section)
    return [
        f"{name} = {toml_value(getattr(section, name))}" + (f"  # {key.unit}" if key.unit else "")
        for name, key in keys_of(cls).items()
        if not (isinstance(section, Cloth) and section.file and name in GRID_KEYS)
    ]


KeyRow = tuple[str, str, str, str, str, str]


def key_table() -> list[KeyRow]:
    """Return a row for each scene key: section, key, default, unit, range, help."""
    rows = _rows("", Scene)
    for part in sections().values():
        rows += _rows(f"[[{part.name}]]" if part.is_array else f"[{part.name}]", part.cls)
    return rows


def _rows(title: str, section: type) -> list[KeyRow]:
    defaults = {field.name: toml_value(field.default) for field in fields(section)}
    return [
        (title, name, defaults[name], key.unit, range_text(key), key.help) for name, key in keys_of(section).items()
    ]
