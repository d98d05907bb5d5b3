"""From TOML to a `Scene`, checked key by key against the metadata in `model.py`."""

from __future__ import annotations

from dataclasses import replace
from math import hypot
from pathlib import Path
from typing import Any, TypeVar

from .errors import PinError, SceneError, nearest, shown
from .library import is_file_name, is_map_name, mesh_names, scene_path
from .model import (
    COLLIDERS,
    GRID_KEYS,
    GROUP,
    MAP_NAMES,
    PROJECTION,
    REGION,
    RESPONSES,
    USUAL,
    Cloth,
    Contact,
    Mesh,
    Part,
    Round,
    Scene,
    hints_of,
    keys_of,
    parts,
)
from .overrides import apply_override, override_places
from .presets import FILLED, load_preset, preset_keys
from .toml import parse_toml
from .values import check_value

MOST_BYTES = 1_000_000  # a scene file is a page of text
MOST_COLLIDERS = 16  # of one kind
NUMBERS = ("substeps", "iterations")  # those of `USUAL`
_UNSAID = (*GRID_KEYS, "pins")  # keys whose defaults are those of a grid
Found = TypeVar("Found", Mesh, Cloth)


def load_scene(name_or_path: str | Path, /, **overrides: Any) -> Scene:
    """A shipped scene by name, or a TOML file by path, with keys changed by `overrides`.

    An override is named `section_key` (`wind_z=6`, `cloth_rows=12`), by the key alone where only one
    section has it (`substeps=10`), or by a section for its name (`solver="lines"`) or preset (`fabric="denim"`).
    Another solver comes with its usual substeps and iterations, and a preset replaces what the file says of its
    fabric. For spheres and boxes an override changes the first (`sphere_radius=0.4`). A section the scene lacks is
    added with its defaults.

    Raises SceneError, one line with file, key, reason and the nearest valid name.
    """
    path, file = scene_path(name_or_path), str(name_or_path)
    data = _parse(path)
    scene = scene_from(data, file, path)  # the file must be right without its overrides, too
    if not overrides:
        return scene
    file += " (override)"
    aside = {key: _set_aside(key, value, scene) for key, value in overrides.items()}
    for key in sorted(overrides, key=lambda key: not aside[key]):
        apply_override(data, key, overrides[key], file)
        for section, names in aside[key].items():
            for name in names:
                data.get(section, {}).pop(name, None)
    return scene_from(data, file, path)


def check_scene(scene: Scene) -> Scene:
    """A scene made in Python, checked as a file is; lists come back as the tuples that they stand for.

    Raises SceneError, one line with the scene's name, key and reason.
    """
    data: dict[str, Any] = {key: getattr(scene, key) for key in keys_of(Scene)}
    for part in parts().values():
        given = getattr(scene, part.name)
        if part.many:
            data[part.name] = [_table(part, one) for one in given] if isinstance(given, (list, tuple)) else given
        elif given is not None or not part.optional:
            data[part.name] = _table(part, given)
    if isinstance(scene.cloth, Cloth) and scene.cloth.file:  # what has its default was not said
        plain = Cloth()
        data["cloth"] = {k: v for k, v in data["cloth"].items() if not (k in _UNSAID and v == getattr(plain, k))}
    checked = _sections(data, scene.name, scene.name)
    found = tuple(replace(mesh, folder=given.folder) for mesh, given in zip(checked.meshes, scene.meshes, strict=True))
    checked = replace(checked, meshes=found, cloth=replace(checked.cloth, folder=scene.cloth.folder))
    if checked.maps and scene.maps:
        checked = replace(checked, maps=replace(checked.maps, folder=scene.maps.folder))
    checked = _consistent(checked, scene.name)
    return scene if checked == scene else checked


def _table(part: Part, section: Any) -> Any:
    """A section as the reader finds it in a file."""
    if not isinstance(section, part.section):
        return section
    return {name: getattr(section, name) for name in keys_of(part.section)}


def _set_aside(key: str, value: Any, scene: Scene) -> dict[str, tuple[str, ...]]:
    """Names by section that no longer count: who asks for a fabric or for another method wants all that is of it."""
    places = [(part.name, name) for part, name in override_places().get(key, []) if part]
    if places == [("fabric", "preset")]:
        return FILLED
    if places == [("solver", "name")] and value != scene.solver.name:
        return {"solver": NUMBERS}
    return {}


