"""Metadata of scene keys, and checks against it: values (type, range, choices), tables of keys, and sections."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import Field, dataclass, field, fields, replace
from functools import cache
from itertools import chain, pairwise
from math import isfinite
from os import PathLike, fspath
from typing import Any, ClassVar, NamedTuple, get_args, get_origin, get_type_hints

from ..system.errors import OTHER_WORDS, RENAMED_SOLVERS, Mistakes, SceneError, nearest_name, new_key, short_repr

Vec3 = tuple[float, float, float]
Keyframes = tuple[tuple[float, ...], ...]
Curve = tuple[tuple[float, float], ...]
Pins = tuple[str | int, ...]
Weights = str | tuple[float, ...] | tuple[tuple[float, ...], ...]  # a map: its file, its values, or rows of them

# A pin is an edge, a corner, the index of a particle, `group:NAME` or `region:NAME`.
EDGES = ("top", "bottom", "left", "right")
CORNERS = ("top-left", "top-right", "bottom-left", "bottom-right")
GROUP, REGION = "group:", "region:"  # prefixes: a group of a mesh file; one of [[regions]]
PIN_NAMES = (*EDGES, *CORNERS)
KEYS_TITLE = "Keys:"  # of the docstring of a section
MAX_TABLES, MAX_POINTS = 16, 8  # of one section, such as [[spheres]]; points of a curve, compiled into a sum
MAX_WEIGHTS = 40_000  # values of a map in a scene, which are written into its file

_TYPE_NAMES = {bool: "true or false", int: "an integer", float: "a number", str: "a string"}
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")  # including line ends and surrogates


@dataclass(frozen=True)
class Key:
    """Metadata of one scene key: meaning, unit and allowed values."""

    help: str
    unit: str = ""
    min: float | None = None
    max: float | None = None
    """Ends of the allowed range."""
    exclusive_min: bool = False
    """Whether `min` itself is not allowed."""
    slider: tuple[float, float] | None = None
    """Ends of the slider, for a key that may change while the simulation runs."""
    slider_name: str = ""
    """Name of the runtime parameter, if it does not follow from section and key."""
    param: str = ""
    """Column of the step parameters that holds the value, a constant of `kernels/step_params.py`."""
    choices: tuple[str, ...] = ()
    """Allowed strings; all if empty."""
    color: bool = False
    """Whether the string must be #rrggbb."""
    axes: tuple[str, str] = ("", "")
    """What a curve shows, for messages: x and y."""


def key_field(default: Any, help: str, unit: str = "", **bounds: Any) -> Any:
    """Return the field of a key: its default and metadata."""
    return field(default=default, metadata={"key": Key(help, unit, **bounds)})


@cache
def keys_of(section: type) -> dict[str, Key]:
    """Return the metadata of a section's keys by name, as in `keys_of(Wind)["x"].unit`."""
    return {f.name: f.metadata["key"] for f in fields(section) if "key" in f.metadata}


@cache
def types_of(section: type) -> dict[str, object]:
    """Return the types of a section's keys by name."""
    return get_type_hints(section)


