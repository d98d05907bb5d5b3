"""From TOML to a `Scene`, checked key by key against the metadata in `model.py`."""

from __future__ import annotations

import re
import tomllib
from dataclasses import fields, is_dataclass
from math import isfinite
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

from ..mesh.grid import CORNERS, EDGES, pinned
from .errors import SceneError, nearest
from .library import scene_path
from .model import SOLVER_NAMES, Key, Scene, Vec3

MOST_BYTES = 1_000_000  # a scene file is a page of text
MOST_COLLIDERS = 16  # of one kind

_KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text in quotes"}


def load_scene(name_or_path: str | Path, **overrides: Any) -> Scene:
    """A shipped scene by name, or a TOML file by path, with keys changed by `overrides`.

    An override is named `section_key` (`wind_z=6`, `cloth_rows=12`), by the key alone where only one
    section has it (`substeps=10`), or by a section for its name (`solver="verlet"`). For spheres and boxes
    it changes the first (`sphere_radius=0.4`). A section the scene lacks is added with its defaults.

    Raises SceneError, one line with file, key, reason and the nearest valid name.
    """
    path = scene_path(name_or_path)
    data = _parse(path)
    scene = _section(Scene, data, str(name_or_path), "", name=path.stem)
    if overrides:
        for key, value in overrides.items():
            _override(data, key, value, f"{name_or_path} (override)")
        scene = _section(Scene, data, f"{name_or_path} (override)", "", name=path.stem)
    return _consistent(scene, str(name_or_path))


def parse_override(text: str) -> tuple[str, Any]:
    """KEY=VALUE from a command line; VALUE as in TOML, or else a plain text."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise SceneError("--set", text, "an override is written KEY=VALUE, as in wind_z=6")
    try:
        return key.strip(), tomllib.loads(f"value = {value}")["value"]
    except (tomllib.TOMLDecodeError, RecursionError):
        return key.strip(), value.strip()


def check_value(value: Any, hint: Any, key: Key, file: str, where: str) -> Any:
    """`value` as the type and within the range that its key declares. Raises SceneError."""
    if hint == Vec3:
        if not isinstance(value, (list, tuple)) or len(value) != 3:
            raise SceneError(file, where, f"three numbers are needed, as in [0.0, 1.0, 0.0], not {value!r}")
        return tuple(check_value(v, float, key, file, f"{where}[{k}]") for k, v in enumerate(value))
    if get_origin(hint) is tuple:  # pins
        if not isinstance(value, (list, tuple)):
            raise SceneError(file, where, f'a list is needed, as in ["top", 17], not {value!r}')
        return tuple(_pin(v, file, f"{where}[{k}]") for k, v in enumerate(value))
    wanted = (int, float) if hint is float else (hint,)
    if not isinstance(value, wanted) or (isinstance(value, bool) and hint is not bool):
        raise SceneError(file, where, f"{_KINDS[hint]} is needed, not {value!r}")
    if hint in (int, float):
        if not -1e300 < value < 1e300 or not isfinite(value):
            raise SceneError(file, where, f"a finite number is needed, not {value}")
        if not in_range(value, key):
            raise SceneError(file, where, f"{value} is out of range: {range_text(key)}")
    return hint(value)


def in_range(value: float, key: Key) -> bool:
    """Whether a number lies in the range its key declares."""
    if key.low is not None and (value <= key.low if key.above_low else value < key.low):
        return False
    return key.high is None or value <= key.high


def range_text(key: Key) -> str:
    """The range in words, with its unit."""
    if key.low is None and key.high is None:
        return ""
    lower = f"above {key.low:g}" if key.above_low else f"{key.low:g}"
    return f"{lower} to {key.high:g}" + (f" {key.unit}" if key.unit else "")


def section_of(hint: Any) -> tuple[type | None, bool]:
    """The dataclass in an annotation, and whether it stands for a list of them: `Wind | None`, `tuple[Box, ...]`."""
    inner = [a for a in (get_args(hint) or (hint,)) if a not in (NoneType, ...)]
    if len(inner) == 1 and isinstance(inner[0], type) and is_dataclass(inner[0]):
        return inner[0], get_origin(hint) is tuple
    return None, False


def _parse(path: Path) -> dict[str, Any]:
    file = str(path)
    try:
        if path.is_dir():
            raise SceneError(file, "", "is a folder, not a scene file")
        if path.stat().st_size > MOST_BYTES:
            raise SceneError(file, "", f"is larger than {MOST_BYTES} bytes, which no scene is")
        return tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        if isinstance(error, SceneError):
            raise
        if isinstance(error, UnicodeDecodeError):
            reason = "is not UTF-8 text"
        elif isinstance(error, tomllib.TOMLDecodeError):
            reason = f"is not valid TOML: {error}"
        elif isinstance(error, OSError) and error.strerror:
            reason = f"cannot be read: {error.strerror}"
        else:
            reason = f"cannot be read: {error}"
        raise SceneError(file, "", reason) from None


def _section(section: type, data: Any, file: str, where: str, **derived: Any) -> Any:
    """One dataclass from one TOML table; `where` is the table's name in messages."""
    if not isinstance(data, dict):
        raise SceneError(file, where, f"a table [{where}] is needed, not {data!r}")
    hints = get_type_hints(section)
    known = {f.name: f for f in fields(section) if "derived" not in f.metadata}
    values = dict(derived)
    for name, value in data.items():
        place = f"{where}.{name}" if where else name
        if name not in known:
            hint = nearest(name, known)
            raise SceneError(file, place, "unknown key" + ("" if hint else f"; known here: {', '.join(known)}"), hint)
        part, many = section_of(hints[name])
        if part is None:
            values[name] = check_value(value, hints[name], known[name].metadata["key"], file, place)
        elif not many:
            values[name] = _section(part, value, file, place)
        elif not isinstance(value, list):
            raise SceneError(file, place, f"write [[{name}]] with two brackets: a scene may have several")
        elif len(value) > MOST_COLLIDERS:
            raise SceneError(file, place, f"{len(value)} are too many: at most {MOST_COLLIDERS}")
        else:
            values[name] = tuple(_section(part, v, file, f"{place}[{k}]") for k, v in enumerate(value))
    return section(**values)


