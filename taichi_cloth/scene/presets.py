"""Shipped assets (scenes, meshes, maps), and fabric presets: measured properties with their sources.

A scene selects one with `[fabric] preset = "denim"`; the reader then fills in every key that the scene does not set.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, replace
from math import hypot, isfinite, sqrt
from pathlib import Path
from typing import Any

from ..system.errors import SceneError, nearest_name, short_repr
from .fabric_schema import PRESET_NAMES
from .schema import Scene

_PACKAGE = Path(__file__).parents[1]
MESH_SUFFIXES = (".obj", ".stl", ".ply", ".fbx", ".glb", ".gltf", ".usd", ".usda", ".usdc", ".abc")


def asset_folder() -> Path:
    """Return the folder `assets` of an installed package or of a checkout."""
    inside = _PACKAGE / "assets"
    return inside if (inside / "scenes").is_dir() else _PACKAGE.parent / "assets"


def scene_names() -> list[str]:
    """Return the names of all shipped scenes, sorted."""
    return sorted(path.stem for path in (asset_folder() / "scenes").glob("*.toml"))


def preset_names() -> list[str]:
    """Return the names of all shipped fabrics, for `preset` in `[fabric]`: from light to heavy."""
    return list(PRESET_NAMES)


def mesh_names() -> list[str]:
    """Return the names of all shipped meshes, sorted."""
    return sorted(path.stem for path in (asset_folder() / "meshes").glob("*.obj"))


def is_file_name(text: str) -> bool:
    """Return whether a text is the path of a scene or mesh file, not the name of a shipped one."""
    return text.endswith((".toml", ".obj")) or "/" in text or "\\" in text


def scene_path(name_or_path: str | Path) -> Path:
    """Return the path of a shipped scene by name, or a path unchanged. Raises SceneError for an unknown name."""
    text = str(name_or_path)
    if Path(text).suffix in MESH_SUFFIXES:
        other = "" if text.endswith(".obj") else "convert it to OBJ, and "
        raise SceneError(text, "", f'is a mesh, not a scene: {other}write a scene whose [cloth] has file = "NAME.obj"')
    if isinstance(name_or_path, Path) or is_file_name(text):
        return Path(text)
    names = scene_names()
    if text not in names:
        if text and Path(text).exists():
            if Path(text).is_dir():
                raise SceneError(text, "", "is a folder, not a scene file")
            raise SceneError(text, "", f"is no shipped scene; for the file, write ./{text}")
        reason = f"no such scene; use {', '.join(names)}, or the path of a TOML file"
        hint = f"{text}.toml" if text and Path(f"{text}.toml").is_file() else nearest_name(text, names)
        raise SceneError(text or "scene", "", reason, hint)
    return asset_folder() / "scenes" / f"{text}.toml"


def mesh_path(file: str, folder: str) -> Path:
    """Return the path of an OBJ file: a shipped mesh by name, or a path relative to the scene's `folder`."""
    return Path(folder) / file if is_file_name(file) else asset_folder() / "meshes" / f"{file}.obj"


def is_map_name(text: str) -> bool:
    """Return whether a text is the name of a shipped map, not a path."""
    return bool(text) and not (Path(text).suffix or "/" in text or "\\" in text)


def map_path(file: str, folder: str) -> Path:
    """Return the path of a map: a shipped one by name, or a path relative to the scene's `folder`.

    Raises ValueError for an unknown name.
    """
    if not is_map_name(file):
        return Path(folder) / file
    shipped = {path.stem: path for path in sorted((asset_folder() / "maps").glob("*.csv"))}
    if file not in shipped:
        known = ", ".join(shipped)
        raise ValueError(
            f"{short_repr(file)} is not a shipped map; use {known}, or the path of an image, .csv or .npy file"
        )
    return shipped[file]


_STRIPS = ("warp", "weft", "bias")
_TENSOR = ("c11", "c22", "c12", "c66")
_OPTIONAL = ("poisson", "bending_weft", "damping")  # 0 if no source has them
_VERLET_KEYS = ("structural", "shear", "bend")
_LOOK = ("color", "second_color", "pattern_scale", "pattern", "sheen")

# Smallest eigenvalue of a membrane's tensor as a share of the largest one. A measured tensor with a smaller one is
# projected: cloth whose tensor is not positive definite would stretch without end.
MIN_EIGENVALUE = 0.1

# Scene keys that a preset fills in, by section.
PRESET_KEYS = {
    "cloth": ("area_density",),
    "fabric": ("warp", "weft", "shear", "bend_spring", "bending_stiffness", "damping_time", "bending_weft", *_TENSOR),
    "verlet": _VERLET_KEYS,
    "look": _LOOK,
}


