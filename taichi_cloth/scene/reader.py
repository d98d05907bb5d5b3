"""Reads scenes from TOML, and writes them. Checks each key against its metadata in `schema.py`, then keys against each
other.
"""

from __future__ import annotations

from dataclasses import fields, replace
from math import hypot
from pathlib import Path
from typing import Any, TypeVar

from ..system.errors import Mistakes, SceneError, nearest_name, short_repr
from ..system.files import parse_toml
from .collider_schema import PROJECTION, RESPONSES, ContactProperties, Mesh, RoundCollider
from .fabric_schema import check_model
from .keys import check_table, check_value, given_table, keys_of, range_text, toml_value, types_of
from .overrides import apply_override, is_section, plain_tables, targets_of
from .presets import PRESET_KEYS, is_file_name, is_map_name, load_preset, mesh_names, preset_values, scene_path
from .schema import COLLIDERS, GRID_KEYS, MAP_NAMES, Cloth, Maps, Scene, sections

MAX_BYTES = 3_000_000  # of a scene file; three maps of `MAX_WEIGHTS` numbers fit
SOLVER_DEFAULT_KEYS = ("substeps", "iterations")  # keys of [solver] with defaults per solver
Located = TypeVar("Located", Mesh, Cloth, Maps)


def read_scene(source: Scene | str | Path | dict[str, Any], overrides: dict[str, Any]) -> tuple[Scene, str]:
    """Return a scene with overrides, as `geometry.scene_loader.load_scene` does, and its name in messages.

    Nothing that needs the contents of mesh and map files is checked. Raises SceneError.
    """
    if isinstance(source, dict):
        path, file = Path("scene.toml"), "scene"  # in the working folder: mesh files are relative to it
        data = {key: plain_tables(key, value) for key, value in source.items()}
    elif isinstance(source, (str, Path)):
        path, file = scene_path(source), str(source)
        data = _parse(path)
    elif isinstance(source, Scene):
        path, file, data = (
            Path(folder_of(source)) / f"{source.name}.toml",
            source.name,
            parse_toml(scene_to_toml(source)),
        )
    else:
        reason = "must be a scene, the name of a shipped one, the path of a TOML file, or a dict"
        raise SceneError("scene", "", f"{reason}, got {short_repr(source)}")
    scene = scene_from(data, file, path)  # the file must be valid without overrides too
    if not overrides:
        return scene, file
    file += " (override)"
    dropped = {key: _dropped_keys(key, value, scene) for key, value in overrides.items()}
    # Sections first, then what drops keys of the file, then single keys.
    for key in sorted(overrides, key=lambda key: (not is_section(key, overrides[key]), not dropped[key])):
        apply_override(data, key, overrides[key], file)
        for section, names in dropped[key].items():
            for name in names:
                _table_of(data, section).pop(name, None)
    return scene_from(data, file, path), file


def read_with_mistakes(name_or_path: str | Path, mistakes: Mistakes) -> Scene | None:
    """Return the scene of a file, and add all of its mistakes. Keys with a mistake have their defaults.

    Nothing that needs the contents of mesh and map files is checked. None if the file cannot be parsed.
    """
    with mistakes.collect():
        path = scene_path(name_or_path)
        return _scene_from(_parse(path), path, mistakes)
    return None


def scene_from_toml(text: str, like: Scene, folder: str = "") -> Scene:
    """Return the scene of a TOML text, with the name of the scene `like`.

    `folder`: of its mesh and map files; if it is "", that of `like`.

    Raises ValueError for invalid TOML, and SceneError (a ValueError) for an invalid scene.
    """
    path = Path(folder or folder_of(like)) / "scene.toml"
    return replace(scene_from(parse_toml(text), "scene", path), name=like.name)


def folder_of(scene: Scene) -> str:
    """Return the absolute folder of the mesh and map files of a checked scene, or "" if all of them are shipped."""
    users = (*scene.meshes, scene.cloth, scene.maps)
    return next((user.folder for user in users if user and user.folder), "")


