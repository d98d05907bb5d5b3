"""The protocol between the page of the browser view and the server.

From the page: JSON objects with one command each. They are validated before they are applied.

To the page: the scene once, the panel each time it changes, updates of positions and poses, and metrics. A message is
the length of a JSON text [bytes] as a 4-byte integer, the text, padded with spaces to a multiple of four bytes, and
arrays, whose lengths are in the JSON. All numbers are little-endian.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..geometry import closed_surface
from ..render.camera import NEAR, OrbitCamera
from ..render.colors import marker_radius, merge_vertices, pattern_colors
from ..render.draw_list import GRABBED_COLOR, PINNED_COLOR, with_color
from ..render.shading import FULL_STRAIN, UNKNOWN, strain_colors
from ..render.webgl import Solids, air, quantize, remaining_triangles
from ..scene.parameters import Parameter
from ..scene.schema import SOLVER_NAMES
from ..system.errors import short_repr
from ..viewer.charts import CHART_SECONDS, CHARTS, alert, statistics
from ..viewer.input import HELD_KEY_RATES, LISTS, MOUSE, REWIND_RATES, SHORTCUTS
from ..viewer.panel import (
    GRAB_RADIUS,
    acting_parameters,
    help_for,
    own_fabric,
    timing_line,
    with_cost,
)
from ..viewer.session import Session
from ..viewer.toolkit import Progress, Refusal, without_keys

MAX_BYTES = 2048  # size limit of a message [bytes]
MAX_DISTANCE = 1e6  # [m] limit of a camera's distance and target coordinates
MAX_PIXELS = 16384  # limit of an image's width and height
MAX_NAME = 64  # length limit of a name [characters]

# Actions that a page performs itself; and those that write files, go back in time for all pages, or end the server.
PAGE_ACTIONS = ("view", "charts", "help", "hide", "first_view", "pin", *HELD_KEY_RATES)
FORBIDDEN_ACTIONS = ("export", "screenshot", "clip", "page", "quit", *REWIND_RATES)
ACTIONS = (
    "time_features",
    *(key.action for key in SHORTCUTS if key.action not in (*PAGE_ACTIONS, *FORBIDDEN_ACTIONS)),
)
CHOICES = ("scene", "solver", "fabric", "speed")
# Cost of expensive commands against the rate limit; all others cost 1.
COSTS = {"action": 15, "switch": 15, "choose": 15, "press": 15, "pin": 15}


class ProtocolError(ValueError):
    """A message that the server's own page never sends."""


@dataclass(frozen=True)
class PageView:
    """Cursor and camera of a page."""

    cursor: tuple[float, float]
    """Screen point, from (0, 0) at the bottom left to (1, 1)."""
    size: tuple[int, int]
    """Width and height of the image [pixels]."""
    azimuth: float  # [rad]
    elevation: float  # [rad]
    distance: float  # [m]
    target: tuple[float, float, float]  # [m]
    view_shift: float = 0.0
    """Distance of the target to the right of the image's center [heights of the image]."""

    def apply_to(self, camera: OrbitCamera) -> OrbitCamera:
        """Move `camera` to the page's camera and return it."""
        camera.azimuth, camera.elevation, camera.distance = self.azimuth, self.elevation, self.distance
        camera.target[:] = self.target
        camera.view_shift = self.view_shift
        return camera


@dataclass(frozen=True)
class Command:
    """A command from a page."""

    name: str
    """Name of the command, a key of `READERS`."""
    argument: Any
    """Its argument, as the command's reader returns it."""
    scene_id: int
    """Number of the scene that the page showed."""


def parse_message(message: str | bytes) -> Command:
    """Return the command in a message. Raises ProtocolError, with one line, if it is invalid."""
    if isinstance(message, bytes):
        raise ProtocolError("expected text, got bytes")
    try:
        data = json.loads(message, parse_constant=_reject)
    except (ValueError, RecursionError):
        raise ProtocolError("not JSON") from None
    if type(data) is not dict or len(data) != 2 or type(data.get("sceneId")) is not int:
        raise ProtocolError(f"expected one command and 'sceneId' with an integer, got {short_repr(data)}")
    (name,) = data.keys() - {"sceneId"}
    if name not in READERS:
        raise ProtocolError(f"unknown command {short_repr(name)}: {', '.join(READERS)}")
    return Command(name, READERS[name](data[name]), data["sceneId"])


