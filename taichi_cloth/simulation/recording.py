"""Recordings: a scene, the events of a run, and the hash of the final positions, as a TOML file."""

from __future__ import annotations

import hashlib
from base64 import b64encode
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any

import taichi as ti

from ..scene import Scene, scene_to_toml
from ..scene.keys import toml_value
from ..scene.reader import folder_of, scene_from, with_folders
from ..scene.solver_catalog import SOLVER_CATALOG
from ..system.errors import UsageError, short_repr
from ..system.files import atomic_file, parse_toml
from ..system.taichi_runtime import cpu_model, machine
from .checkpoint import checkpoint_bytes
from .events import EVENTS, Event, prepare_checkpoint, scene_event
from .parameter_values import MAX_SIDE, check_image_size
from .rollback import DivergenceGuard
from .running_cloth import check_simulation
from .simulation import Simulation

FORMAT = 3
MAX_BYTES = 1 << 26  # an hour of dragging is 20 MB
MAX_FRAMES = 10_000_000
MAX_NUMBER = 1e9  # of any argument
# What else is written beside a recording, by suffix.
KINDS = {".mp4": "a video", ".webp": "a video", ".png": "an image"}
LONG = 100_000  # events and frames: half an hour, or some minutes of dragging

# Argument types of the events of the viewer, which do not change the simulation.
VIEW_EVENTS: dict[str, tuple[tuple[type, ...], ...]] = {
    "view": ((str,),),
    "camera": ((float,),) * 6,  # azimuth, elevation [rad], distance [m], target [m]
}

# Events that may rebuild the cloth.
REBUILDING = {"switch_solver", "switch_fabric", "switch_scene", "pin", "pin_within", "load", "reset", "untear"}

TITLE = "# A recording of a cloth. To replay it: taichi-cloth replay FILE"

Row = tuple[int, Event]  # after how many frames


class Recorder:
    """Records the events of a simulation, from its present state on; `restart` begins anew.

    A drag or a slider is four numbers a frame; a frame without events costs nothing.
    """

    def __init__(self, simulation: Simulation) -> None:
        check_simulation(simulation)
        self.simulation = simulation
        # Replay opens this one, as here: solvers and fabrics that are switched to later return to its settings.
        self.scene = simulation.original_scene
        self._begin()
        if simulation.has_changed or simulation.frames_stepped:
            self.restart()
        simulation.listeners.append(self._add)

    def _begin(self) -> None:
        self.rows: list[Row] = []
        self.first_frame = self.simulation.frame
        self._stepped_before = self.simulation.frames_stepped
        self._view_events: dict[str, Event] = {}

    def restart(self) -> None:
        """Forget all events: the recording begins with the present state. Raises UsageError within a frame."""
        self.simulation.check_between_frames()
        self._begin()
        if self.simulation.scene != self.scene:
            self._add(scene_event(self.simulation.scene))
        prepare_checkpoint(self.simulation)
        self._add(Event("load", (b64encode(checkpoint_bytes(self.simulation)).decode(),)))

    @property
    def frames(self) -> int:
        """Frames recorded."""
        return self.simulation.frames_stepped - self._stepped_before

    @property
    def is_long(self) -> bool:
        """Whether replay takes so long that the recording should restart."""
        return self.frames + len(self.rows) > LONG

    def record_view(self, name: str, *arguments: object) -> None:
        """Record a view event, view mode or camera, if it has changed."""
        event = Event(name, arguments)
        if self._view_events.get(name) != event:
            self._view_events[name] = event
            self._add(event)

    def _add(self, event: Event) -> None:
        row = self.frames, event
        # Between two frames only the last target of a grab counts.
        if event.name == "move_grab" and self.rows and self.rows[-1][0] == row[0]:
            last = self.rows[-1][1]
            if last.name == event.name and last.arguments[0] == event.arguments[0]:
                self.rows.pop()
        self.rows.append(row)

    def save(self, path: str | PathLike[str], size: tuple[int, int] = (1280, 720)) -> None:
        """Write the recording. `size`: of replayed images, 1 to 8192 [pixels]. A missing folder is made.

        Raises ValueError for another size, UsageError within a frame and for a name that does not end in .toml, and
        OSError; a partial file never remains.
        """
        self.simulation.check_between_frames()
        path = Path(path)
        if path.suffix.lower() != ".toml":
            raise UsageError(f"{path}: recordings are saved as TOML files: the name must end in .toml")
        recording = Recording.of(self, check_image_size(size))
        path.parent.mkdir(parents=True, exist_ok=True)
        recording.write(path)