def check_value(value: Any, hint: Any, key: Key, file: str, where: str) -> Any:
    """Return `value` as the type `hint`. Raises SceneError if its type is wrong or `key` does not allow it."""
    value = without_numpy(value)
    if hint in (str, Weights) and isinstance(value, PathLike):
        value = fspath(value)
    if hint == Weights:
        if not isinstance(value, str):
            return _weights(value, file, where)
        hint = str
    if hint == Vec3:
        if not isinstance(value, (list, tuple)) or len(value) != 3:
            raise SceneError(file, where, f"must be three numbers, as in [0.0, 1.0, 0.0], got {short_repr(value)}")
        return _each(value, lambda k, v: check_value(v, float, key, file, f"{where}[{k}]"))
    if hint == Keyframes:
        return _keyframes(value, key, file, where)
    if hint == Curve:
        return _curve(value, key, file, where)
    if hint == Pins:
        if isinstance(value, (str, int)):  # a single pin without brackets
            value = [value]
        if not isinstance(value, (list, tuple)):
            raise SceneError(file, where, f'must be a list, as in ["top", 17], got {short_repr(value)}')
        return _each(value, lambda k, v: _pin(without_numpy(v), file, f"{where}[{k}]"))
    accepted: Any = (int, float) if hint is float else hint
    if not isinstance(value, accepted) or (isinstance(value, bool) and hint is not bool):
        raise SceneError(file, where, f"must be {_TYPE_NAMES[hint]}, got {short_repr(value)}")
    if hint is str:
        _check_string(str(value), key, file, where)
    elif hint is not bool:
        _check_number(value, key, file, where)
    return hint(value)


def _each(values: Sequence[Any], check: Callable[[int, Any], Any]) -> tuple[Any, ...]:
    """Return what `check` returns for the number and value of each element.

    Raises the SceneError of the first wrong element, with those of the others.
    """
    checked, errors = [], []
    for k, value in enumerate(values):
        try:
            checked.append(check(k, value))
        except SceneError as error:
            errors += [error, *error.others]
    if errors:
        errors[0].others = tuple(errors[1:])
        raise errors[0]
    return tuple(checked)


def without_numpy(value: Any) -> Any:
    """Return numbers, strings and arrays of NumPy as Python's own; other values are returned unchanged."""
    to_python = None if isinstance(value, type) else getattr(value, "tolist", None)
    return to_python() if callable(to_python) else value


def toml_value(value: object) -> str:
    """Return a value of a scene in TOML syntax."""
    value = without_numpy(value)  # whose numbers have a `repr` that is no TOML
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, str):  # TOML basic strings have the escapes of JSON
        return json.dumps(value, ensure_ascii=False)
    return str(value).lower() if isinstance(value, bool) else repr(value)


def range_text(key: Key) -> str:
    """Return the allowed values of a key as text: the range with its unit, or the choices."""
    if key.min is None or key.max is None:
        return "#rrggbb" if key.color else ", ".join(choice or '""' for choice in key.choices)
    return f"{'above ' * key.exclusive_min}{key.min:.10g} to {key.max:.10g} {key.unit}".rstrip()


def _check_number(value: float, key: Key, file: str, where: str) -> None:
    if isinstance(value, float) and not isfinite(value):
        raise SceneError(file, where, f"must be a finite number, got {value}")
    too_low = key.min is not None and (value <= key.min if key.exclusive_min else value < key.min)
    if too_low or (key.max is not None and value > key.max):
        raise SceneError(file, where, f"{short_repr(value)} is out of range: {range_text(key)}")


def _check_string(value: str, key: Key, file: str, where: str) -> None:
    if key.choices and RENAMED_SOLVERS.get(value) in key.choices:
        raise SceneError(file, where, f"{value} was renamed to {RENAMED_SOLVERS[value]}")
    if key.choices and value not in key.choices:
        raise SceneError(
            file, where, f"{short_repr(value)} is not one of: {range_text(key)}", nearest_name(value, key.choices)
        )
    if key.color and not re.fullmatch("#[0-9a-fA-F]{6}", value):
        raise SceneError(file, where, f"must be a color #rrggbb, as in #b5303c, got {short_repr(value)}")
    if _CONTROL.search(value):
        raise SceneError(file, where, f"must be one line of plain text, got {short_repr(value)}")


