"""Reads scenes from TOML. Checks each key against its metadata in `schema.py`, then keys against each other."""

from __future__ import annotations

from dataclasses import replace
from math import hypot
from pathlib import Path
from typing import Any, TypeVar

from ..system.errors import Mistakes, SceneError, nearest_name, new_key, short_repr
from .collider_schema import PROJECTION, RESPONSES, ContactProperties, Mesh, RoundCollider
from .keys import check_value, keys_of, types_of
from .overrides import apply_override, targets_of
from .presets import PRESET_KEYS, is_file_name, is_map_name, load_preset, mesh_names, preset_values, scene_path
from .schema import COLLIDERS, GRID_KEYS, MAP_NAMES, Cloth, Scene, Section, sections
from .solver_catalog import SOLVER_CATALOG
from .toml_io import parse_toml

MAX_BYTES = 1_000_000  # of a scene file
MAX_TABLES = 16  # tables of one section, such as [[spheres]]
SOLVER_DEFAULT_KEYS = (
    "substeps",
    "iterations",
)  # keys of [solver] with defaults per solver, as in `SolverInfo.defaults`
_GRID_DEFAULTS = (*GRID_KEYS, "pins")  # keys of [cloth] whose defaults apply to grids only
MeshOrCloth = TypeVar("MeshOrCloth", Mesh, Cloth)


def read_scene(name_or_path: str | Path, overrides: dict[str, Any]) -> tuple[Scene, str]:
    """Return the scene of a file with overrides, as `geometry.scene_loader.load_scene` does, and its name in messages.

    Nothing that needs the contents of mesh and map files is checked. Raises SceneError.
    """
    path, file = scene_path(name_or_path), str(name_or_path)
    data = _parse(path)
    scene = scene_from(data, file, path)  # the file must be valid without overrides too
    if not overrides:
        return scene, file
    file += " (override)"
    dropped = {key: _dropped_keys(key, value, scene) for key, value in overrides.items()}
    for key in sorted(overrides, key=lambda key: not dropped[key]):  # those that drop keys of the file first
        apply_override(data, key, overrides[key], file)
        for section, names in dropped[key].items():
            for name in names:
                data.get(section, {}).pop(name, None)
    return scene_from(data, file, path), file


def read_with_mistakes(name_or_path: str | Path, mistakes: Mistakes) -> Scene | None:
    """Return the scene of a file, and add all of its mistakes. Keys with a mistake have their defaults.

    Nothing that needs the contents of mesh and map files is checked. None if the file cannot be parsed.
    """
    with mistakes.collect():
        path = scene_path(name_or_path)
        return _scene_from(_parse(path), path, mistakes)
    return None


def scene_from_toml(text: str, like: Scene) -> Scene:
    """Return the scene of a TOML text, with the name of the scene `like` and its folder for meshes and maps.

    Raises ValueError for invalid TOML, and SceneError (a ValueError) for an invalid scene.
    """
    users = (*like.meshes, like.cloth, like.maps)
    folder = next((user.folder for user in users if user and user.folder), "")
    return replace(scene_from(parse_toml(text), "scene", Path(folder) / "scene.toml"), name=like.name)


def check_keys(scene: Scene) -> Scene:
    """Check the keys of a scene made in Python as those of a file, and return it. Lists become tuples.

    Raises SceneError: one line with the name of the scene, key and reason.
    """
    data: dict[str, Any] = {key: getattr(scene, key) for key in keys_of(Scene)}
    for part in sections().values():
        value = getattr(scene, part.name)
        if part.is_array:
            data[part.name] = [_table(part, one) for one in value] if isinstance(value, (list, tuple)) else value
        elif value is not None or not part.optional:
            data[part.name] = _table(part, value)
    if isinstance(scene.cloth, Cloth) and scene.cloth.file:  # a mesh has no grid keys: drop defaults
        defaults = Cloth()
        data["cloth"] = {
            k: v for k, v in data["cloth"].items() if not (k in _GRID_DEFAULTS and v == getattr(defaults, k))
        }
    mistakes = Mistakes(scene.name)
    checked = _sections(data, scene.name, mistakes)
    mistakes.raise_first()
    meshes = tuple(
        replace(mesh, folder=original.folder) for mesh, original in zip(checked.meshes, scene.meshes, strict=True)
    )
    checked = replace(checked, meshes=meshes, cloth=replace(checked.cloth, folder=scene.cloth.folder))
    if checked.maps and scene.maps:
        checked = replace(checked, maps=replace(checked.maps, folder=scene.maps.folder))
    _check_consistency(checked, mistakes)
    mistakes.raise_first()
    return scene if checked == scene else checked


def _table(part: Section, section: Any) -> Any:
    """Return a section as a table of keys, as the TOML parser returns it. Other objects are returned unchanged."""
    if not isinstance(section, part.cls):
        return section
    return {name: getattr(section, name) for name in keys_of(part.cls)}


def _dropped_keys(key: str, value: Any, scene: Scene) -> dict[str, tuple[str, ...]]:
    """Return the keys of the file, by section, that an override replaces together with its own.

    A fabric preset replaces all fabric keys; another solver replaces substeps and iterations.
    """
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
    scene = _with_preset(_with_solver_defaults(_sections(data, path.stem, mistakes), data), data, mistakes)
    scene = _with_folders(scene, path.parent, mistakes)
    _check_consistency(scene, mistakes)
    return scene


