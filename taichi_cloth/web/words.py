"""What a page may say: one JSON object, checked before anything is done about it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from math import isfinite
from typing import Any, NoReturn

from ..interact.camera import NEAR, OrbitCamera
from ..interact.keys import KEYS
from ..scene.errors import shown

MOST_BYTES = 2048  # of a message
FARTHEST = 1e6  # [m], of a camera
MOST_PIXELS = 16384
LONGEST = 64  # letters of a name

# What keys do that only this page sees, and what would write files or end the server.
OWN = ("view", "curves", "hide", "first_view", "pin", *(key.action for key in KEYS if key.held))
BARRED = ("export", "screenshot", "clip", "page", "quit")
ACTIONS = ("time_stages", *(key.action for key in KEYS if key.action not in (*OWN, *BARRED)))
CHOICES = ("scene", "solver", "fabric")
COSTS = {"do": 15, "switch": 15, "choose": 15, "press": 15, "pin": 15}  # what is worked for, in messages that are not


class Malformed(ValueError):
    """A message that no page of ours sends."""


@dataclass(frozen=True)
class Look:
    """Where a cursor is, and how the page looks at the scene."""

    cursor: tuple[float, float]  # a screen point
    size: tuple[int, int]  # [pixels] of the picture
    azimuth: float  # [radians]
    elevation: float  # [radians]
    distance: float  # [m]
    target: tuple[float, float, float]  # [m]
    shift: float = 0.0  # [heights of the picture] the target is shown this far to the right of the middle

    def through(self, camera: OrbitCamera) -> OrbitCamera:
        """The camera, put where the page's is."""
        camera.azimuth, camera.elevation, camera.distance = self.azimuth, self.elevation, self.distance
        camera.target[:] = self.target
        camera.shift = self.shift
        return camera


@dataclass(frozen=True)
class Said:
    """One thing that a page asks for: `what` with what it needs, `of` the scene by its number."""

    what: str
    value: Any
    of: int


def heard(message: str | bytes) -> Said:
    """What a message says. Raises Malformed, in a line, for anything else."""
    if isinstance(message, bytes):
        raise Malformed("a text is needed, not bytes")
    try:
        said = json.loads(message, parse_constant=_refuse)
    except (ValueError, RecursionError):
        raise Malformed("not JSON") from None
    if type(said) is not dict or len(said) != 2 or type(said.get("of")) is not int:
        raise Malformed(f"one thing and the scene it is for are needed, not {shown(said)}")
    (what,) = said.keys() - {"of"}
    if what not in READERS:
        raise Malformed(f"{shown(what)} is none of {', '.join(READERS)}")
    return Said(what, READERS[what](said[what]), said["of"])


def _refuse(constant: str) -> NoReturn:
    raise ValueError(constant)


def _action(value: object) -> str:
    if type(value) is not str or value not in ACTIONS:
        raise Malformed(f"{shown(value)} is none of {', '.join(ACTIONS)}")
    return value


def _setting(value: object) -> tuple[str, float]:
    if type(value) is not list or len(value) != 2:
        raise Malformed(f"a name and a number are needed, not {shown(value)}")
    return _name(value[0]), _number(value[1])


def _switches(value: object) -> dict[str, bool]:
    if type(value) is not dict or not all(type(on) is bool for on in value.values()):
        raise Malformed(f"stages and whether they are on are needed, not {shown(value)}")
    return {_name(name): on for name, on in value.items()}


def _choice(value: object) -> tuple[str, str]:
    if type(value) is not list or len(value) != 2 or value[0] not in CHOICES:
        raise Malformed(f"one of {', '.join(CHOICES)} and a name are needed, not {shown(value)}")
    return value[0], _name(value[1])


def _look(value: object) -> Look:
    if type(value) is not list or len(value) != 11:
        raise Malformed(f"eleven numbers are needed, not {shown(value)}")
    u, v, width, height, azimuth, elevation, distance, shift, *target = (_number(number) for number in value)
    return Look(
        (_within(u, -1, 2), _within(v, -1, 2)),
        (round(_within(width, 1, MOST_PIXELS)), round(_within(height, 1, MOST_PIXELS))),
        _within(azimuth, -1e3, 1e3),
        _within(elevation, -1.6, 1.6),
        _within(distance, NEAR, FARTHEST),
        (*(_within(number, -FARTHEST, FARTHEST) for number in target),),  # type: ignore[arg-type]
        _within(shift, -10, 10),
    )


def _nothing(value: object) -> None:
    if value is not None:
        raise Malformed(f"nothing is needed, not {shown(value)}")


def _count(value: object) -> int:
    if type(value) is not int or not 0 <= value < 1 << 53:
        raise Malformed(f"a whole number is needed, not {shown(value)}")
    return value


def _name(value: object) -> str:
    if type(value) is not str or len(value) > LONGEST:
        raise Malformed(f"a name is needed, not {shown(value)}")
    return value


def _number(value: object) -> float:
    if type(value) not in (int, float) or not abs(value) <= 1e300 or not isfinite(value):  # type: ignore[arg-type]
        raise Malformed(f"a number is needed, not {shown(value)}")
    return float(value)  # type: ignore[arg-type]


def _within(number: float, low: float, high: float) -> float:
    return min(max(number, low), high)


READERS = {
    "do": _action,
    "set": _setting,
    "switch": _switches,
    "choose": _choice,
    "press": _look,
    "move": _look,
    "lift": _nothing,
    "pin": _look,
    "seen": _count,
}