def _reject(constant: str) -> NoReturn:
    """Raise ValueError for NaN and infinities, which are not JSON."""
    raise ValueError(constant)


# -- readers: each checks the argument of a command and returns it ---------------------------------------------------


def _action(value: object) -> str:
    if type(value) is not str or value not in ACTIONS:
        raise ProtocolError(f"unknown action {short_repr(value)}: {', '.join(ACTIONS)}")
    return value


def _setting(value: object) -> tuple[str, float]:
    if type(value) is not list or len(value) != 2:
        raise ProtocolError(f"expected a name and a number, got {short_repr(value)}")
    return _name(value[0]), _number(value[1])


def _switches(value: object) -> dict[str, bool]:
    if type(value) is not dict or not all(type(on) is bool for on in value.values()):
        raise ProtocolError(f"expected features with true or false, got {short_repr(value)}")
    return {_name(name): on for name, on in value.items()}


def _choice(value: object) -> tuple[str, str]:
    if type(value) is not list or len(value) != 2 or value[0] not in CHOICES:
        raise ProtocolError(f"expected one of {', '.join(CHOICES)} and a name, got {short_repr(value)}")
    return value[0], _name(value[1])


def _view(value: object) -> PageView:
    if type(value) is not list or len(value) != 11:
        raise ProtocolError(f"expected eleven numbers, got {short_repr(value)}")
    u, v, width, height, azimuth, elevation, distance, shift, *target = (_number(number) for number in value)
    return PageView(
        (_clamp(u, -1, 2), _clamp(v, -1, 2)),
        (round(_clamp(width, 1, MAX_PIXELS)), round(_clamp(height, 1, MAX_PIXELS))),
        _clamp(azimuth, -1e3, 1e3),
        _clamp(elevation, -1.6, 1.6),
        _clamp(distance, NEAR, MAX_DISTANCE),
        (*(_clamp(number, -MAX_DISTANCE, MAX_DISTANCE) for number in target),),  # type: ignore[arg-type]
        _clamp(shift, -10, 10),
    )


def _nothing(value: object) -> None:
    if value is not None:
        raise ProtocolError(f"expected null, got {short_repr(value)}")


def _count(value: object) -> int:
    if type(value) is not int or not 0 <= value < 1 << 53:
        raise ProtocolError(f"expected an integer of 0 or more, got {short_repr(value)}")
    return value


def _name(value: object) -> str:
    if type(value) is not str or len(value) > MAX_NAME:
        raise ProtocolError(f"expected a name of at most {MAX_NAME} characters, got {short_repr(value)}")
    return value


def _number(value: object) -> float:
    if type(value) not in (int, float) or not abs(value) <= 1e300 or not isfinite(value):  # type: ignore[arg-type]
        raise ProtocolError(f"expected a number, got {short_repr(value)}")
    return float(value)  # type: ignore[arg-type]


def _clamp(number: float, low: float, high: float) -> float:
    return min(max(number, low), high)


READERS = {
    "action": _action,
    "set": _setting,
    "switch": _switches,
    "choose": _choice,
    "press": _view,
    "move": _view,
    "release": _nothing,
    "pin": _view,
    "displayed": _count,
}


# The view in the statistics, which a page replaces with its own.
PAGE_VIEW = "{view}"
NOTE_KINDS = {Refusal: "refusal", Progress: "progress", str: "success"}
SLIDER_STEPS = 400  # of a slider over its range


