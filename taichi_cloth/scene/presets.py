"""The shipped fabrics: measured numbers with their sources, and the spring constants that stand for them.

A scene names one with `[fabric] preset = "denim"`; the reader fills in every key that the scene leaves out.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, replace
from math import isfinite, sqrt
from typing import Any

from .errors import SceneError, nearest, shown
from .library import asset_folder
from .model import PRESET_NAMES, Cloth, Scene

_MEASURED = ("area_density", "warp", "weft", "bias", "bending", "damping")
_SHARES = ("structural", "shear", "bend")
_LOOK = ("cloth", "check", "check_cells", "pattern", "sheen")

# The keys of a scene that a fabric fills, by section.
FILLED = {
    "cloth": ("area_density",),
    "fabric": ("warp", "weft", "shear", "bend", "bending", "damping_time"),
    "springs": _SHARES,
    "look": _LOOK,
}


@dataclass(frozen=True)
class Preset:
    """A fabric as it is measured, whatever the grid and the solver; `sources` has a line for every table of its file.

    `warp`, `weft` and `bias` are the tensile stiffness of a narrow strip per metre of its width, cut along the
    threads and at 45° to them. `damping` is the time by which stress runs ahead of strain, at the first stretch
    vibration of a sheet 1 m long. The shares are for `verlet` and no physical quantity.
    """

    name: str
    title: str
    area_density: float  # [kg/m²]
    warp: float  # [N/m]
    weft: float  # [N/m]
    bias: float  # [N/m]
    bending: float  # [N·m]
    damping: float  # [s]
    structural: float  # 0…1
    shear: float  # 0…1
    bend: float  # 0…1
    look: dict[str, Any]  # keys of a scene's [look]
    sources: dict[str, str]


def load_preset(name: str) -> Preset:
    """A shipped fabric. Raises SceneError for a name that is none, and for a number without a source."""
    if name not in PRESET_NAMES:
        raise SceneError("", "preset", f"no such fabric: {', '.join(PRESET_NAMES)}", nearest(name, PRESET_NAMES))
    path = asset_folder() / "presets" / f"{name}.toml"
    file = str(path)
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    expected = {"title", "springs", "look", *_MEASURED}
    if set(data) != expected:
        raise SceneError(file, "", f"a fabric has {', '.join(sorted(expected))}, not {', '.join(sorted(data))}")
    numbers = {key: _number(data[key], "value", file, key) for key in _MEASURED}
    shares = {key: _number(data["springs"], key, file, "springs", most=1.0) for key in _SHARES}
    sources = {key: _source(data[key], file, key) for key in (*_MEASURED, "springs")}
    return Preset(name, str(data["title"]), **numbers, **shares, look=_look(data["look"], file), sources=sources)


def preset_keys(preset: Preset, cloth: Cloth) -> dict[str, dict[str, Any]]:
    """What the fabric sets in a scene with this grid: section → key → value.

    Of one diagonal a cell each spring stands for two. The sheet resists bending itself and needs no springs for it.
    `damping_time` is the measured time as it is: with it the slow
    stretch vibrations lose what was measured and the fast ones more.
    """
    warp, weft, shear = spring_constants(preset.warp, preset.weft, preset.bias)
    return {
        "cloth": {"area_density": preset.area_density},
        "fabric": {
            "warp": warp,
            "weft": weft,
            "shear": shear * 2 / cloth.diagonals,
            "bend": 0.0,
            "bending": preset.bending,
            "damping_time": preset.damping,
        },
        "springs": {"structural": preset.structural, "shear": preset.shear, "bend": preset.bend},
        "look": preset.look,
    }


def in_fabric(scene: Scene, name: str, own: Scene) -> Scene:
    """The scene in a shipped fabric, or by the name "" in that of the scene `own`. Raises SceneError."""
    given: dict[str, dict[str, Any]] = {s: {key: getattr(getattr(own, s), key) for key in FILLED[s]} for s in FILLED}
    if name:
        given = {section: dict(keys) for section, keys in preset_keys(load_preset(name), scene.cloth).items()}
    given["fabric"]["preset"] = name or own.fabric.preset
    if scene.tear is not None:
        given["fabric"]["bending"] = 0.0  # it could not be cut
    changed: dict[str, Any] = {s: replace(getattr(scene, s), **keys) for s, keys in given.items()}
    return replace(scene, **changed)


def spring_constants(warp: float, weft: float, bias: float) -> tuple[float, float, float]:
    """Constants down a column, along a row and along both diagonals [N/m] that give strips of a square grid the
    measured stiffness [N/m] along warp, weft and bias.

    A cell with springs k_w, k_f and two diagonals k_d is a membrane with C11 = k_w + k_d, C22 = k_f + k_d and
    C12 = C66 = k_d, which is what four springs can do: they have no shear stiffness apart from their Poisson effect.
    With k_d given, warp and weft have a closed form; the bias grows with k_d, and bisection finds the one asked for.
    Raises ValueError where it would take a spring that pushes.
    """
    low, high = 0.0, bias / 4  # diagonals alone give 4·k_d, and compliances add up
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
    """C11 and C22 from warp = C11 − k_d²/C22 and weft = C22 − k_d²/C11, whose ratio is that of C11 and C22."""
    ratio = warp / weft
    b = (weft + sqrt(weft**2 + 4 * shear**2 / ratio)) / 2
    return ratio * b, b


def _bias(warp: float, weft: float, shear: float) -> float:
    """Stiffness at 45°: 1/E45 = (S11 + S22 + 2·S12 + S66)/4 with the compliances S = C⁻¹."""
    a, b = _diagonal(warp, weft, shear)
    return 4 / ((a + b - 2 * shear) / (a * b - shear**2) + 1 / shear)


def _number(table: Any, key: str, file: str, where: str, most: float = 1e9) -> float:
    value = table.get(key) if isinstance(table, dict) else None
    fine = isinstance(value, (int, float)) and not isinstance(value, bool) and isfinite(value) and 0 < value <= most
    if not fine:
        raise SceneError(file, f"{where}.{key}", f"a number above 0 and up to {most:g} is needed, not {shown(value)}")
    return float(value)  # type: ignore[arg-type]


def _look(table: Any, file: str) -> dict[str, Any]:
    if not isinstance(table, dict) or set(table) != set(_LOOK):
        raise SceneError(file, "look", f"a fabric's look has {', '.join(_LOOK)}")
    return table


def _source(table: Any, file: str, where: str) -> str:
    source = table.get("source")
    if not isinstance(source, str) or not source.strip():
        raise SceneError(file, f"{where}.source", "every number needs a source")
    return source
