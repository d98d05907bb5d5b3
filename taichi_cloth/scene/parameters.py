"""Runtime parameters: the scene keys with a slider. They may change while a simulation runs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

from .keys import Key, Section, check_value, keys_of
from .schema import Scene, sections

# First parameters of the panel; the others follow in the order of the schema.
_ORDER = ("gravity", "wind_x", "wind_z", "stiffness", "damping", "sphere_radius", "iterations", "substeps")


@dataclass(frozen=True)
class Parameter:
    """One runtime parameter of a scene."""

    name: str
    key: Key
    """Type, unit and allowed range."""
    slider_min: float
    """Lower end of its slider."""
    slider_max: float
    """Upper end of its slider."""
    value: float
    """Value in the scene."""
    section: str
    """Name of its section."""
    index: int
    """Index in an array of tables; 0 for other sections."""
    key_name: str
    """Name of its key within the section."""

    @property
    def label(self) -> str:
        """Name in the panel, which has space for 17 characters."""
        first, *words = self.name.removeprefix("self_collision_").split("_")
        return " ".join([first.capitalize(), *(word.upper() if len(word) == 1 else word for word in words)])

    @property
    def is_int(self) -> bool:
        return isinstance(self.value, int)

    @property
    def min(self) -> float | None:
        """Smallest allowed value."""
        return self.key.min

    @property
    def max(self) -> float | None:
        """Largest allowed value."""
        return self.key.max

    @property
    def unit(self) -> str:
        return self.key.unit

    @property
    def help(self) -> str:
        return self.key.help


def parameters_of(scene: Scene) -> dict[str, Parameter]:
    """Return the runtime parameters of a scene by name, in the order of the panel.

    A key of a section that every scene has is named by the key alone (`gravity`), other keys by section and key
    (`wind_x`). The parameters of a collider start with its `name`. Without a name, those of the first collider of a
    shape start with the shape (`sphere_radius`), and other colliders have none.
    """
    parameters = {}
    for part in sections().values():
        value = getattr(scene, part.name)
        for index, section in enumerate(value if part.is_array else [] if value is None else [value]):
            for key_name, key in keys_of(part.cls).items():
                if key.slider and (name := _name(part, index, section, key_name, key)):
                    default = getattr(section, key_name)
                    parameters[name] = Parameter(name, key, *key.slider, default, part.name, index, key_name)
    known = [name for name in _ORDER if name in parameters]
    return {name: parameters[name] for name in dict.fromkeys([*known, *parameters])}


@cache
def parameter_names() -> frozenset[str]:
    """Return the names of the runtime parameters that scenes may have, without those of colliders with a name."""
    keys = ((part, name, key) for part in sections().values() for name, key in keys_of(part.cls).items() if key.slider)
    return frozenset(_name(part, 0, part.cls(), name, key) for part, name, key in keys)


def _name(part: Section, index: int, section: Any, key_name: str, key: Key) -> str:
    """Return the name of a parameter, or "" for a collider without a name."""
    if key.slider_name:
        return key.slider_name
    if part.is_array:
        prefix = section.name or (part.singular if index == 0 else "")
        return f"{prefix}_{key_name}" if prefix else ""
    return f"{part.singular}_{key_name}" if part.optional else key_name


def check_parameter(parameter: Parameter, value: object) -> float:
    """Return `value` as the parameter's type. Raises SceneError (a ValueError) for a wrong type or range."""
    checked: float = check_value(value, type(parameter.value), parameter.key, "", parameter.name)
    return checked