def _sections(data: dict[str, Any], name: str, mistakes: Mistakes) -> Scene:
    """Return the scene of parsed TOML, with each section checked by itself."""
    known = sections()
    top_level = {key: value for key, value in data.items() if key not in known}
    values = _values(Scene, top_level, mistakes, also=list(known))
    for part in known.values():
        if part.name in data:
            values[part.name] = _part(part, data[part.name], mistakes)
    if "cloth" in values and values["cloth"].file:
        values["cloth"] = _mesh_cloth(values["cloth"], data["cloth"], mistakes)
    return Scene(**values, name=name)


def _mesh_cloth(cloth: Cloth, data: dict[str, Any], mistakes: Mistakes) -> Cloth:
    """Return the cloth of a mesh file, which has no pins by default, and check that no grid key is set."""
    for key in GRID_KEYS:
        if key in data:
            mistakes.add(f"cloth.{key}", "applies to grids only, but cloth.file names a mesh: remove one")
    return cloth if "pins" in data else replace(cloth, pins=())


def _table_of(data: dict[str, Any], section: str) -> dict[str, Any]:
    """Return the keys that a file sets in a section: none if the section is missing or is no table."""
    table = data.get(section)
    return table if isinstance(table, dict) else {}


def _with_solver_defaults(scene: Scene, data: dict[str, Any]) -> Scene:
    """Return the scene with the default substeps and iterations of its solver, where it sets none."""
    defaults = dict(zip(SOLVER_DEFAULT_KEYS, SOLVER_CATALOG[scene.solver.name].defaults, strict=True))
    missing: dict[str, Any] = {name: n for name, n in defaults.items() if name not in _table_of(data, "solver")}
    return replace(scene, solver=replace(scene.solver, **missing))


def _with_preset(scene: Scene, data: dict[str, Any], mistakes: Mistakes) -> Scene:
    """Return the scene with the values of its fabric preset for all keys that neither file nor overrides set."""
    if not scene.fabric.preset:
        return scene
    preset = preset_values(load_preset(scene.fabric.preset), scene.cloth)
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


def _with_folders(scene: Scene, folder: Path, mistakes: Mistakes) -> Scene:
    """Return the scene with the folders of its mesh and map files, and check the names of meshes."""
    meshes = tuple(_located(mesh, folder, f"meshes[{k}].file", mistakes) for k, mesh in enumerate(scene.meshes))
    cloth = _located(scene.cloth, folder, "cloth.file", mistakes) if scene.cloth.file else scene.cloth
    maps = scene.maps
    if maps and any(file and not is_map_name(file) for file in (getattr(maps, name) for name in MAP_NAMES)):
        maps = replace(maps, folder=str(folder))
    return replace(scene, meshes=meshes, cloth=cloth, maps=maps)


def _located(mesh: MeshOrCloth, folder: Path, where: str, mistakes: Mistakes) -> MeshOrCloth:
    """Return a mesh with the folder of its file, and check its name."""
    if is_file_name(mesh.file):
        return replace(mesh, folder=str(folder))
    if mesh.file not in mesh_names():
        reason = (
            f"{short_repr(mesh.file)} is not a shipped mesh; use {', '.join(mesh_names())}, or the path of an OBJ file"
        )
        mistakes.add(where, reason, nearest_name(mesh.file, mesh_names()))
    return mesh


def _part(part: Section, data: Any, mistakes: Mistakes) -> Any:
    """Return a section, or the tuple of all tables of a section that is an array of tables."""
    if not part.is_array:
        if isinstance(data, list) and data and isinstance(data[0], dict):
            mistakes.add(part.name, f"write [{part.name}] with single brackets: a scene has only one")
            return part.cls()
        return part.cls(**_values(part.cls, data, mistakes, part.name))
    if not isinstance(data, list):
        mistakes.add(part.name, f"write [[{part.name}]] with two brackets: it is an array of tables")
        return ()
    if len(data) > MAX_TABLES:
        mistakes.add(part.name, f"has {len(data)} tables, at most {MAX_TABLES} are allowed")
        return ()
    return tuple(part.cls(**_values(part.cls, table, mistakes, f"{part.name}[{k}]")) for k, table in enumerate(data))


def _values(
    section: type, data: Any, mistakes: Mistakes, where: str = "", also: list[str] | None = None
) -> dict[str, Any]:
    """Return the valid keys of one table. Messages name it `where`, and suggest the names in `also` as well."""
    if not isinstance(data, dict):
        mistakes.add(where, f"must be a table, got {short_repr(data)}")
        return {}
    keys, hints = keys_of(section), types_of(section)
    values = {}
    for name, value in data.items():
        key = f"{where}.{name}" if where else name
        if name in keys:
            with mistakes.collect():
                values[name] = check_value(value, hints[name], keys[name], mistakes.file, key)
        elif new := new_key(f"{where.partition('[')[0]}_{name}" if where else name):
            mistakes.add(key, f"was renamed to {new.removeprefix(where.partition('[')[0] + '_')}")
        else:
            known = [*keys, *(also or [])]
            hint = nearest_name(name, known)
            mistakes.add(key, "unknown key" + ("" if hint else f"; allowed: {', '.join(known)}"), hint)
    return values


def _check_response(collider: ContactProperties, where: str, mistakes: Mistakes) -> None:
    """Check that continuous collision detection and triangle collision have projection."""
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
    if scene.tearing is not None and scene.fabric.bending_stiffness > 0 and not mistakes.concern("fabric"):
        reason = "does not support bending stiffness: set fabric.bending_stiffness to 0, and use fabric.bend_spring"
        mistakes.add("tearing", reason)
    contact = scene.self_collision
    if contact is not None and contact.static_friction and contact.primitives != "particles":
        mistakes.add("self_collision.static_friction", 'requires primitives = "particles"')
    if scene.cloth.file and scene.look.pole:
        mistakes.add("look.pole", "is drawn along the top edge of a grid, but cloth.file names a mesh")
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