@dataclass(frozen=True)
class Preset:
    """Measured properties of a fabric, independent of grid and solver.

    `warp`, `weft` and `bias` are the tensile stiffness of a narrow strip per meter of its width, cut along the yarns
    and at 45° to them. If the file has the tensor of a membrane instead, they are computed from it. The numbers
    `structural`, `shear` and `bend` are for `verlet` and are not physical quantities.
    """

    name: str
    title: str
    area_density: float  # [kg/m²]
    warp: float  # [N/m]
    weft: float  # [N/m]
    bias: float  # [N/m]
    bending: float  # [N·m]
    bending_weft: float
    """Bending stiffness along the weft [N·m]. 0 if it is that along the warp."""
    poisson: float
    """Poisson's ratio of a strip along the warp: strain across over strain along. 0 if no source has it."""
    damping: float
    """Time by which stress leads strain [s], at the first stretch vibration of a sheet 1 m long. 0: not measured."""
    structural: float  # 0…1
    shear: float  # 0…1
    bend: float  # 0…1
    look: dict[str, object]
    """Keys of `[look]`."""
    sources: dict[str, str]
    """Source of the numbers in every table of the preset's file, one line each."""
    measured_tensor: tuple[float, float, float, float] | None = None
    """C₁₁, C₂₂, C₁₂ and C₆₆ as measured [N/m], if they are not positive definite and were projected."""


def load_preset(name: str) -> Preset:
    """Return a shipped preset. Raises SceneError for an unknown name, and for a number without a source."""
    if name not in PRESET_NAMES:
        raise SceneError(
            "", "preset", f"no such preset; use {', '.join(PRESET_NAMES)}", nearest_name(name, PRESET_NAMES)
        )
    path = asset_folder() / "presets" / f"{name}.toml"
    file = str(path)
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    stretching = ("tensor",) if "tensor" in data else _STRIPS
    measured = ("area_density", *stretching, "bending")
    expected = {"title", "verlet", "look", *measured}
    if set(data) - set(_OPTIONAL) != expected or ("tensor" in data and "poisson" in data):
        raise SceneError(file, "", f"must have {', '.join(sorted(expected))}, got {', '.join(sorted(data))}")
    numbers = dict.fromkeys(_OPTIONAL, 0.0)
    for key in data.keys() & {"area_density", *_STRIPS, "bending", *_OPTIONAL}:
        numbers[key] = _number(data[key], "value", file, key, maximum=1.0 if key == "poisson" else 1e9)
    as_measured = None
    if "tensor" in data:
        c11, c22, c66 = (_number(data["tensor"], key, file, "tensor") for key in ("c11", "c22", "c66"))
        c12 = _number(data["tensor"], "c12", file, "tensor", minimum=-1e9)
        tensor = *positive_definite(c11, c22, c12), c66
        as_measured = None if tensor == (c11, c22, c12, c66) else (c11, c22, c12, c66)
        numbers |= dict(zip((*_STRIPS, "poisson"), strips_of(*tensor), strict=True))
    verlet = {key: _number(data["verlet"], key, file, "verlet", maximum=1.0) for key in _VERLET_KEYS}
    sources = {key: _source(data[key], file, key) for key in data if key not in ("title", "look")}
    look = _look(data["look"], file)
    return Preset(
        name, str(data["title"]), **numbers, **verlet, look=look, sources=sources, measured_tensor=as_measured
    )


def positive_definite(c11: float, c22: float, c12: float) -> tuple[float, float, float]:
    """Return C₁₁, C₂₂ and C₁₂ [N/m] whose eigenvalues are at least `MIN_EIGENVALUE` times the largest.

    Smaller eigenvalues are raised to that; with all others unchanged, this is the nearest such tensor.
    """
    middle, half, radius = (c11 + c22) / 2, (c11 - c22) / 2, hypot((c11 - c22) / 2, c12)  # Mohr's circle
    rise = MIN_EIGENVALUE * (middle + radius) - (middle - radius)
    if rise <= 0:
        return c11, c22, c12
    # Along its eigenvector v. With radius r and half h, v·vᵀ is (1 − [h, C₁₂; C₁₂, −h]/r)/2.
    share = rise / (2 * radius)
    return c11 + share * (radius - half), c22 + share * (radius + half), c12 - share * c12


def strips_of(c11: float, c22: float, c12: float, c66: float) -> tuple[float, float, float, float]:
    """Return the stiffness of strips along warp, weft and bias [N/m], and Poisson's ratio, of a membrane's tensor.

    The reverse of `membrane_constants_of`.
    """
    warp, weft = c11 - c12**2 / c22, c22 - c12**2 / c11
    poisson = c12 / c22
    return warp, weft, 4 / (1 / warp + 1 / weft - 2 * poisson / warp + 1 / c66), poisson


def membrane_constants_of(warp: float, weft: float, bias: float, poisson: float) -> tuple[float, float, float, float]:
    """Return C₁₁, C₂₂, C₁₂ and C₆₆ of the membrane [N/m] whose strips have these stiffnesses [N/m] and Poisson's ratio.

    1/E₄₅ = (1/E₁ + 1/E₂ − 2·ν₁₂/E₁ + 1/C₆₆)/4 gives C₆₆.
    """
    c22 = weft / (1 - poisson**2 * weft / warp)
    shear = 4 / bias - 1 / warp - 1 / weft + 2 * poisson / warp
    return c22 * warp / weft, c22, poisson * c22, 1 / shear


