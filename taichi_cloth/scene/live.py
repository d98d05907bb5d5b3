"""The parameters that may change while a scene runs: those whose key declares a slider."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .errors import SceneError, one_line
from .model import Forces, Key, Scene, Solver, Sphere, Wind, key_of
from .reader import check_value

# In the panel's order: live name, label, section and key.
_PLACES: tuple[tuple[str, str, type, str], ...] = (
    ("gravity", "Gravity", Forces, "gravity"),
    ("wind_x", "Wind X", Wind, "x"),
    ("wind_z", "Wind Z", Wind, "z"),
    ("stiffness", "Stiffness", Solver, "stiffness"),
    ("damping", "Damping", Solver, "damping"),
    ("sphere_radius", "Sphere radius", Sphere, "radius"),
    ("iterations", "Iterations", Solver, "iterations"),
    ("substeps", "Substeps", Solver, "substeps"),
)


@dataclass(frozen=True)
class LiveKey:
    """One parameter: what it is called, the ends of its slider, and the scene's own value."""

    name: str
    label: str
    key: Key
    low: float
    high: float
    value: float

    @property
    def is_int(self) -> bool:
        return isinstance(self.value, int)

    @property
    def unit(self) -> str:
        return self.key.unit

    @property
    def help(self) -> str:
        return self.key.help


def live_keys(scene: Scene) -> dict[str, LiveKey]:
    """Every live parameter the scene has, by name, in the panel's order."""
    parts: dict[type, Any] = {Forces: scene.forces, Solver: scene.solver, Wind: scene.wind}
    parts[Sphere] = scene.spheres[0] if scene.spheres else None
    found = {}
    for name, label, section, key_name in _PLACES:
        if parts[section] is not None:
            key = key_of(section, key_name)
            low, high = key.slider or (0.0, 1.0)
            found[name] = LiveKey(name, label, key, low, high, getattr(parts[section], key_name))
    return found


def check_live(live: LiveKey, value: Any) -> float:
    """`value` as the parameter's type. Raises ValueError in one line if it is no number or out of range."""
    try:
        checked: float = check_value(value, type(live.value), live.key, "", live.name)
    except SceneError as error:
        raise ValueError(one_line(str(error))) from None
    return checked