def _keyframes(value: object, key: Key, file: str, where: str) -> Keyframes:
    """Return checked keyframes: rows of 4 or 7 numbers with increasing times."""
    if not isinstance(value, (list, tuple)):
        raise SceneError(file, where, f"must be rows, as in [[0, 0, 0, 0], [2, 0, 1, 0]], got {short_repr(value)}")

    def checked_row(k: int, row: Any) -> tuple[float, ...]:
        if not isinstance(row, (list, tuple)) or len(row) not in (4, 7):
            reason = "must be seconds, x, y, z and optionally three angles"
            raise SceneError(file, f"{where}[{k}]", f"{reason}, got {short_repr(row)}")
        return _each(row, lambda n, v: check_value(v, float, key, file, f"{where}[{k}][{n}]"))

    rows = _each(value, checked_row)
    for k, (before, after) in enumerate(pairwise(rows), 1):
        if after[0] <= before[0]:
            raise SceneError(file, f"{where}[{k}]", f"times must increase, got {after[0]:g} s after {before[0]:g} s")
    return rows


def _curve(value: object, key: Key, file: str, where: str) -> Curve:
    """Return the checked points of a curve that increases from [0, 0], without that point; none for no curve."""
    if not isinstance(value, (list, tuple)):
        raise SceneError(file, where, f"must be pairs, as in [[0.02, 5], [0.1, 50]], got {short_repr(value)}")
    number = Key("", min=0.0, max=1e9)

    def checked_point(k: int, pair: Any) -> tuple[Any, ...]:
        if not isinstance(pair, (list, tuple)) or len(pair) != 2:
            raise SceneError(file, f"{where}[{k}]", f"must be a pair of numbers, got {short_repr(pair)}")
        return _each(pair, lambda n, v: check_value(v, float, number, file, f"{where}[{k}][{n}]"))

    points = _each(value, checked_point)
    points = points[1:] if points and points[0] == (0.0, 0.0) else points
    if value and not 1 <= len(points) <= MAX_POINTS:
        raise SceneError(file, where, f"must have 1 to {MAX_POINTS} points besides [0, 0], got {len(points)}")
    for before, after in pairwise(((0.0, 0.0), *points)):
        for name, low, high in zip(key.axes, before, after, strict=True):
            if high <= low:
                raise SceneError(file, where, f"{name} {high:g} is not greater than {low:g}")
    return points


def _weights(values: object, file: str, where: str) -> tuple[float, ...] | tuple[tuple[float, ...], ...]:
    """Return the values of a map, 0…1, or rows of them."""
    if not isinstance(values, (list, tuple)):
        raise SceneError(file, where, f"must be a file or one number per particle, got {short_repr(values)}")
    rows = bool(values) and all(isinstance(row, (list, tuple)) for row in values)
    flat, lengths = list(chain(*values)) if rows else values, {len(row) for row in values} if rows else {1}
    if len(lengths) > 1:
        raise SceneError(file, where, f"rows must be equally long, got {max(lengths)} and {min(lengths)} numbers")
    if not flat:
        raise SceneError(file, where, 'must have one number per particle; for no map, write ""')
    if len(flat) > MAX_WEIGHTS:
        most = f"at most {MAX_WEIGHTS} are allowed; write more to a file, with numpy.save"
        raise SceneError(file, where, f"has {len(flat)} numbers, {most}")
    for k, value in enumerate(flat):
        if not isinstance(value, (int, float)) or not 0 <= value <= 1:  # NaN fails
            raise SceneError(file, where, f"value {k + 1} must be a number from 0 to 1, got {short_repr(value)}")
    return tuple(tuple(map(float, row)) for row in values) if rows else tuple(map(float, flat))


def _pin(value: object, file: str, where: str) -> str | int:
    """Return a pin of valid form. Whether the cloth has it is checked with the complete scene."""
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    if isinstance(value, str) and (value in PIN_NAMES or value.startswith((GROUP, REGION))):
        if _CONTROL.search(value):
            raise SceneError(file, where, f"must be one line of plain text, got {short_repr(value)}")
        return value
    if isinstance(value, str) and "," in value:
        names = ", ".join(f'"{name.strip()}"' for name in value.split(","))
        raise SceneError(file, where, f"{short_repr(value)} is not a pin; write a list, as in [{names}]")
    reason = (
        f"{short_repr(value)} is not a pin; use an edge or corner ({', '.join(PIN_NAMES)}), a particle index, "
        f"{REGION}NAME or {GROUP}NAME"
    )
    raise SceneError(file, where, reason, nearest_name(value, PIN_NAMES) if isinstance(value, str) else "")