def preset_values(preset: Preset, scene: Scene) -> dict[str, dict[str, object]]:
    """Return the values that a preset sets in a scene with this cloth: section → key → value.

    With one diagonal per cell, its shear spring is twice as stiff as each of two. Bend springs get no stiffness, since
    the sheet itself has the measured bending stiffness. `damping_time` is the measured time: slow stretch vibrations
    lose as much energy as measured, faster ones more.
    """
    strips = preset.warp, preset.weft, preset.bias
    warp, weft, shear = spring_stiffness_of(*strips)
    is_membrane = scene.fabric.model == "membrane"
    tensor = membrane_constants_of(*strips, preset.poisson) if is_membrane else (0.0,) * len(_TENSOR)
    return {
        "cloth": {"area_density": preset.area_density},
        "fabric": {
            "warp": warp,
            "weft": weft,
            "shear": shear * 2 / scene.cloth.diagonals,
            "bend_spring": 0.0,
            "bending_stiffness": preset.bending,
            "damping_time": preset.damping,
            "bending_weft": preset.bending_weft,
            **dict(zip(_TENSOR, tensor, strict=True)),
        },
        "verlet": {"structural": preset.structural, "shear": preset.shear, "bend": preset.bend},
        "look": preset.look,
    }


def with_fabric(scene: Scene, name: str, own: Scene) -> Scene:
    """Return the scene with a shipped fabric, or if `name` is "" with that of the scene `own`. Raises SceneError."""
    values: dict[str, dict[str, Any]] = {
        s: {key: getattr(getattr(own, s), key) for key in PRESET_KEYS[s]} for s in PRESET_KEYS
    }
    if name:
        values = {section: dict(keys) for section, keys in preset_values(load_preset(name), scene).items()}
    values["fabric"]["preset"] = name or own.fabric.preset
    if scene.tearing is not None:
        values["fabric"] |= {"bending_stiffness": 0.0, "bending_weft": 0.0}  # tearing does not support them
    changed: dict[str, Any] = {s: replace(getattr(scene, s), **keys) for s, keys in values.items()}
    return replace(scene, **changed)


def spring_stiffness_of(warp: float, weft: float, bias: float) -> tuple[float, float, float]:
    """Return the stiffness of springs along columns, rows and both diagonals [N/m] of a square grid.

    Strips of the grid then have the stiffness [N/m] `warp` along columns, `weft` along rows and `bias` at 45°.

    A cell with springs k_w, k_f and two diagonals k_d is a membrane with C11 = k_w + k_d, C22 = k_f + k_d and
    C12 = C66 = k_d. This is all that four springs can do: their shear stiffness is tied to their Poisson effect. For a
    given k_d, k_w and k_f have a closed form. The bias stiffness grows with k_d, which is found by bisection.

    Raises ValueError if a spring would need a negative stiffness.
    """
    low, high = 0.0, bias / 4  # diagonals alone give 4·k_d, and compliances add
    while _bias(warp, weft, high) < bias:
        low, high = high, high * 2
    while low < (middle := (low + high) / 2) < high:
        if _bias(warp, weft, middle) < bias:
            low = middle
        else:
            high = middle
    a, b = _diagonal(warp, weft, high)
    if min(a, b) <= high:
        raise ValueError(f"no grid of springs has {warp:g}, {weft:g} and {bias:g} N/m along warp, weft and bias")
    return a - high, b - high, high


def _diagonal(warp: float, weft: float, shear: float) -> tuple[float, float]:
    """Return C11 and C22 from warp = C11 − k_d²/C22 and weft = C22 − k_d²/C11. Their ratio is that of warp and weft."""
    ratio = warp / weft
    b = (weft + sqrt(weft**2 + 4 * shear**2 / ratio)) / 2
    return ratio * b, b


def _bias(warp: float, weft: float, shear: float) -> float:
    """Return the stiffness at 45° [N/m]: 1/E45 = (S11 + S22 + 2·S12 + S66)/4 with the compliances S = C⁻¹."""
    a, b = _diagonal(warp, weft, shear)
    return 4 / ((a + b - 2 * shear) / (a * b - shear**2) + 1 / shear)


def _number(table: object, key: str, file: str, where: str, minimum: float = 0.0, maximum: float = 1e9) -> float:
    value = table.get(key) if isinstance(table, dict) else None
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool) and isfinite(value)
    if not (is_number and minimum < value <= maximum):  # type: ignore[operator]
        allowed = f"must be a number above {minimum:g} and up to {maximum:g}"
        raise SceneError(file, f"{where}.{key}", f"{allowed}, got {short_repr(value)}")
    return float(value)  # type: ignore[arg-type]


def _look(table: object, file: str) -> dict[str, object]:
    if not isinstance(table, dict) or set(table) != set(_LOOK):
        raise SceneError(file, "look", f"must have the keys {', '.join(_LOOK)}")
    return table


def _source(table: Any, file: str, where: str) -> str:
    source = table.get("source")
    if not isinstance(source, str) or not source.strip():
        raise SceneError(file, f"{where}.source", "every number needs a source")
    return source
