"""The parameters that may change while a scene runs: those whose key declares a slider."""

from __future__ import annotations

from dataclasses import dataclass

from .model import Key, Scene, keys_of, parts
from .values import check_value

# The panel's order; keys that are not named here follow in the scene's own.
_ORDER = ("gravity", "wind_x", "wind_z", "stiffness", "damping", "sphere_radius", "iterations", "substeps")


@dataclass(frozen=True)
class LiveKey:
    """One parameter: its name, what may be set (`key`), the ends of its slider, and the scene's own value."""

    name: str
    key: Key
    low: float
    high: float
    value: float

    @property
    def label(self) -> str:
        first, *words = self.name.removeprefix("self_collision_").split("_")  # a slider leaves room for 17 letters
        return " ".join([first.capitalize(), *(word.upper() if len(word) == 1 else word for word in words)])

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
    """Every live parameter the scene has, by name, in the panel's order.

    A key of a section that every scene has goes by its own name, others by section and key: `gravity`, `wind_x`.
    Of several spheres it is the first that the slider moves.
    """
    found = {}
    for part in parts().values():
        section = getattr(scene, part.name)
        if part.many:
            section = next(iter(section), None)
        for key_name, key in keys_of(part.section).items():
            if section is not None and key.slider:
                name = f"{part.one}_{key_name}" if part.optional else key_name
                found[name] = LiveKey(name, key, *key.slider, value=getattr(section, key_name))
    known = [name for name in _ORDER if name in found]
    return {name: found[name] for name in dict.fromkeys([*known, *found])}


def check_live(live: LiveKey, value: object) -> float:
    """`value` as the parameter's type. Raises SceneError, a ValueError, if it is no number or out of range."""
    checked: float = check_value(value, type(live.value), live.key, "", live.name)
    return checked
