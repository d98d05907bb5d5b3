"""A scene back as TOML, every key that it has a use for written out."""

from __future__ import annotations

import json
from typing import Any

from .model import GRID_KEYS, Cloth, Scene, keys_of, parts


def scene_to_toml(scene: Scene, table: str = "") -> str:
    """The whole scene as a TOML text that `load_scene` reads back to an equal scene.

    With the name of a `table` it is one, for a larger file.
    """
    within = f"{table}." if table else ""
    lines = [f"[{table}]"] * bool(table) + _keys(scene)
    for part in parts().values():
        value = getattr(scene, part.name)
        if part.many:
            for one in value:
                lines += ["", f"[[{within}{part.name}]]", *_keys(one)]
        elif value is not None:
            lines += ["", f"[{within}{part.name}]", *_keys(value)]
    return "\n".join(lines) + "\n"


def toml_value(value: Any) -> str:
    """A value of a scene as TOML writes it."""
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, str):  # TOML's basic strings escape as JSON's do
        return json.dumps(value, ensure_ascii=False)
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _keys(section: Any) -> list[str]:
    return [
        f"{name} = {toml_value(getattr(section, name))}" + (f"  # {key.unit}" if key.unit else "")
        for name, key in keys_of(type(section)).items()
        if not (isinstance(section, Cloth) and section.file and name in GRID_KEYS)
    ]