# -- tables and sections -----------------------------------------------------------------------------------------------


class Table:
    """Base of the dataclasses of sections and scene: a keyword that is no field is refused as a key in a file is."""

    __dataclass_fields__: ClassVar[dict[str, Any]]
    given_keys: frozenset[str]
    """Fields that were set when the object was made; all of them in an object that a scene has."""

    def __init_subclass__(cls) -> None:
        """Append the keys with their meaning and range to the docstring, for `help`."""
        inherited = [getattr(base, "__dataclass_fields__", {}).items() for base in reversed(cls.__mro__[1:])]
        own = [(name, one) for name, one in vars(cls).items() if isinstance(one, Field)]
        keys = {name: one.metadata["key"] for name, one in chain(*inherited, own) if "key" in one.metadata}
        if cls.__doc__ and keys:
            lines = [f"    {name}: {key.help}, {range_text(key)}".rstrip(", ") for name, key in keys.items()]
            cls.__doc__ = "\n".join([cls.__doc__.rstrip(), "", f"    {KEYS_TITLE}", *lines])

    def __new__(cls, *args: Any, **keywords: Any) -> Any:
        known = cls.__dataclass_fields__
        if args and all(one.kw_only for one in known.values()):
            example = "center=[0, 1, 0]" if "center" in known else f"{next(iter(cls.__annotations__))}=..."
            raise SceneError(cls.__name__, "", f"values need the names of keys, as in {cls.__name__}({example})")
        for name in (one for one in keywords if one not in known):
            keys = [key for key, one in known.items() if "derived" not in one.metadata]
            raise SceneError(cls.__name__, name, *_unknown_key("[" * ("keyframes" in known), name, keys))
        table = super().__new__(cls)
        object.__setattr__(table, "given_keys", frozenset((*list(known)[: len(args)], *keywords)))
        return table

    def _set_defaults(self, **values: Any) -> None:
        """Set the fields that were not given, for defaults that depend on other fields."""
        for name in values.keys() - self.given_keys:
            object.__setattr__(self, name, values[name])


def given_table(section: Any) -> dict[str, Any]:
    """Return the keys that a dict or an object of a section sets; none for any other value."""
    if isinstance(section, Table):
        cls: type = type(section)
        return {name: getattr(section, name) for name in keys_of(cls) if name in section.given_keys}
    return dict(section) if isinstance(section, dict) else {}


class Section(NamedTuple):
    """One section of a scene: its table in a file, and its class."""

    name: str
    """Name of the table: "wind", "spheres"."""
    cls: type
    """Dataclass of the section."""
    is_array: bool
    """Whether it is an array of tables, as [[spheres]]."""
    optional: bool
    """Whether a scene may have no such section."""

    @property
    def singular(self) -> str:
        """Name of one table: "wind", "sphere"."""
        return self.cls.__name__.lower() if self.is_array else self.name

    def checked(self, value: Any, mistakes: Mistakes) -> Any:
        """Return the section as a scene stores it: an object of its class, a tuple of them if it is an array, or None.

        `value`: the same, or dicts in place of objects and a list in place of a tuple; None: no such section.
        """
        if value is None and self.optional:
            return () if self.is_array else None
        if not self.is_array:
            if isinstance(value, (list, tuple)) and value and isinstance(value[0], (dict, self.cls)):
                mistakes.add(self.name, f"write [{self.name}] with single brackets: a scene has only one")
                return self.cls()
            return self._object(value, mistakes, self.name)
        if not isinstance(value, (list, tuple)):
            reason = f"write [[{self.name}]] with two brackets: it is an array of tables; in Python, pass a list"
            mistakes.add(self.name, reason)
            return ()
        if len(value) > MAX_TABLES:
            mistakes.add(self.name, f"has {len(value)} tables, at most {MAX_TABLES} are allowed")
            return ()
        return tuple(self._object(one, mistakes, f"{self.name}[{k}]") for k, one in enumerate(value))

    def _object(self, value: Any, mistakes: Mistakes, where: str) -> Any:
        is_object = isinstance(value, self.cls)
        table = {name: getattr(value, name) for name in keys_of(self.cls)} if is_object else value
        values = check_table(self.cls, table, mistakes, where)
        return replace(value, **values) if is_object else self.cls(**values)


