"""The runtime parameters of a running simulation, and checks of numbers from callers and files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, MutableMapping
from dataclasses import replace
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..scene import Scene
from ..scene.keys import keys_of
from ..scene.overrides import targets_of
from ..scene.parameters import Parameter, check_parameter, parameter_names
from ..scene.schema import COLLIDERS
from ..system.errors import choose_from, nearest_name, short_repr

Floats = NDArray[np.float64]

MAX_COORDINATE = 1e6  # [m], [m/s] ten times what a scene file allows; its square does not overflow float32
MAX_FRAMES = 10**9  # half a year of simulated time


def check_vectors(values: ArrayLike, name: str, *shapes: tuple[int, ...]) -> Floats:
    """Return `values` as an array of one of these shapes.

    Raises ValueError for another shape, and for numbers that are not finite or beyond ±`MAX_COORDINATE`.
    """
    array = check_numbers(values)
    if array.shape not in shapes:
        raise ValueError(f"{name} must be numbers of shape {' or '.join(map(str, shapes))}")
    bad = ~(np.abs(array) <= MAX_COORDINATE)
    if bad.any():
        reason = f"beyond ±{MAX_COORDINATE:g}" if np.isfinite(array[bad]).all() else "not finite"
        where = f" at particle {np.argwhere(bad)[0, 0]}" if array.ndim == 2 else ""
        raise ValueError(f"invalid number in {name}: {reason}{where}")
    return array


def check_target(target: ArrayLike) -> Floats:
    """Return a position as an array, (3,) [m]. Raises ValueError unless it is three numbers up to ±`MAX_COORDINATE`."""
    point = check_numbers(target)
    if point.shape != (3,) or not (np.abs(point) <= MAX_COORDINATE).all():
        raise ValueError(
            f"target must be three finite numbers [m], up to ±{MAX_COORDINATE:g}, not {short_repr(target)}"
        )
    return point


def check_radius(radius: float) -> float:
    """Return a radius [m]. Raises ValueError unless it is a number from 0 to `MAX_COORDINATE`."""
    number = check_numbers(radius)
    if number.shape != () or not 0 <= number <= MAX_COORDINATE:
        raise ValueError(f"radius must be a number from 0 to {MAX_COORDINATE:g} [m], not {short_repr(radius)}")
    return float(number)


def check_frames(frames: SupportsIndex, name: str = "frames", least: int = 0) -> int:
    """Return a number of frames. Raises ValueError unless it is an integer from `least` to `MAX_FRAMES`."""
    if isinstance(frames, (bool, np.bool_)) or not isinstance(frames, (int, np.integer)) or frames < least:
        raise ValueError(f"{name} must be an integer from {least}, not {short_repr(frames)}")
    if frames > MAX_FRAMES:
        raise ValueError(f"{name} must be at most {MAX_FRAMES}, not {short_repr(frames)}")
    return int(frames)


def check_particle(particle: SupportsIndex, count: int) -> int:
    """Return the index of one of `count` particles. Raises ValueError if there is none."""
    if isinstance(particle, bool) or not isinstance(particle, (int, np.integer)):
        raise ValueError(f"a particle is an index or a position, not {short_repr(particle)}")
    if not 0 <= particle < count:
        raise ValueError(f"particle index must be in 0..{count - 1}, not {particle}")
    return int(particle)


MAX_SIDE = 8192  # [pixels] of an image


def check_image_size(size: object) -> tuple[int, int]:
    """Return width and height [pixels]. Raises ValueError unless they are two integers from 1 to `MAX_SIDE`."""
    sides = list(size) if isinstance(size, (list, tuple, np.ndarray)) else []
    if len(sides) != 2 or not all(isinstance(n, (int, np.integer)) and 1 <= n <= MAX_SIDE for n in sides):
        raise ValueError(f"size must be width and height, 1 to {MAX_SIDE} pixels each, not {short_repr(size)}")
    return int(sides[0]), int(sides[1])


def check_numbers(values: ArrayLike) -> Floats:
    """Return `values` as a new float64 array; an empty one if they are not numbers."""
    try:
        array = np.array(values)
    except (TypeError, ValueError):  # rows of different lengths
        return np.zeros(0)
    return array.astype(np.float64) if array.dtype.kind in "iuf" else np.zeros(0)


WIND = "wind"  # the switch of the wind, beside the parameters


class Parameters(MutableMapping[str, "float | bool"]):
    """Values by name, with the switch `wind`. Setting one takes effect in the next frame.

    Raises ValueError, and changes nothing, for an unknown name, a value that is no number or out of range, and a switch
    that is not True or False.
    """

    __slots__ = ("_known", "_on_set", "values_by_name", "wind_on")  # `params.wind_z = 6` raises AttributeError

    def __init__(self, on_set: Callable[[str, float | bool], None]) -> None:
        """`on_set` is called with a name and its checked value, instead of setting it here."""
        self._on_set = on_set
        self._known: dict[str, Parameter] = {}
        self.values_by_name: dict[str, float] = {}
        self.wind_on = True

    def info(self, name: str) -> Parameter:
        """Return range, unit and help of a parameter. Raises ValueError for the switch `wind`, which has no range."""
        if name == WIND and self._has_wind:
            raise ValueError("'wind' is a switch, True or False: it has no range")
        return self._known[self._checked(name)]

    def __getitem__(self, name: str) -> float | bool:
        if name == WIND:
            return self.wind_on and self._has_wind
        return self.values_by_name[self._checked(name)]

    def get(self, name: str, default: Any = None) -> Any:
        """Return a value, or `default` if the scene has no parameter of this name."""
        try:
            return self[name]
        except ValueError:
            return default

    def __setitem__(self, name: str, value: float | bool) -> None:
        self._on_set(name, self.check(name, value))

    def update(self, other: Any = (), /, **values: float | bool) -> None:
        """Set several values, as `dict.update`; none if one of them is invalid."""
        checked = {name: self.check(name, value) for name, value in dict(other, **values).items()}
        for name, value in checked.items():
            self._on_set(name, value)

    def __delitem__(self, name: str) -> None:
        raise TypeError("parameters cannot be deleted")

    def __contains__(self, name: object) -> bool:
        return name in self._known or (name == WIND and self._has_wind)

    def __iter__(self) -> Iterator[str]:
        return iter(self.values_by_name)

    def __len__(self) -> int:
        return len(self.values_by_name)

    def __repr__(self) -> str:
        return repr(dict(self))

    def check(self, name: str, value: float | bool) -> float | bool:
        """Return `value` as the parameter's type."""
        if name == WIND and self._has_wind:
            if not isinstance(value, (bool, np.bool_)):
                raise ValueError(f"wind is switched by True and False, not {short_repr(value)}")
            return bool(value)
        return check_parameter(self.info(name), value)

    def assign(self, name: str, value: float | bool) -> None:
        """Set a checked value."""
        if name == WIND:
            self.wind_on = bool(value)
        else:
            self.values_by_name[name] = value

    def replace_known(self, known: Mapping[str, Parameter], **values: float) -> None:
        """Continue with the parameters of another scene.

        A value is kept unless the value in the scene has changed, or `values` sets it.
        """
        kept = {name for name, last in self._known.items() if name in known and known[name].value == last.value}
        current = {name: self.values_by_name[name] if name in kept else new.value for name, new in known.items()}
        self._known, self.values_by_name = dict(known), current | values

    def known(self) -> dict[str, Parameter]:
        """Return all parameters by name."""
        return dict(self._known)

    @property
    def _has_wind(self) -> bool:
        return any(known.section == WIND for known in self._known.values())

    def _checked(self, name: str) -> str:
        if name not in self._known:
            raise ValueError(f"{name!r} is not a parameter of this scene{self._reason_unknown(name)}")
        return name

    def _reason_unknown(self, name: str) -> str:
        """Return why a scene key is not a parameter of this scene, or for other names the parameters to choose from."""
        if name == WIND:
            return _no_section(WIND)
        for part, key in targets_of(name) if isinstance(name, str) else ():
            if part and keys_of(part.cls)[key].slider is None:
                return f": {part.name}.{key} {SWITCHES.get(part.name, SWITCH_SCENE)}"
            if part and part.name not in {known.section for known in self._known.values()}:
                return _no_section(part.name)
        return choose_from(name, [*self._known, *[WIND] * self._has_wind])


