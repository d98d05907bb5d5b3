"""Loads and saves scenes, and checks what needs the files that they name: meshes, maps, pins on them. NumPy only."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..scene.collider_schema import Mesh
from ..scene.keys import GROUP, REGION, keys_of
from ..scene.presets import is_file_name, map_path, mesh_path
from ..scene.reader import (
    check_keys,
    map_files,
    pins_by_key,
    read_scene,
    read_with_mistakes,
    scene_to_toml,
    with_folders,
)
from ..scene.schema import MAP_NAMES, Cloth, Scene
from ..system.errors import Mistakes, UsageError
from ..system.files import atomic_file
from .cloth_builder import attached_particles, build_particles, check_mesh, weight_map
from .mesh_reader import clip_path
from .signed_distance import check_solid


def load_scene(source: Scene | str | Path | dict[str, Any], /, **overrides: object) -> Scene:
    """Load a shipped scene by name, a TOML file by path, a dict as TOML has it, or a scene. `overrides` set its keys.

    The name of an override is `section_key` (`wind_z=6`, `cloth_rows=12`) or, if only one section of the scene has the
    key, the key alone (`substeps=10`). The name of a section sets its name (`solver="lines"`) or preset
    (`fabric="denim"`). In an array of tables, such as spheres and boxes, an override sets a key of the first table
    (`sphere_radius=0.4`), or of the one with a `name` (`ball_radius=0.4`). A section that the file does not have is
    added with its defaults. A single pin needs no list.

    An override can also replace a section as a whole: by a dict or an object of its class (`wind={"z": 6}`), by a list
    of them (`spheres=[{"radius": 0.4}]`), or by None, which leaves it out (`wind=None`).

    Another solver gets its own default substeps and iterations. A preset replaces all fabric keys of the file.

    Raises SceneError: one line with file, key, reason and the nearest valid name. Other mistakes of the scene are notes
    below its traceback.
    """
    scene, file = read_scene(source, overrides)
    check_geometry(scene, file)
    return scene


def load_with_mistakes(name_or_path: str | Path) -> tuple[Scene | None, Mistakes]:
    """Return the scene of a file with all of its mistakes. Keys with a mistake have their defaults.

    The scene is None if the file cannot be parsed.
    """
    mistakes = Mistakes(str(name_or_path))
    scene = read_with_mistakes(name_or_path, mistakes)
    if scene:
        _check_geometry(scene, mistakes)
    return scene, mistakes


def check_scene(scene: Scene | str | Path | dict[str, Any]) -> Scene:
    """Return a scene made in Python after checking it as a file is checked; load a scene by name, path or dict.

    Folders of mesh and map files become absolute: relative ones are in the present working folder.

    Raises SceneError: one line with the name of the scene, key and reason.
    """
    if not isinstance(scene, Scene):
        return load_scene(scene)
    check_keys(scene)
    check_geometry(scene, scene.name)
    return with_folders(scene)


def save_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a scene as a TOML file, from which `load_scene` reads this scene with another name: the stem of the file.

    A missing folder is made. Names of mesh and map files become relative to it; the files themselves are not copied.

    Raises SceneError for a scene with a mistake, UsageError for a name that does not end in .toml, and OSError; a
    partial file never remains.
    """
    if isinstance(path, Scene):
        raise UsageError("save_scene takes the scene first, then the path")
    path = Path(path)
    if path.suffix.lower() != ".toml":
        raise UsageError(f"{path}: scenes are saved as TOML files: the name must end in .toml")
    scene = check_scene(scene)
    folder = path.absolute().parent

    def near(file: str, old_folder: str) -> str:
        try:
            found = Path(os.path.relpath(Path(old_folder) / file, folder)).as_posix()
        except ValueError:  # on another drive of Windows
            found = (Path(old_folder) / file).as_posix()
        return found

    def moved(part: Cloth | Mesh) -> str:
        return near(part.file, part.folder) if is_file_name(part.file) else part.file

    meshes = tuple(replace(mesh, file=moved(mesh)) for mesh in scene.meshes)
    scene = replace(scene, cloth=replace(scene.cloth, file=moved(scene.cloth)), meshes=meshes)
    if scene.maps:
        own: dict[str, Any] = {name: near(file, scene.maps.folder) for name, file in map_files(scene.maps).items()}
        scene = replace(scene, maps=replace(scene.maps, **own))
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as file:
        file.write(scene_to_toml(scene).encode())


def files_of(scene: Scene) -> list[Path]:
    """Return the paths of all meshes, clips and maps that a scene names."""
    cloth, maps = scene.cloth, scene.maps
    files = [mesh_path(cloth.file, cloth.folder)] if cloth.file else []
    for mesh in scene.meshes:
        files.append(mesh_path(mesh.file, mesh.folder))
        if mesh.clip:
            clip = clip_path(mesh)
            files += sorted(clip.parent.glob(clip.name))
    if maps:
        names = [getattr(maps, name) for name in MAP_NAMES]
        files += [map_path(name, maps.folder) for name in names if name and isinstance(name, str)]
    return files


def check_geometry(scene: Scene, file: str) -> None:
    """Check mesh files, maps and pins. Raises SceneError; messages name the scene `file`."""
    mistakes = Mistakes(file)
    _check_geometry(scene, mistakes)
    mistakes.raise_first()


# Keys that determine the particles of a cloth and where they start.
_PARTICLE_KEYS = [f"cloth.{name}" for name in keys_of(Cloth) if name != "pins"]


def _check_geometry(scene: Scene, mistakes: Mistakes) -> None:
    """Check mesh files, maps and pins, where their own keys have no mistake."""
    for k, mesh in enumerate(scene.meshes):
        if not mistakes.concern(f"meshes[{k}]"):
            with mistakes.collect(f"meshes[{k}].file"):
                check_solid(replace(mesh, clip=""))
            if mesh.clip and not mistakes.concern(f"meshes[{k}]"):
                with mistakes.collect(f"meshes[{k}].clip"):
                    check_solid(mesh)
    if scene.cloth.file and not mistakes.concern("cloth.file", "cloth.scale"):
        with mistakes.collect("cloth.file"):
            check_mesh(scene.cloth)
    if mistakes.concern(*_PARTICLE_KEYS):
        return
    _check_pins(scene, mistakes)
    for name in MAP_NAMES:
        if scene.maps and getattr(scene.maps, name):
            with mistakes.collect(f"maps.{name}"):
                weight_map(scene, name)


def _check_pins(scene: Scene, mistakes: Mistakes) -> None:
    """Check all pins. Those of a sheet without regions have been checked with its keys."""
    pins = pins_by_key(scene)
    if scene.cloth.file or any(isinstance(pin, str) and pin.startswith((GROUP, REGION)) for pin in pins.values()):
        particles = build_particles(scene)
        for key, pin in pins.items():
            if not mistakes.concern(key, *["regions"] * str(pin).startswith(REGION)):
                with mistakes.collect(key):
                    attached_particles(scene, particles, [pin])
