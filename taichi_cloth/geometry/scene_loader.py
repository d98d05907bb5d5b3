"""Loads scenes, and checks what needs the files that they name: meshes, maps, and pins on them. NumPy only."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..scene.keys import GROUP, REGION
from ..scene.reader import check_keys, pins_by_key, read_scene
from ..scene.schema import MAP_NAMES, Scene
from ..system.errors import PinError, SceneError, nearest_name
from .cloth_builder import attached_particles, build_particles, check_mesh, weight_map
from .signed_distance import check_solid


def load_scene(source: str | Path | dict[str, Any], /, **overrides: object) -> Scene:
    """Load a shipped scene by name, a TOML file by path, or a dict as TOML has it, with keys set by `overrides`.

    The name of an override is `section_key` (`wind_z=6`, `cloth_rows=12`) or, if only one section of the scene has the
    key, the key alone (`substeps=10`). The name of a section sets its name (`solver="lines"`) or preset
    (`fabric="denim"`). In an array of tables, such as spheres and boxes, an override sets a key of the first table
    (`sphere_radius=0.4`). A section that the file does not have is added with its defaults.

    An override can also replace a section as a whole: by a dict or an object of its class (`wind={"z": 6}`), by a list
    of them (`spheres=[{"radius": 0.4}]`), or by None, which leaves it out (`wind=None`).

    Another solver gets its own default substeps and iterations. A preset replaces all fabric keys of the file.

    Raises SceneError: one line with file, key, reason and the nearest valid name.
    """
    scene, file = read_scene(source, overrides)
    check_geometry(scene, file)
    return scene


def check_scene(scene: Scene | str | Path | dict[str, Any]) -> Scene:
    """Return a scene made in Python after checking it as a file is checked; load a scene by name, path or dict.

    Raises SceneError: one line with the name of the scene, key and reason.
    """
    if not isinstance(scene, Scene):
        return load_scene(scene)
    checked = check_keys(scene)
    check_geometry(checked, checked.name)
    return checked


def check_geometry(scene: Scene, file: str) -> None:
    """Check mesh files, maps and pins. Raises SceneError; messages name the scene `file`."""
    for k, mesh in enumerate(scene.meshes):
        with _scene_errors(file, f"meshes[{k}].file"):
            check_solid(mesh)
    if scene.cloth.file:
        with _scene_errors(file, "cloth.file"):
            check_mesh(scene.cloth)
    _check_pins(scene, file)
    for name in MAP_NAMES:
        if scene.maps and getattr(scene.maps, name):
            with _scene_errors(file, f"maps.{name}"):
                weight_map(scene, name)


def _check_pins(scene: Scene, file: str) -> None:
    """Check all pins. Those of a sheet without regions have been checked with its keys."""
    pins = pins_by_key(scene)
    if scene.cloth.file or any(isinstance(pin, str) and pin.startswith((GROUP, REGION)) for pin in pins.values()):
        particles = build_particles(scene)
        for key, pin in pins.items():
            with _scene_errors(file, key):
                attached_particles(scene, particles, [pin])


@contextmanager
def _scene_errors(file: str, key: str) -> Iterator[None]:
    """Turn a ValueError of the block into a SceneError that names the key."""
    try:
        yield
    except PinError as error:
        raise SceneError(file, key, str(error), nearest_name(error.name, error.known)) from None
    except ValueError as error:
        raise SceneError(file, key, str(error)) from None