def _no_section(section: str) -> str:
    """Return that a scene has no section of this name, and how to add one."""
    return f": it has no [{section}]; load_scene adds one, as in load_scene(scene, {section}={{...}})"


SWITCH_SCENE = "is changed by switch_scene, not by a parameter"
SWITCHES = {  # how a scene's key changes while it runs, by section
    "cloth": "cannot change while the scene runs; load_scene sets it",
    "solver": "is changed by switch_solver, not by a parameter",
    "fabric": "is changed by switch_fabric and switch_scene, not by a parameter",
}


def with_values(scene: Scene, params: Parameters, damping_time: float) -> Scene:
    """Return a scene with the values of its parameters, but those of colliders, and the damping time in use [s]."""
    values: dict[str, dict[str, float]] = {"fabric": {"damping_time": damping_time}}
    for name, parameter in params.known().items():
        if parameter.section not in COLLIDERS:
            values.setdefault(parameter.section, {})[parameter.key_name] = params.values_by_name[name]
    if not params.wind_on and scene.wind is not None:
        values[WIND] |= {"x": 0.0, "z": 0.0}
    changed: dict[str, Any] = {name: replace(getattr(scene, name), **of) for name, of in values.items()}
    return replace(scene, **changed)


class HasParameters:
    """A simulation with runtime parameters. They are no attributes: assigning one by mistake is refused."""

    _params: Parameters

    @property
    def params(self) -> Parameters:
        """The runtime parameters by name."""
        return self._params

    def __setattr__(self, name: str, value: object) -> None:
        """Set an attribute.

        Raises AttributeError for the name of a runtime parameter, of this scene or another, and one close to it.
        """
        if name.startswith("_"):  # most of those that a frame sets
            super().__setattr__(name, value)
            return
        if name in self.__dict__.get("_params", ()) or name == WIND or name in parameter_names():
            raise AttributeError(f"{name} is a runtime parameter: set params[{name!r}]")
        if callable(getattr(type(self), name, None)) and not callable(value):
            hint = "; set_state moves the cloth" if name in ("positions", "velocities") else ""
            raise AttributeError(f"{name} is a method, not an attribute to set{hint}")
        if not hasattr(self, name) and (near := nearest_name(name, self.__dict__.get("_params", ()))):
            raise AttributeError(f"a simulation has no attribute {name!r}; did you mean params[{near!r}]?")
        super().__setattr__(name, value)
