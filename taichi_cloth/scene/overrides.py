"""Keys changed from Python or the command line, before the scene is checked."""

from __future__ import annotations

from typing import Any

from .errors import SceneError, nearest
from .model import Part, Scene, keys_of, parts
from .toml import parse_toml

Place = tuple[Part | None, str]  # a section and a key of it; no section: a key of the scene itself


def parse_override(text: str) -> tuple[str, Any]:
    """KEY=VALUE from a command line; VALUE as in TOML, or else a plain text."""
    key, equals, value = (word.strip() for word in text.partition("="))
    if not equals or not key:
        raise SceneError("--set", text, "an override is written KEY=VALUE, as in wind_z=6")
    try:
        parsed = parse_toml(f"value = {value}")
    except (ValueError, RecursionError):
        return key, value
    return key, parsed["value"] if len(parsed) == 1 else value  # several: a text of several lines


def apply_override(data: dict[str, Any], key: str, value: Any, file: str) -> None:
    """Writes one override into parsed TOML that is a valid scene. Raises SceneError for a key that is not just one."""
    places = override_places()
    if key not in places:
        hint = nearest(key, places)
        raise SceneError(file, key, "unknown key" + ("" if hint else "; `taichi-cloth check --keys` lists them"), hint)
    meant = [place for place in places[key] if place[0] is None or place[0].name in data] or places[key]
    if len(meant) > 1:
        raise SceneError(file, key, "could be " + " or ".join(f"{part.one}_{key}" for part, _ in meant if part))
    [(part, name)] = meant
    if part is None:
        data[name] = value
    elif not part.many:
        data.setdefault(part.name, {})[name] = value
    elif data.get(part.name):
        data[part.name][0][name] = value
    else:
        raise SceneError(file, key, f"the scene has no {part.name}")


def override_places() -> dict[str, list[Place]]:
    """Every name an override may have, and the keys it can mean."""
    bare: dict[str, list[Place]] = {}
    full: dict[str, list[Place]] = {key: [(None, key)] for key in keys_of(Scene)}
    for part in parts().values():
        for key in keys_of(part.section):
            full[f"{part.one}_{key}"] = [(part, key)]
            bare.setdefault(key, []).append((part, key))
            if key in ("name", "preset"):
                full[part.one] = [(part, key)]
    return bare | full