@dataclass(frozen=True)
class Recording:
    """A recorded run: all that determines it, and its result."""

    scene: Scene
    layout: str | None
    """The requested layout."""
    size: tuple[int, int]
    """Size of the images in which it was seen [pixels]."""
    frames: int
    first_frame: int
    """The simulation's own number of its first frame."""
    rows: tuple[Row, ...]
    positions_sha256: str
    """SHA-256 of the positions at the end (`hash_of`); `positions` in the file."""
    created_with: dict[str, str]
    settings: dict[str, float | bool | str] = field(default_factory=dict)
    """Parameters at the end, for information."""

    @classmethod
    def of(cls, recorder: Recorder, size: tuple[int, int]) -> Recording:
        """Return what was recorded up to now."""
        simulation = recorder.simulation
        params = simulation.params
        return cls(
            scene=recorder.scene,
            layout=simulation.requested_layout,
            size=size,
            frames=recorder.frames,
            first_frame=recorder.first_frame,
            rows=tuple(recorder.rows),
            positions_sha256=hash_of(simulation),
            created_with=created_with(),
            settings={"method": simulation.method, "wind": params["wind"], **params},
        )

    def write(self, path: Path) -> None:
        """Write `path`. Raises OSError; a partial file never remains."""
        with atomic_file(path) as file:
            file.write(self._toml().encode())

    @property
    def folder(self) -> str:
        """The folder of meshes and maps that are not shipped, or ""."""
        return folder_of(with_folders(self.scene))

    def _toml(self) -> str:
        head: dict[str, Any] = {
            "format": FORMAT,
            "name": self.scene.name,
            "folder": self.folder,
            "layout": self.layout or "",
            "size": self.size,
            "frames": self.frames,
            "first_frame": self.first_frame,
            "positions": self.positions_sha256,
        }
        tables: dict[str, dict[str, Any]] = {
            "recording": head,
            "created_with": self.created_with,
            "settings": self.settings,
        }
        lines = [TITLE]
        for name, table in tables.items():
            lines += ["", f"[{name}]", *(f"{key} = {toml_value(value)}" for key, value in table.items())]
        rows = (f"  {toml_value((frame, event.name, *event.arguments))}," for frame, event in self.rows)
        events = ["[events]  # after how many frames, which event, its arguments", "rows = [", *rows, "]"]
        return "\n".join([*lines, "", *events, "", ""]) + scene_to_toml(self.scene, "scene")


def read_recording(path: Path) -> Recording:
    """Read a recording. Raises UsageError and SceneError, one line, for a file that is not a recording."""
    kind = KINDS.get(path.suffix.lower())
    if kind:
        raise UsageError(f"{path} is {kind}: give the recording {path.with_suffix('.toml').name} beside it")
    if path.is_dir():
        raise UsageError(f"{path}: not a recording: it is a folder")
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise ValueError(f"larger than {MAX_BYTES} bytes")
        data = parse_toml(content.decode())
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: not a recording: not UTF-8 text (byte {error.start})") from None
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: not a recording: {error}") from None
    try:
        return _recording(data, str(path))
    except _Invalid as error:
        raise UsageError(f"{path}: {error}") from None


class _Invalid(Exception):
    """What is wrong with a recording."""


def _recording(data: dict[str, Any], file: str) -> Recording:
    if not isinstance(data.get("recording"), dict):
        raise _Invalid("not a recording: it has no [recording]; `taichi-cloth run FILE` opens a scene")
    head = data["recording"]
    number = _value(head, "format", int)
    if number != FORMAT:
        raise _Invalid(f"recording.format is {number}, and this program reads {FORMAT}")
    frames, size, name = (_value(head, key, kind) for key, kind in (("frames", int), ("size", list), ("name", str)))
    if not 0 <= frames <= MAX_FRAMES:
        raise _Invalid(f"recording.frames must be from 0 to {MAX_FRAMES}, not {short_repr(frames)}")
    if len(size) != 2 or not all(type(n) is int and 1 <= n <= MAX_SIDE for n in size):
        raise _Invalid(f"recording.size must be two numbers from 1 to {MAX_SIDE}, not {short_repr(size)}")
    created_with = _value(data, "created_with", dict)
    scene = scene_from(_value(data, "scene", dict), f"{file}: scene", Path(_value(head, "folder", str)) / "scene.toml")
    return Recording(
        scene=replace(scene, name=name),
        layout=_value(head, "layout", str) or None,
        size=(size[0], size[1]),
        frames=frames,
        first_frame=_value(head, "first_frame", int),
        rows=_rows(_value(_value(data, "events", dict), "rows", list), frames),
        positions_sha256=_value(head, "positions", str),
        created_with={key: _value(created_with, key, str) for key in created_with},
    )


