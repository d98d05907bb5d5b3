"""Overrides of scene keys from Python or the command line, and scenes with some sections removed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from ..system.errors import SceneError, nearest_name, new_key, short_repr
from .keys import Section, keys_of
from .schema import Scene, sections
from .toml_io import parse_toml

KeyTarget = tuple[Section | None, str]  # a section and its key; None: a key of the scene itself


def parse_override(text: str) -> tuple[str, object]:
    """Return key and value of KEY=VALUE from a command line. VALUE is read as TOML, and as a string if it is not TOML.

    Raises SceneError if there is no key or no `=`.
    """
    key, equals, value = (word.strip() for word in text.partition("="))
    if not equals or not key:
        raise SceneError("--set", text, "must be KEY=VALUE, as in wind_z=6")
    try:
        parsed = parse_toml(f"value = {value}")
    except (ValueError, RecursionError):
        return key, value
    return key, parsed["value"] if len(parsed) == 1 else value  # several keys: VALUE had several lines


def is_section(key: str, value: object) -> bool:
    """Return whether an override is a section as a whole, or None for no such section."""
    part = sections().get(key)
    return part is not None and (value is None or isinstance(value, (dict, list, tuple, part.cls)))


def plain_tables(name: str, value: Any) -> Any:
    """Return a section with new dicts and lists in place of all dicts, tuples and objects of its class."""
    part = sections().get(name)
    if part is not None and isinstance(value, (list, tuple)):
        return [plain_tables(name, one) for one in value]
    table = value if part is None else part.table(value)
    return dict(table) if isinstance(table, dict) else table


def apply_override(data: dict[str, Any], key: str, value: Any, file: str) -> None:
    """Write one override into the parsed TOML of a valid scene. Raises SceneError for an unknown or ambiguous key."""
    if is_section(key, value):
        if value is None and sections()[key].optional:
            data.pop(key, None)
        else:
            data[key] = plain_tables(key, value)
        return
    names = override_targets()
    if key not in names:
        if (new := new_key(key)) in names:
            raise SceneError(file, key, f"was renamed to {new}")
        if key in sections():
            raise SceneError(file, key, f"must be a table, got {short_repr(value)}", nearest_name(key, names))
        hint = nearest_name(key, [*names, *sections()])
        raise SceneError(file, key, "unknown key" + ("" if hint else "; `taichi-cloth schema` lists them"), hint)
    targets = [target for target in names[key] if target[0] is None or target[0].name in data] or names[key]
    if len(targets) > 1:
        raise SceneError(
            file, key, "ambiguous: use " + " or ".join(f"{part.singular}_{key}" for part, _ in targets if part)
        )
    [(part, name)] = targets
    if part is None:
        data[name] = value
    elif not part.is_array:
        data.setdefault(part.name, {})[name] = value
    elif data.get(part.name):
        data[part.name][0][name] = value
    else:
        raise SceneError(file, key, f"the scene has no {part.name}")


def override_targets() -> dict[str, list[KeyTarget]]:
    """Return every name of an override, with the keys it can refer to: more than one if it is ambiguous."""
    bare: dict[str, list[KeyTarget]] = {}
    full: dict[str, list[KeyTarget]] = {key: [(None, key)] for key in keys_of(Scene)}
    for part in sections().values():
        for key in keys_of(part.cls):
            full[f"{part.singular}_{key}"] = [(part, key)]
            bare.setdefault(key, []).append((part, key))
            if key in ("name", "preset"):
                full[part.singular] = [(part, key)]
    return bare | full


NOT_REMOVABLE = ("attachments", "regions", "maps")  # optional sections that stay: they may pin the cloth


def removable_sections(scene: Scene) -> list[str]:
    """Return the sections of a scene that can be removed, in the order of the schema."""
    return [
        name
        for name, part in sections().items()
        if part.optional and getattr(scene, name) and name not in NOT_REMOVABLE
    ]


def scene_without(scene: Scene, names: Iterable[str]) -> Scene:
    """Return the scene without these sections. Raises SceneError for one that cannot be removed."""
    removed: dict[str, Any] = {}
    for name in names:
        section = name.replace("-", "_")
        removable = removable_sections(scene)
        if section not in removable:
            reason = f"{scene.name} has no such feature; removable: {', '.join(removable) or 'none'}"
            raise SceneError("", name, reason, nearest_name(section, removable))
        removed[section] = () if sections()[section].is_array else None
    return replace(scene, **removed)