def pack_message(head: dict[str, object], arrays: Sequence[NDArray[np.generic]] = ()) -> bytes:
    """Return a message with the JSON of `head`, then the bytes of `arrays`."""
    text = json.dumps(head, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    return b"".join([struct.pack("<I", len(text)), text, *(array.tobytes() for array in arrays)])


class MessageBuilder:
    """Builds the messages about one scene of a session, as long as scene and mesh stay the same."""

    def __init__(self, session: Session, scene_id: int) -> None:
        """`scene_id`: number of the scene, counted from the start of the server."""
        self.scene_id = scene_id
        self._session = session
        self._simulation = session.simulation
        self._scene = session.simulation.scene
        # As sent in the scene message, and as of the last update.
        self._untorn = self._current = session.simulation.topology
        self._parameters = acting_parameters(self._simulation)
        self._present = np.ones(self._untorn.triangle_count, bool)
        sphere = closed_surface.unit_sphere(8)
        self._solids = Solids(
            self._simulation, [with_color(sphere, sphere, color) for color in (GRABBED_COLOR, PINNED_COLOR)]
        )

    @property
    def is_valid(self) -> bool:
        """Whether the scene message is still valid: same scene, features, fabric and solver, and no tear was undone."""
        simulation = self._session.simulation
        return (
            simulation is self._simulation
            and simulation.scene is self._scene
            and simulation.topology.triangle_count <= self._present.sum()
        )

    def scene(self) -> bytes:
        """Return the message with everything that stays constant."""
        topology, scene = self._untorn, self._scene
        owner, colors, corners = merge_vertices(topology.triangles, pattern_colors(topology, scene.look))
        solid_heads, solid_vertices, solid_corners = self._solids.pack()
        springs = topology.family_counts.get("structural", 0) or topology.spring_count
        scale = np.zeros((4, 3), np.float32)
        strain_colors(np.array([-FULL_STRAIN, 0.0, FULL_STRAIN, UNKNOWN], np.float32), scale)
        head = {
            "kind": "scene",
            "sceneId": self.scene_id,
            "name": scene.name,
            "title": scene.title or scene.name,
            "particles": topology.particle_count,
            "vertices": len(owner),
            "triangles": len(corners),
            "springs": springs,
            "solids": solid_heads,
            "solidVertices": len(solid_vertices),
            "solidCorners": len(solid_corners),
            "deforming": self._solids.deforming,
            "markerRadius": marker_radius(topology),
            "fullStrain": FULL_STRAIN,
            "strainColors": np.rint(255 * scale).astype(int).tolist(),
            "keys": [
                [key.code, key.label, key.action, key.help] for key in SHORTCUTS if key.action not in FORBIDDEN_ACTIONS
            ],
            "mouse": MOUSE,
            "charts": [[(curve.column, curve.name, curve.unit) for curve in curves] for curves in CHARTS],
            "chartSeconds": CHART_SECONDS,
            "chartLimits": self._session.history.min_limits,
            **air(scene, topology.start),
        }
        arrays = [
            solid_vertices.astype("<f4"),
            topology.rest[:springs].astype("<f4"),
            solid_corners.astype("<u4"),
            owner.astype("<u4"),
            corners.astype("<u4"),
            topology.ends[:springs].astype("<u4"),
            colors,
        ]
        return pack_message(head, arrays)

    def update(self) -> bytes:
        """Return an update: positions, as 16-bit integers within the bounding box of the cloth, poses and tears."""
        simulation = self._simulation
        if simulation.topology is not self._current:  # it tore, or its pins changed
            self._current = simulation.topology
            self._present = remaining_triangles(self._untorn, self._current)
        x = simulation.positions()
        low, step, steps = quantize(x)
        dragged = [dragger.particle for dragger in self._session.draggers.values() if dragger.particle is not None]
        markers = x[[*dragged, *self._session.draw_list.pins]]
        poses, deformed = np.swapaxes(self._solids.poses(), 1, 2), self._solids.deformed()
        present = np.zeros(0, np.uint8) if self._present.all() else np.packbits(self._present, bitorder="little")
        head = {
            "kind": "update",
            "sceneId": self.scene_id,
            "frame": simulation.frame,
            "low": low.tolist(),
            "step": step.tolist(),
            "poses": len(poses),
            "deformed": len(deformed),
            "dragged": len(dragged),
            "markers": len(markers),
            "present": len(present),
        }
        arrays = [poses.astype("<f4"), markers.astype("<f4"), deformed.astype("<f4"), steps.astype("<u2"), present]
        return pack_message(head, arrays)

    def panel(self, scenes: list[str]) -> bytes:
        """Return the message with the choices, switches and sliders of the panel."""
        session, scene, times = self._session, self._scene, self._session.feature_times
        helps = {name: help_for(name, self._parameters) for name in (*self._parameters, GRAB_RADIUS)}
        sliders = [{**_slider(parameter), "help": helps[name]} for name, parameter in self._parameters.items()]
        radius = {"min": 0.0, "max": session.max_grab_radius, "value": session.default_grab_radius}
        radius |= {"step": session.max_grab_radius / SLIDER_STEPS}
        return pack_message(
            {
                "kind": "panel",
                "sceneId": self.scene_id,
                "scenes": scenes,
                "scene": scene.name,
                "solvers": SOLVER_NAMES,
                "solver": scene.solver.name,
                "fabrics": {name: name or own_fabric(session) for name in LISTS["fabric"]},
                "fabric": session.fabric,
                "speeds": LISTS["speed"],
                "speed": session.speed,
                "features": {name: [with_cost(name, times), on] for name, on in session.features.items()},
                "wind": with_cost("wind", times) if scene.wind else "",
                "timing": timing_line(times) if times else "",
                "sliders": [
                    *sliders,
                    {"name": GRAB_RADIUS, "label": "Grab radius", "unit": "m", "help": helps[GRAB_RADIUS], **radius},
                ],
            }
        )

    def frame_error(self) -> bytes:
        """Return the message with the last error of each particle, as shares of the largest one; none before."""
        draw_list = self._session.draw_list
        scale, errors = draw_list.scale("error"), draw_list.errors
        labels = [] if scale is None else [scale.labels[fraction] for fraction in (1.0, 0.5, 0.0)]
        shares = [] if scale is None or errors is None else [np.rint(255 * errors / scale.largest).astype(np.uint8)]
        frame = draw_list.error_frame
        return pack_message({"kind": "frameError", "sceneId": self.scene_id, "frame": frame, "labels": labels}, shares)

    def metrics(self, sending_ms: float, update_rate: float, clients: int) -> bytes:
        """Return the message with timings and the session's last metrics.

        `sending_ms`: time to send the last update [ms]. `update_rate`: updates sent per second. `clients`: number of
        open pages.
        """
        session, simulation, metrics = self._session, self._simulation, self._session.metrics
        strains = 100 * metrics.max_strain, 100 * metrics.mean_strain
        row = simulation.seconds, metrics.kinetic_energy, metrics.potential_energy, *strains
        return pack_message(
            {
                "kind": "metrics",
                "sceneId": self.scene_id,
                "frozen": session.frozen,
                "speed": session.speed,
                "errors": session.meter is not None,
                "note": without_keys(session.note),
                "noteKind": NOTE_KINDS[type(session.note)],
                "alert": without_keys(alert(session)),
                "statistics": without_keys(statistics(session, {"sending": sending_ms}, update_rate, PAGE_VIEW)),
                "parameters": {name: simulation.params[name] for name in self._parameters}
                | {GRAB_RADIUS: session.grab_radius},
                "wind": simulation.params["wind"],
                "row": row if metrics.finite else None,
                "clients": clients,
            }
        )


def _slider(parameter: Parameter) -> dict[str, object]:
    step = 1 if parameter.is_int else (parameter.slider_max - parameter.slider_min) / SLIDER_STEPS
    text = {"name": parameter.name, "label": parameter.label, "unit": parameter.unit}
    return text | {"min": parameter.slider_min, "max": parameter.slider_max, "step": step, "value": parameter.value}
