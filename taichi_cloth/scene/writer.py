"""A scene back as TOML, every key written out."""

from __future__ import annotations

import json
from dataclasses import fields, is_dataclass
from typing import Any

from .model import Scene


def scene_to_toml(scene: Scene) -> str:
    """The whole scene as a TOML text that `load_scene` reads back to an equal scene."""
    lines = _keys(scene)
    for part in fields(scene):
        value = getattr(scene, part.name)
        if is_dataclass(value):
            lines += ["", f"[{part.name}]", *_keys(value)]
        elif isinstance(value, tuple):
            for one in value:
                lines += ["", f"[[{part.name}]]", *_keys(one)]
    return "\n".join(lines) + "\n"


def _keys(section: Any) -> list[str]:
    lines = []
    for key in fields(section):
        if "key" in key.metadata:
            unit = key.metadata["key"].unit
            lines.append(f"{key.name} = {_toml(getattr(section, key.name))}" + (f"  # {unit}" if unit else ""))
    return lines


def _toml(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace(
            "\x7f", "\\u007f"
        )  # TOML's basic strings escape as JSON's do
    return str(value).lower() if isinstance(value, bool) else repr(value)