def _value(table: dict[str, object], key: str, kind: type) -> Any:
    if type(table.get(key)) is not kind:
        raise _Invalid(f"{key} must be {kind.__name__}, not {short_repr(table[key]) if key in table else 'missing'}")
    return table[key]


def _rows(rows: list[object], frames: int) -> tuple[Row, ...]:
    known = {name: kind.argument_types for name, kind in EVENTS.items()} | VIEW_EVENTS
    events: list[Row] = []
    before = 0
    for k, row in enumerate(rows):
        if not isinstance(row, list) or len(row) < 2 or type(row[0]) is not int or row[1] not in [*known]:
            raise _Invalid(f"rows[{k}] is not a frame, one of {', '.join(known)}, and its arguments: {short_repr(row)}")
        frame, name, *arguments = row
        if not before <= frame <= frames:
            raise _Invalid(f"rows[{k}] comes after {frame} frames, which is not in {before}..{frames}")
        before = frame
        kinds = known[name]
        if name in EVENTS and len(kinds) - EVENTS[name].optional <= len(arguments):
            kinds = kinds[: len(arguments)]
        fits = len(arguments) == len(kinds) and all(type(a) in kind for a, kind in zip(arguments, kinds, strict=True))
        if not fits or not all(abs(a) <= MAX_NUMBER for a in arguments if type(a) in (int, float)):
            raise _Invalid(f"rows[{k}]: invalid arguments of {name}: {short_repr(arguments)}")
        if name == "switch_solver" and arguments[0] not in SOLVER_CATALOG:
            raise _Invalid(f"rows[{k}]: unknown solver {short_repr(arguments[0])}: {', '.join(SOLVER_CATALOG)}")
        events.append((frame, Event(name, tuple(arguments))))
    return tuple(events)


def apply_recorded(simulation: Simulation, event: Event) -> None:
    """Apply an event of a recording. A switch of solver or fabric may fail, as it did when it was recorded."""
    with suppress(UsageError) if event.name in ("switch_solver", "switch_fabric") else nullcontext():
        simulation.apply(event)


def run_recording(recording: Recording, simulation: Simulation) -> None:
    """Repeat a recording, without drawing it, with a new simulation of its scene.

    Raises UsageError with the row of an event that the scene does not support.
    """
    guard = DivergenceGuard(simulation)
    rows = [(k, *row) for k, row in enumerate(recording.rows) if row[1].name not in VIEW_EVENTS]
    for frame in range(recording.frames + 1):
        if frame > 0:
            Simulation.step(simulation)  # without the checks of a subclass: `guard` has those
            guard.check_and_snapshot()
        while rows and rows[0][1] == frame:
            k, _, event = rows.pop(0)
            if event.name == "roll_back":
                guard.roll_back()
            else:
                try:
                    apply_recorded(simulation, event)
                except ValueError as error:
                    raise UsageError(f"rows[{k}]: {event.name}: {error}") from None
            if event.name in REBUILDING:
                guard = DivergenceGuard(simulation)


def hash_of(simulation: Simulation) -> str:
    """Return the SHA-256 of the positions, as little-endian float64."""
    return hashlib.sha256(simulation.positions().astype("<f8").tobytes()).hexdigest()


def created_with() -> dict[str, str]:
    """Return all that the last bits of a position may depend on."""
    arch = ti.cfg.arch.name
    return {"arch": "cpu" if arch in ("x64", "arm64") else arch, **machine(), "cpu": cpu_model()}


def differences(recording: Recording) -> list[str]:
    """Return what has changed since it was recorded, one line each: equal bits are not to be expected then."""
    then, now = recording.created_with, created_with()
    keys = [key for key in now if key != "python" and then.get(key) != now[key]]
    return [f"recorded with {key} {then.get(key, 'unknown')}, replayed with {now[key]}" for key in keys]