def _parse(path: Path) -> dict[str, Any]:
    file = str(path)
    if path.is_dir():
        raise SceneError(file, "", "is a folder, not a scene file")
    try:
        with path.open("rb") as stream:
            content = stream.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte
        raise SceneError(file, "", f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(content) > MOST_BYTES:
        raise SceneError(file, "", f"is larger than {MOST_BYTES} bytes, which no scene is")
    try:
        return parse_toml(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        reason = f"is not UTF-8 text (byte {error.start})"
    except RecursionError:
        reason = "is not a scene: its brackets are nested too deeply"
    except ValueError as error:  # broken TOML, or a number with thousands of digits
        reason = f"is not valid TOML: {error}"
    raise SceneError(file, "", reason)


def scene_from(data: dict[str, Any], file: str, path: Path) -> Scene:
    """A whole scene from the parsed TOML of a path. Messages call it `file`."""
    scene = _with_preset(_with_usual(_sections(data, file, path.stem), data), data, file)
    return _consistent(_with_meshes(scene, path.parent, file), file)


def _sections(data: dict[str, Any], file: str, name: str) -> Scene:
    """Sections and the keys above them."""
    sections = parts()
    loose = {key: value for key, value in data.items() if key not in sections}
    values = _values(Scene, loose, file, also=list(sections))
    for part in sections.values():
        if part.name in data:
            values[part.name] = _part(part, data[part.name], file)
    if "cloth" in values and values["cloth"].file:
        values["cloth"] = _of_a_file(values["cloth"], data["cloth"], file)
    return Scene(**values, name=name)


def _of_a_file(cloth: Cloth, data: dict[str, Any], file: str) -> Cloth:
    """A cloth whose mesh file takes the place of the keys of a grid."""
    for key in GRID_KEYS:
        if key in data:
            raise SceneError(file, f"cloth.{key}", "is for a sheet, and cloth.file names a mesh: take one of them away")
    return cloth if "pins" in data else replace(cloth, pins=())


def _with_usual(scene: Scene, data: dict[str, Any]) -> Scene:
    """The scene with the numbers that are usual for its method, where it says none."""
    usual = dict(zip(NUMBERS, USUAL[scene.solver.name], strict=True))
    missing: dict[str, Any] = {name: n for name, n in usual.items() if name not in data.get("solver", {})}
    return replace(scene, solver=replace(scene.solver, **missing))


def _with_preset(scene: Scene, data: dict[str, Any], file: str) -> Scene:
    """The scene with the keys that its fabric preset gives and that its file and overrides do not."""
    if not scene.fabric.preset:
        return scene
    given = preset_keys(load_preset(scene.fabric.preset), scene.cloth)
    filled = {}
    for name, numbers in given.items():
        section = getattr(scene, name)
        missing = {key: value for key, value in numbers.items() if key not in data.get(name, {})}
        kind: type = type(section)
        keys, hints = keys_of(kind), hints_of(kind)
        checked = {key: check_value(v, hints[key], keys[key], file, f"{name}.{key}") for key, v in missing.items()}
        filled[name] = replace(section, **checked)
    return replace(scene, **filled)


def _with_meshes(scene: Scene, folder: Path, file: str) -> Scene:
    """The scene with files that know their folder, and meshes that are closed surfaces."""
    meshes = tuple(_found(mesh, folder, file, f"meshes[{k}].file") for k, mesh in enumerate(scene.meshes))
    cloth = _found(scene.cloth, folder, file, "cloth.file") if scene.cloth.file else scene.cloth
    maps = scene.maps
    if maps and any(file and not is_map_name(file) for file in (getattr(maps, name) for name in MAP_NAMES)):
        maps = replace(maps, folder=str(folder))
    return replace(scene, meshes=meshes, cloth=cloth, maps=maps)


def _found(mesh: Found, folder: Path, file: str, where: str) -> Found:
    if is_file_name(mesh.file):
        mesh = replace(mesh, folder=str(folder))
    elif mesh.file not in mesh_names():
        reason = f"{shown(mesh.file)} is no shipped mesh: {', '.join(mesh_names())}, or the path of an OBJ file"
        raise SceneError(file, where, reason, nearest(mesh.file, mesh_names()))
    if isinstance(mesh, Mesh):
        from ..mesh.solid import check_solid  # NumPy: only for scenes that have one

        try:
            check_solid(mesh)
        except ValueError as error:
            raise SceneError(file, where, str(error)) from None
    return mesh


def _part(part: Part, data: Any, file: str) -> Any:
    """One section, or the tuple of all its tables."""
    if not part.many:
        return part.section(**_values(part.section, data, file, part.name))
    if not isinstance(data, list):
        raise SceneError(file, part.name, f"write [[{part.name}]] with two brackets: a scene may have several")
    if len(data) > MOST_COLLIDERS:
        raise SceneError(file, part.name, f"{len(data)} are too many: at most {MOST_COLLIDERS}")
    return tuple(part.section(**_values(part.section, one, file, f"{part.name}[{k}]")) for k, one in enumerate(data))


def _values(section: type, data: Any, file: str, where: str = "", also: list[str] | None = None) -> dict[str, Any]:
    """The checked keys of one table, which messages call `where`; `also` are further names allowed beside them."""
    if not isinstance(data, dict):
        raise SceneError(file, where, f"a table of keys is needed, not {shown(data)}")
    keys, hints = keys_of(section), hints_of(section)
    values = {}
    for name, value in data.items():
        place = f"{where}.{name}" if where else name
        if name not in keys:
            known = [*keys, *(also or [])]
            hint = nearest(name, known)
            raise SceneError(file, place, "unknown key" + ("" if hint else f"; known here: {', '.join(known)}"), hint)
        values[name] = check_value(value, hints[name], keys[name], file, place)
    return values


def _check_response(body: Contact, where: str, file: str) -> None:
    """Only what is moved out can be stopped on its way, or by its triangles."""
    if body.response != RESPONSES[PROJECTION]:
        if body.swept:
            raise SceneError(file, f"{where}.swept", f"works with projection, not with {body.response}")
        if isinstance(body, Round) and body.against == "triangles":
            raise SceneError(file, f"{where}.against", f"triangles are for projection, not for {body.response}")


def _check_regions(scene: Scene, file: str) -> None:
    for k, region in enumerate(scene.regions):
        if region.name in [other.name for other in scene.regions[:k]]:
            raise SceneError(file, f"regions[{k}].name", f"another region is called {shown(region.name)}, too")


def _check_cloth(scene: Scene, file: str) -> None:
    """Its mesh file, and all pins."""
    lists = {"cloth": scene.cloth.pins} | {f"grips[{k}]": grip.pins for k, grip in enumerate(scene.grips)}
    pins = {f"{place}.pins[{k}]": pin for place, pins in lists.items() for k, pin in enumerate(pins)}
    if scene.cloth.file or any(isinstance(pin, str) and pin.startswith((GROUP, REGION)) for pin in pins.values()):
        from ..mesh.from_scene import check_mesh, held, particles_of  # NumPy: only for scenes that have one

        if scene.cloth.file:
            try:
                check_mesh(scene.cloth)
            except ValueError as error:
                raise SceneError(file, "cloth.file", str(error)) from None
        particles = particles_of(scene)
        for place, pin in pins.items():
            try:
                held(scene, particles, [pin])
            except PinError as error:
                raise SceneError(file, place, str(error), nearest(error.name, error.known)) from None
        return
    last = scene.cloth.rows * scene.cloth.columns * scene.cloth.sheets - 1
    for place, pin in pins.items():
        if isinstance(pin, int) and not 0 <= pin <= last:
            raise SceneError(file, place, f"{shown(pin)} is no particle: indices run from 0 to {last}")


def _check_maps(scene: Scene, file: str) -> None:
    for name in MAP_NAMES:
        if scene.maps and getattr(scene.maps, name):
            from ..mesh.from_scene import map_of  # NumPy: only for scenes that have one

            try:
                map_of(scene, name)
            except ValueError as error:
                raise SceneError(file, f"maps.{name}", str(error)) from None


def _consistent(scene: Scene, file: str) -> Scene:
    """What no key can say alone."""
    if scene.cloth.sheets > 1 and scene.tethers is not None:
        raise SceneError(file, "tethers", f"are for one sheet, and cloth.sheets is {scene.cloth.sheets}")
    if scene.tear is not None and scene.fabric.bending > 0:
        reason = "cannot cut what resists bending: set fabric.bending to 0, and let the springs of fabric.bend do it"
        raise SceneError(file, "tear", reason)
    off_itself = scene.self_collision
    if off_itself is not None and off_itself.stick and off_itself.contacts != "particles":
        raise SceneError(file, "self_collision.stick", 'is for contacts between particles: set contacts to "particles"')
    if scene.cloth.file and scene.look.pole:
        raise SceneError(file, "look.pole", "is drawn along the top edge of a sheet, and cloth.file names a mesh")
    _check_regions(scene, file)
    _check_cloth(scene, file)
    _check_maps(scene, file)
    for name in (*COLLIDERS, "ground"):
        found = getattr(scene, name)
        for k, one in enumerate(found if isinstance(found, tuple) else [found] if found else []):
            _check_response(one, name if one is found else f"{name}[{k}]", file)
    (x, y, z), (tx, ty, tz) = scene.camera.eye, scene.camera.target
    if hypot(x - tx, z - tz) <= 1e-6 * abs(y - ty):
        what = "is the target" if y == ty else "is straight above or below the target, where no side is up"
        raise SceneError(file, "camera.eye", what)
    return scene
