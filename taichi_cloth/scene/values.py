"""One value against what its key declares: type, range, choices."""

from __future__ import annotations

import re
from math import isfinite
from typing import Any

from .errors import SceneError, nearest, shown
from .model import CORNERS, EDGES, GROUP, REGION, Key, Keyframes, Pins, Vec3

PIN_NAMES = (*EDGES, *CORNERS)

_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text in quotes"}
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")  # line ends among them, and half characters


def check_value(value: Any, hint: Any, key: Key, file: str, where: str) -> Any:
    """`value` as the type `hint`, within what `key` allows. Raises SceneError."""
    if hint == Vec3:
        if not isinstance(value, (list, tuple)) or len(value) != 3:
            raise SceneError(file, where, f"three numbers are needed, as in [0.0, 1.0, 0.0], not {shown(value)}")
        return tuple(check_value(v, float, key, file, f"{where}[{k}]") for k, v in enumerate(value))
    if hint == Keyframes:
        return _path(value, key, file, where)
    if hint == Pins:
        if not isinstance(value, (list, tuple)):
            raise SceneError(file, where, f'a list is needed, as in ["top", 17], not {shown(value)}')
        return tuple(_pin(v, file, f"{where}[{k}]") for k, v in enumerate(value))
    accepted: Any = (int, float) if hint is float else hint
    if not isinstance(value, accepted) or (isinstance(value, bool) and hint is not bool):
        raise SceneError(file, where, f"{_WORDS[hint]} is needed, not {shown(value)}")
    if hint is str:
        _check_text(str(value), key, file, where)
    elif hint is not bool:
        _check_number(value, key, file, where)
    return hint(value)


def range_text(key: Key) -> str:
    """What the key may hold, in words: the range with its unit, or the choices."""
    if key.low is None or key.high is None:
        return "#rrggbb" if key.colour else ", ".join(choice or '""' for choice in key.choices)
    return f"{'above ' * key.above_low}{key.low:.10g} to {key.high:.10g} {key.unit}".rstrip()


def _check_number(value: float, key: Key, file: str, where: str) -> None:
    if isinstance(value, float) and not isfinite(value):
        raise SceneError(file, where, f"a finite number is needed, not {value}")
    too_low = key.low is not None and (value <= key.low if key.above_low else value < key.low)
    if too_low or (key.high is not None and value > key.high):
        raise SceneError(file, where, f"{shown(value)} is out of range: {range_text(key)}")


def _check_text(value: str, key: Key, file: str, where: str) -> None:
    if key.choices and value not in key.choices:
        raise SceneError(file, where, f"{shown(value)} is not one of: {range_text(key)}", nearest(value, key.choices))
    if key.colour and not re.fullmatch("#[0-9a-fA-F]{6}", value):
        raise SceneError(file, where, f"a colour is written #rrggbb, as in #b5303c, not {shown(value)}")
    if _CONTROL.search(value):
        raise SceneError(file, where, f"one line of plain text is needed, not {shown(value)}")


def _path(value: Any, key: Key, file: str, where: str) -> Keyframes:
    """Rows of times that grow, each with where a body is then."""
    if not isinstance(value, (list, tuple)):
        raise SceneError(file, where, f"rows are needed, as in [[0, 0, 0, 0], [2, 0, 1, 0]], not {shown(value)}")
    rows = []
    for k, row in enumerate(value):
        place = f"{where}[{k}]"
        if not isinstance(row, (list, tuple)) or len(row) not in (4, 7):
            raise SceneError(file, place, f"seconds, x, y, z and perhaps three angles are needed, not {shown(row)}")
        rows.append(tuple(check_value(v, float, key, file, f"{place}[{n}]") for n, v in enumerate(row)))
        if k and rows[k][0] <= rows[k - 1][0]:
            raise SceneError(file, place, f"its time, {row[0]:g} s, is not after the one before, {value[k - 1][0]:g} s")
    return tuple(rows)


def _pin(value: Any, file: str, where: str) -> str | int:
    """Whether the cloth has such an edge, particle, group or region, the scene knows."""
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    if isinstance(value, str) and (value in PIN_NAMES or value.startswith((GROUP, REGION))):
        if _CONTROL.search(value):
            raise SceneError(file, where, f"one line of plain text is needed, not {shown(value)}")
        return value
    reason = (
        f"{shown(value)} is no pin: an edge or corner ({', '.join(PIN_NAMES)}), the index of a particle, "
        f"{REGION}NAME or {GROUP}NAME"
    )
    raise SceneError(file, where, reason, nearest(value, PIN_NAMES) if isinstance(value, str) else "")