def check_keys(scene: Scene) -> None:
    """Check the keys of a scene made in Python against each other.

    Raises SceneError: one line with the name of the scene, key and reason.
    """
    cloth, defaults, mistakes = scene.cloth, Cloth(), Mistakes(scene.name)
    if cloth.file:
        _check_no_grid_keys([key for key in GRID_KEYS if getattr(cloth, key) != getattr(defaults, key)], mistakes)
    _check_consistency(scene, mistakes)
    mistakes.raise_first()


def _dropped_keys(key: str, value: Any, scene: Scene) -> dict[str, tuple[str, ...]]:
    """Return the keys of the file, by section, that an override replaces together with its own.

    A fabric preset replaces all fabric keys; another solver replaces substeps and iterations.
    """
    if is_section(key, value):  # it has replaced its own keys
        preset = key == "fabric" and given_table(value).get("preset")
        return {name: keys for name, keys in PRESET_KEYS.items() if name != key} if preset else {}
    targets = [(part.name, name) for part, name in targets_of(key) if part]
    if targets == [("fabric", "preset")]:
        return PRESET_KEYS
    if targets == [("solver", "name")] and value != scene.solver.name:
        return {"solver": SOLVER_DEFAULT_KEYS}
    return {}


def _parse(path: Path) -> dict[str, Any]:
    file = str(path)
    if path.is_dir():
        raise SceneError(file, "", "is a folder, not a scene file")
    try:
        with path.open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte
        raise SceneError(file, "", f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(content) > MAX_BYTES:
        raise SceneError(file, "", f"is larger than {MAX_BYTES} bytes, the limit for scene files")
    try:
        data = parse_toml(content.decode("utf-8-sig"))
        if "recording" not in data:
            return data
        reason = "is a recording, not a scene: open it with `taichi-cloth replay`"
    except UnicodeDecodeError as error:
        reason = f"is not UTF-8 text (byte {error.start})"
    except RecursionError:
        reason = "is not a scene: brackets are nested too deeply"
    except ValueError as error:  # invalid TOML, or a number with thousands of digits
        reason = f"is not valid TOML: {error}"
    raise SceneError(file, "", reason)


def scene_from(data: dict[str, Any], file: str, path: Path) -> Scene:
    """Return the scene of parsed TOML, read from `path`. Error messages name it `file`. Raises SceneError."""
    mistakes = Mistakes(file)
    scene = _scene_from(data, path, mistakes)
    mistakes.raise_first()
    return scene


def _scene_from(data: dict[str, Any], path: Path, mistakes: Mistakes) -> Scene:
    """Return the scene of parsed TOML, read from `path`. Keys with a mistake have their defaults."""
    scene = _with_preset(_sections(data, path.stem, mistakes), data, mistakes)
    scene = with_folders(scene, path.parent)
    _check_consistency(scene, mistakes)
    return scene


def _sections(data: dict[str, Any], name: str, mistakes: Mistakes) -> Scene:
    """Return the scene of parsed TOML, with each section checked by itself."""
    known = sections()
    top_level = {key: value for key, value in data.items() if key not in known}
    values = check_table(Scene, top_level, mistakes, also=known)
    for key, table in top_level.items():  # the keys of a section with a mistyped name
        meant = known.get(nearest_name(key, known))
        if meant and isinstance(table, list if meant.is_array else dict):
            meant._replace(name=key).checked(table, mistakes)
    for part in known.values():
        if part.name in data:
            values[part.name] = part.checked(data[part.name], mistakes)
    if "cloth" in values and values["cloth"].file:
        _check_no_grid_keys([key for key in GRID_KEYS if key in data["cloth"]], mistakes)
    if "fabric" in values:
        values["fabric"] = replace(values["fabric"])  # with all keys given; `_with_preset` sets those of the preset
    return Scene(**values, name=name)


def _check_no_grid_keys(keys: list[str], mistakes: Mistakes) -> None:
    """Check that a cloth from a mesh file sets no `keys` of a grid."""
    for key in keys:
        mistakes.add(f"cloth.{key}", "applies to grids only, but cloth.file names a mesh: remove one")


def _table_of(data: dict[str, Any], section: str) -> dict[str, Any]:
    """Return the keys that a file sets in a section: none if the section is missing or is no table."""
    table = data.get(section)
    return table if isinstance(table, dict) else {}


def _with_preset(scene: Scene, data: dict[str, Any], mistakes: Mistakes) -> Scene:
    """Return the scene with the values of its fabric preset for all keys that neither file nor overrides set."""
    if not scene.fabric.preset:
        return scene
    preset = preset_values(load_preset(scene.fabric.preset), scene)
    filled = {}
    for name, values in preset.items():
        section = getattr(scene, name)
        missing = {key: value for key, value in values.items() if key not in _table_of(data, name)}
        cls: type = type(section)
        keys, hints = keys_of(cls), types_of(cls)
        checked = {
            key: check_value(value, hints[key], keys[key], mistakes.file, f"{name}.{key}")
            for key, value in missing.items()
        }
        filled[name] = replace(section, **checked)
    return replace(scene, **filled)


def with_folders(scene: Scene, folder: Path | None = None) -> Scene:
    """Return the scene with the folders of its mesh and map files: `folder`, or by default those it has.

    They are absolute, because the window works in another folder, as do processes that it starts. If they do not
    change, the same object is returned.
    """

    def located(part: Located) -> Located:
        absolute = str(Path(part.folder if folder is None else folder).absolute())
        return part if part.folder == absolute else replace(part, folder=absolute)

    meshes = tuple(located(mesh) if is_file_name(mesh.file) else mesh for mesh in scene.meshes)
    cloth = located(scene.cloth) if is_file_name(scene.cloth.file) else scene.cloth
    maps = scene.maps
    if maps and map_files(maps):
        maps = located(maps)
    parts, before = (*meshes, cloth, maps), (*scene.meshes, scene.cloth, scene.maps)
    same = all(part is old for part, old in zip(parts, before, strict=True))
    return scene if same else replace(scene, meshes=meshes, cloth=cloth, maps=maps)


def map_files(maps: Maps) -> dict[str, str]:
    """Return the paths of the maps that are files of the user, by name of the map."""
    given = {name: getattr(maps, name) for name in MAP_NAMES}
    return {name: file for name, file in given.items() if file and isinstance(file, str) and not is_map_name(file)}


def _check_mesh_names(scene: Scene, mistakes: Mistakes) -> None:
    """Check the names of meshes that are not paths."""
    files = {f"meshes[{k}].file": mesh.file for k, mesh in enumerate(scene.meshes)}
    if scene.cloth.file:
        files["cloth.file"] = scene.cloth.file
    for where, file in files.items():
        if not is_file_name(file) and file not in mesh_names():
            shipped = ", ".join(mesh_names())
            reason = f"{short_repr(file)} is not a shipped mesh; use {shipped}, or the path of an OBJ file"
            mistakes.add(where, reason, nearest_name(file, mesh_names()))


def _check_collider_names(scene: Scene, mistakes: Mistakes) -> None:
    """Check that colliders with names have different ones: they are prefixes of runtime parameters."""
    seen: set[str] = set()
    for section in COLLIDERS:
        for k, collider in enumerate(getattr(scene, section)):
            if collider.name in seen:
                mistakes.add(f"{section}[{k}].name", f"{short_repr(collider.name)} is the name of another collider")
            seen |= {collider.name} - {""}


def _check_response(collider: ContactProperties, where: str, mistakes: Mistakes) -> None:
    """Check that continuous collision detection, triangle collision and deforming meshes have projection."""
    if isinstance(collider, Mesh) and collider.clip:
        if collider.response != RESPONSES[PROJECTION]:
            mistakes.add(f"{where}.response", f"a mesh with a clip requires projection, got {collider.response}")
        if collider.continuous:
            mistakes.add(f"{where}.continuous", "does not go with a clip: use more substeps")
        return
    if collider.response != RESPONSES[PROJECTION]:
        if collider.continuous:
            mistakes.add(f"{where}.continuous", f"requires projection, got {collider.response}")
        if isinstance(collider, RoundCollider) and collider.collide_with == "triangles":
            mistakes.add(f"{where}.collide_with", f"triangles require projection, got {collider.response}")


def _check_regions(scene: Scene, mistakes: Mistakes) -> None:
    for k, region in enumerate(scene.regions):
        if region.name in [other.name for other in scene.regions[:k]] and not mistakes.concern("regions"):
            mistakes.add(f"regions[{k}].name", f"{short_repr(region.name)} is the name of another region")


def pins_by_key(scene: Scene) -> dict[str, str | int]:
    """Return all pins of a scene by key: `cloth.pins[0]`, `attachments[1].pins[0]`."""
    lists = {"cloth": scene.cloth.pins} | {f"attachments[{k}]": one.pins for k, one in enumerate(scene.attachments)}
    return {f"{where}.pins[{k}]": pin for where, pins in lists.items() for k, pin in enumerate(pins)}


def _check_pins(scene: Scene, mistakes: Mistakes) -> None:
    """Check the particle indices among the pins of a sheet; a mesh file has to be read first."""
    if scene.cloth.file or mistakes.concern("cloth.rows", "cloth.columns", "cloth.layers", "cloth.file"):
        return
    last = scene.cloth.rows * scene.cloth.columns * scene.cloth.layers - 1
    for key, pin in pins_by_key(scene).items():
        if isinstance(pin, int) and not 0 <= pin <= last:
            mistakes.add(key, f"{short_repr(pin)} is not a particle: indices run from 0 to {last}")


def _check_consistency(scene: Scene, mistakes: Mistakes) -> None:
    """Check the keys against each other."""
    if scene.cloth.layers > 1 and scene.tethers is not None:
        mistakes.add("tethers", f"require a single layer, but cloth.layers is {scene.cloth.layers}")
    bends = max(scene.fabric.bending_stiffness, scene.fabric.bending_weft) > 0
    if scene.tearing is not None and bends and not mistakes.concern("fabric"):
        reason = "does not support bending stiffness: set fabric.bending_stiffness to 0, and use fabric.bend_spring"
        mistakes.add("tearing", reason)
    _check_model(scene, mistakes)
    contact = scene.self_collision
    if contact is not None and contact.static_friction and contact.primitives != "particles":
        mistakes.add("self_collision.static_friction", 'requires primitives = "particles"')
    if contact is not None and contact.static_friction and contact.penetration_free:
        mistakes.add("self_collision.static_friction", "does not go with penetration_free, which has its own friction")
    if contact is not None and contact.penetration_free and scene.cloth.layers > 1 and scene.cloth.layer_spacing == 0:
        reason = "must be greater than 0: self_collision.penetration_free needs to know which layer is above"
        mistakes.add("cloth.layer_spacing", reason)
    if scene.cloth.file and scene.look.pole:
        mistakes.add("look.pole", "is drawn along the top edge of a grid, but cloth.file names a mesh")
    _check_mesh_names(scene, mistakes)
    _check_collider_names(scene, mistakes)
    _check_regions(scene, mistakes)
    _check_pins(scene, mistakes)
    for name in (*COLLIDERS, "ground"):
        found = getattr(scene, name)
        for k, one in enumerate(found if isinstance(found, tuple) else [found] if found else []):
            _check_response(one, name if one is found else f"{name}[{k}]", mistakes)
    (x, y, z), (tx, ty, tz) = scene.camera.eye, scene.camera.target
    if hypot(x - tx, z - tz) <= 1e-6 * abs(y - ty) and not mistakes.concern("camera"):
        reason = "must differ from camera.target" if y == ty else "must not be straight above or below camera.target"
        mistakes.add("camera.eye", reason)


def _check_model(scene: Scene, mistakes: Mistakes) -> None:
    """Check the model of the fabric: its own keys, and what needs springs or a grid."""
    model = scene.fabric.model
    check_model(scene.fabric, scene.weave, mistakes)
    if model == "springs":
        return
    for name in ("strain_limit", "tearing"):
        if getattr(scene, name) is not None:
            mistakes.add(name, f'needs springs, but fabric.model is "{model}"')
    if model == "weave" and scene.cloth.file:
        mistakes.add("fabric.model", "a weave needs a grid, but cloth.file names a mesh")


# -- writing -----------------------------------------------------------------------------------------------------------


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