def check_table(cls: type, table: Any, mistakes: Mistakes, where: str = "", also: Iterable[str] = ()) -> dict[str, Any]:
    """Return the valid keys of a table. Messages name it `where`, and suggest the names in `also` as well."""
    if not isinstance(table, dict):
        key, text = next((key for key in ("name", "preset") if key in keys_of(cls)), ""), short_repr(table)
        example = f", as in {{{key} = {text}}}, in Python {{'{key}': {text}}}" if key and isinstance(table, str) else ""
        example += ", as in {}" * (table is True)
        wanted = f"must be a {cls.__name__} or a dict" if isinstance(table, Table) else f"must be a table{example}"
        mistakes.add(where, f"{wanted}, got {short_repr(table)}")
        return {}
    keys, hints = keys_of(cls), types_of(cls)
    values = {}
    for name, value in table.items():
        key = f"{where}.{name}" if where else f"{name}"
        if name in keys:
            with mistakes.collect():
                values[name] = check_value(value, hints[name], keys[name], mistakes.file, key)
        else:
            mistakes.add(key, *_unknown_key(where, f"{name}", [*keys, *also]))
    return values


def _unknown_key(where: str, name: str, known: list[str]) -> tuple[str, str]:
    """Return why a key of the table `where` is refused, and a hint: its new name or the nearest of the `known` ones."""
    section = where.partition("[")[0]
    if (same := OTHER_WORDS.get(name)) in known:
        return "unknown key", str(same)
    if new := new_key(f"{section}_{name}" if section else name):
        return f"was renamed to {new.removeprefix(f'{section}_')}", ""
    elsewhere, is_collider = _in_another_section(name), "[" in where  # for which a key of the cloth means nothing
    hint = elsewhere if elsewhere.endswith(f".{name}") else nearest_name(name, known) or elsewhere * (not is_collider)
    return "unknown key" + ("" if hint else f"; allowed: {', '.join(known)}"), hint


def _in_another_section(name: str) -> str:
    """Return the key of all sections nearest to `name`, as `look.color`; that of `cloth` if several have it, or ""."""
    sections: dict[str, list[str]] = {}
    for section, cls in _section_classes().items():
        for key in keys_of(cls):
            sections.setdefault(key, []).append(section)
    found = sections.get(nearest := nearest_name(name, sections), [])
    found = ["cloth"] if "cloth" in found else found
    return f"{found[0]}.{nearest}" if len(found) == 1 and "[" not in found[0] else ""


def _section_classes() -> dict[str, type]:
    """Return the class of every section by name: those that are fields of a table, the scene; `[[name]]` of arrays."""
    return {
        f"[[{name}]]" if get_origin(hint) is tuple else name: part
        for cls in _classes_below(Table)
        for name, hint in types_of(cls).items()
        for part in (hint, *get_args(hint))
        if isinstance(part, type) and issubclass(part, Table)
    }


def _classes_below(cls: type) -> Iterator[type]:
    """Yield the subclasses of a class that have no subclasses."""
    below: list[type] = cls.__subclasses__()
    for one in below:
        yield from _classes_below(one)
    if not below:
        yield cls
