"""Overrides of scene keys from Python or the command line, scenes with another solver or without some sections."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from typing import Any

from ..system.errors import Mistakes, SceneError, nearest_name, new_key
from ..system.files import parse_toml
from .keys import Section, given_table, keys_of
from .schema import COLLIDERS, GRID_KEYS, Cloth, Scene, sections
from .solver_catalog import SOLVER_CATALOG

KeyTarget = tuple[Section | None, str]  # a section and its key; None: a key of the scene itself

# A key as files and messages write it: `wind.z`, `spheres[1].radius`.
_DOTTED = re.compile(r"(?P<section>\w+)(?:\[(?P<index>\d{1,9})\])?\.(?P<key>\w+)", re.ASCII)


def parse_override(text: str, option: str = "--set") -> tuple[str, object]:
    """Return key and value of KEY=VALUE from a command line. VALUE is read as TOML, and as a string if it is not TOML.

    Raises SceneError, which names the `option`, if there is no key or no `=`.
    """
    key, equals, value = (word.strip() for word in text.partition("="))
    if not equals or not key:
        raise SceneError(option, text, "must be KEY=VALUE, as in wind.z=6")
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
    if part is None or not isinstance(value, (dict, part.cls)):
        return value
    table = given_table(value)
    if isinstance(value, Cloth) and value.file and table.keys() >= {*GRID_KEYS}:  # of a scene, with all keys
        table = {key: value for key, value in table.items() if key not in GRID_KEYS}
    return table


def apply_override(data: dict[str, Any], key: str, value: Any, file: str) -> None:
    """Write one override into the parsed TOML of a valid scene. Raises SceneError for an unknown or ambiguous key."""
    if is_section(key, value):
        mistakes = Mistakes(file)
        sections()[key].checked(value, mistakes)
        mistakes.raise_first()
        if value is None:
            data.pop(key, None)
        else:
            data[key] = plain_tables(key, value)
        return
    for one in sections().values():
        if one.is_array and key == one.singular and not isinstance(value, str):  # a string is its name
            raise SceneError(file, key, "is one of an array", f"{one.name}=[...]")
    name, index = _without_dots(key)
    names = override_targets()
    if name not in names and (found := _key_of_named_collider(data, name)):
        table, name = found
        table[name] = value
        return
    if name not in names:
        if part := sections().get(name):
            example = f"{part.name}.{next(iter(keys_of(part.cls)))}"
            reason = f"is a section: set one of its keys, such as {example}, or give it a table"
            off = value is False or (isinstance(value, str) and value.lower() in ("off", "none", "no"))
            without = f"; --without {part.name} leaves it out" if off and part.optional else ""
            raise SceneError(file, key, reason + without)
        if (new := new_key(name)) in names:
            raise SceneError(file, key, f"was renamed to {_dotted(new) if '.' in key else new}")
        known = [one for one, targets in names.items() if any(_is_in(part, data) for part, _ in targets)]
        hint = nearest_name(key, map(_dotted, known) if "." in key else [*known, *sections()])
        keys = next(
            (
                f"; [{one.name}] has {', '.join(keys_of(one.cls))}"
                for one in sections().values()
                if name.startswith(f"{one.singular}_")
            ),
            "; `taichi-cloth schema` lists them",
        )
        raise SceneError(file, key, "unknown key" + ("" if hint else keys), hint)
    in_file = [target for target in names[name] if target[0] is None or target[0].name in data]
    in_every_scene = [target for target in names[name] if target[0] and not target[0].optional]
    targets = in_file or in_every_scene or names[name]
    if len(targets) > 1:
        raise SceneError(
            file, key, "ambiguous: use " + " or ".join(f"{part.singular}_{name}" for part, _ in targets if part)
        )
    [(part, name)] = targets
    table = data if part is None else _table(data, part, index, file, key)
    table[name] = value


def _is_in(part: Section | None, data: dict[str, Any]) -> bool:
    """Return whether an override can set keys of a section: of an array of tables only if there is one."""
    return part is None or not part.is_array or part.name in data


def _key_of_named_collider(data: dict[str, Any], name: str) -> tuple[dict[str, Any], str] | None:
    """Return the table of a collider by its name, and the key, for an override such as "ball_radius"."""
    for section in COLLIDERS:
        for table in data.get(section, []):
            prefix = f"{table.get('name', '')}_"
            key = name.removeprefix(prefix)
            if prefix != "_" and key != name and key in keys_of(sections()[section].cls):
                return table, key
    return None


def _table(data: dict[str, Any], part: Section, index: int | None, file: str, key: str) -> dict[str, Any]:
    """Return the table of a section in parsed TOML; of an array of tables, the one with that index, or the first."""
    if not part.is_array:
        if index is not None:
            raise SceneError(file, key, f"[{part.name}] is a single table: leave out [{index}]")
        table: dict[str, Any] = data.setdefault(part.name, {})
        return table
    tables: list[dict[str, Any]] = data.get(part.name, [])
    if (index or 0) >= len(tables):
        raise SceneError(file, key, f"the scene has no {part.name}" + (f"[{index}]" if tables else ""))
    return tables[index or 0]


def _without_dots(key: str) -> tuple[str, int | None]:
    """Return the name of an override without dots, and its index: `sphere_radius` and 1 for `spheres[1].radius`."""
    found = _DOTTED.fullmatch(key)
    if found is None:
        return key, None
    part = sections().get(found["section"])
    section = part.singular if part else found["section"]
    return f"{section}_{found['key']}", None if found["index"] is None else int(found["index"])


def _dotted(name: str) -> str:
    """Return the name of an override as files write it: `wind.z` for `wind_z`; unchanged if it has no section."""
    [(part, key), *_] = override_targets()[name]
    return f"{part.name}.{key}" if part and name == f"{part.singular}_{key}" else name


@cache
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


def targets_of(key: str) -> list[KeyTarget]:
    """Return the keys that the name of an override can refer to, also one with dots; none if it is unknown."""
    return override_targets().get(_without_dots(key)[0], [])


def with_solver(scene: Scene, name: str, original: Scene) -> Scene:
    """Return the scene with a solver at its default substeps and iterations; the solver of `original` has its own.

    Damping and stiffness stay: they may come from a scene that was switched to.
    """
    substeps, iterations = SOLVER_CATALOG[name].defaults
    if name == original.solver.name:
        substeps, iterations = original.solver.substeps, original.solver.iterations
    return replace(scene, solver=replace(scene.solver, name=name, substeps=substeps, iterations=iterations))


# Optional sections that stay: the first three may pin the cloth, the last is its fabric.
NOT_REMOVABLE = ("attachments", "regions", "maps", "weave")


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