def _pin(value: Any, file: str, where: str) -> str | int:
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    names = (*EDGES, *CORNERS)
    if isinstance(value, str) and value in names:
        return value
    hint = nearest(value, names) if isinstance(value, str) else ""
    reason = f"{value!r} is no pin: an edge or corner ({', '.join(names)}) or the index of a particle"
    raise SceneError(file, where, reason, hint)


def _consistent(scene: Scene, file: str) -> Scene:
    """What no key can say alone."""
    try:
        pinned(scene.cloth.rows, scene.cloth.columns, scene.cloth.pins)
    except ValueError as error:
        raise SceneError(file, "cloth.pins", str(error)) from None
    if scene.solver.name not in SOLVER_NAMES:
        reason = f"unknown solver {scene.solver.name!r}: {', '.join(SOLVER_NAMES)}"
        raise SceneError(file, "solver.name", reason, nearest(scene.solver.name, SOLVER_NAMES))
    for name in ("cloth", "check"):
        colour = getattr(scene.look, name)
        if not re.fullmatch("#[0-9a-fA-F]{6}", colour):
            raise SceneError(file, f"look.{name}", f"a colour is written #rrggbb, as in #b5303c, not {colour!r}")
    (x, y, z), (tx, ty, tz) = scene.camera.eye, scene.camera.target
    if (x, z) == (tx, tz):
        what = "is the target" if y == ty else "is straight above or below the target, where no side is up"
        raise SceneError(file, "camera.eye", what)
    return scene


# -- overrides ---------------------------------------------------------------------------------------------


def override_places() -> dict[str, list[tuple[str, str]]]:
    """Every name an override may use, with the (section, key) places it may mean; section "" is the top."""
    places: dict[str, list[tuple[str, str]]] = {}
    for field, hint in get_type_hints(Scene).items():
        part, many = section_of(hint)
        if part is None:
            if field != "name":
                places.setdefault(field, []).append(("", field))
            continue
        short = {"spheres": "sphere", "boxes": "box"}.get(field, field) if many else field
        for key in fields(part):
            places.setdefault(f"{short}_{key.name}", []).insert(0, (field, key.name))
            if not many:
                places.setdefault(key.name, []).append((field, key.name))
        if any(key.name == "name" for key in fields(part)):
            places[short] = [(field, "name")]
    return places


def _override(data: dict[str, Any], key: str, value: Any, file: str) -> None:
    """Writes one override into parsed TOML."""
    places = override_places()
    if key not in places:
        raise SceneError(file, key, "unknown key", nearest(key, places))
    full = [place for place in places[key] if key in (f"{place[0]}_{place[1]}", place[0])]
    meant = full or places[key]
    if len(meant) > 1:
        raise SceneError(file, key, "could be " + " or ".join(f"{section}_{name}" for section, name in meant))
    section, name = meant[0]
    if not section:
        data[name] = value
    elif section in ("spheres", "boxes"):
        if not data.get(section):
            raise SceneError(file, key, f"the scene has no {section}")
        data[section] = [{**data[section][0], name: value}, *data[section][1:]]
    else:
        data[section] = {**data.get(section, {}), name: value}
