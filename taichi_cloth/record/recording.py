"""A recording as a TOML file: a scene, what was done to it, and the hash of the positions that came of it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import taichi as ti

from ..errors import WrongUse
from ..files import whole_file
from ..machine import cpu_model, machine
from ..scene import Scene, live_keys, scene_to_toml
from ..scene.errors import shown
from ..scene.model import SOLVER_NAMES
from ..scene.reader import scene_from
from ..scene.toml import parse_toml
from ..scene.writer import toml_value
from ..simulation import Simulation
from .recorded import Recorded, Row

FORMAT = 2
MOST_BYTES = 1 << 26  # an hour of pulling is 20 MB
MOST_FRAMES = 10_000_000
MOST = 1e9  # of any number in a row

# What may be done, with the kinds of its arguments; `list` is one or more places.
CALLS: dict[str, tuple[tuple[type, ...], ...]] = {
    "set": ((str,), (bool, int, float)),
    "change_solver": ((str,),),
    "change_fabric": ((str,),),
    "change": ((str,),),  # a scene as TOML
    "grab": ((int,), (float,), (float,), (float,), (float,), (int,)),  # particle, place [m], radius [m], hand
    "pin": ((int,), (bool,)),
    "release": ((int,),),  # hand
    "reset": (),
    "place": ((list,), (list,)),
    "load": ((str,),),  # a save as base64
    "restore": (),  # the last good frame of a cloth that blew up
    "view": ((str,),),
    "camera": ((float,),) * 6,  # azimuth, elevation [radians], distance [m], target [m]
}

TITLE = "# What was done to a cloth. To repeat it: taichi-cloth replay FILE"


@dataclass(frozen=True)
class Recording:
    """All that decides a run from its first frame to its last, and what came of it."""

    scene: Scene
    path: str | None  # the layout that was asked for
    size: tuple[int, int]  # [pixels] of the pictures it was seen in
    frames: int
    first_frame: int  # the run's own number of the frame it begins with; a run goes on before it and after
    rows: tuple[Row, ...]
    positions: str  # `hash_of` the positions at the end
    made_with: dict[str, str]
    settings: dict[str, float | bool | str] = field(default_factory=dict)  # at the end; told, not used

    @classmethod
    def of(cls, simulation: Recorded, size: tuple[int, int]) -> Recording:
        """What was done to a simulation up to now."""
        take = simulation.take
        settings: dict[str, float | bool | str] = {"method": simulation.method, "wind": simulation.get("wind")}
        settings |= {name: simulation.get(name) for name in live_keys(simulation.scene)}
        return cls(
            scene=simulation.first_scene,
            path=simulation.asked_path,
            size=size,
            frames=take.frames,
            first_frame=take.first_frame,
            rows=tuple(take.rows),
            positions=hash_of(simulation),
            made_with=made_with(),
            settings=settings,
        )

    def write(self, path: Path) -> None:
        """Writes `path` whole or not at all. Raises OSError."""
        with whole_file(path) as file:
            file.write(self._toml().encode())

    @property
    def folder(self) -> str:
        """Where the scene's file lay, if it has meshes or maps of its own."""
        users = (*self.scene.meshes, self.scene.cloth, self.scene.maps)
        return next((str(Path(user.folder).absolute()) for user in users if user and user.folder), "")

    def changed(self, text: str) -> Scene:
        """A scene that this one was changed to, from its TOML. Raises ValueError, SceneError among them."""
        path = Path(self.folder) / "scene.toml"
        return replace(scene_from(parse_toml(text), "scene", path), name=self.scene.name)

    def _toml(self) -> str:
        head: dict[str, Any] = {
            "format": FORMAT,
            "name": self.scene.name,
            "folder": self.folder,
            "path": self.path or "",
            "size": self.size,
            "frames": self.frames,
            "first_frame": self.first_frame,
            "positions": self.positions,
        }
        tables: dict[str, dict[str, Any]] = {"recording": head, "made_with": self.made_with, "settings": self.settings}
        lines = [TITLE]
        for name, table in tables.items():
            lines += ["", f"[{name}]", *(f"{key} = {toml_value(value)}" for key, value in table.items())]
        rows = (f"  {toml_value((frame, call, *arguments))}," for frame, call, arguments in self.rows)
        return "\n".join([*lines, "", "[done]  # after so many frames, what", "rows = [", *rows, "]", "", ""]) + (
            scene_to_toml(self.scene, "scene")
        )


def read_recording(path: Path) -> Recording:
    """Reads what `Recording.write` wrote. Raises WrongUse and SceneError, one line, for what it cannot be."""
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            raise ValueError(f"larger than {MOST_BYTES} bytes")
        data = parse_toml(content.decode())
    except OSError as error:
        raise WrongUse(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise WrongUse(f"{path}: not a recording: {error}") from None
    try:
        return _recording(data, str(path))
    except _Wrong as wrong:
        raise WrongUse(f"{path}: {wrong}") from None


class _Wrong(Exception):
    """What is wrong with a recording."""


def _recording(data: dict[str, Any], file: str) -> Recording:
    if not isinstance(data.get("recording"), dict):
        raise _Wrong("not a recording: it has no [recording]; `taichi-cloth run FILE` opens a scene")
    head = data["recording"]
    number = _value(head, "format", int)
    if number != FORMAT:
        raise _Wrong(f"recording.format is {number}, and this program reads {FORMAT}")
    frames, size, name = (_value(head, key, kind) for key, kind in (("frames", int), ("size", list), ("name", str)))
    if not 0 <= frames <= MOST_FRAMES:
        raise _Wrong(f"recording.frames must be from 0 to {MOST_FRAMES}, not {shown(frames)}")
    if len(size) != 2 or not all(type(n) is int and 1 <= n <= 8192 for n in size):
        raise _Wrong(f"recording.size must be two numbers from 1 to 8192, not {shown(size)}")
    made = _value(data, "made_with", dict)
    scene = scene_from(_value(data, "scene", dict), f"{file}: scene", Path(_value(head, "folder", str)) / "scene.toml")
    return Recording(
        scene=replace(scene, name=name),
        path=_value(head, "path", str) or None,
        size=(size[0], size[1]),
        frames=frames,
        first_frame=_value(head, "first_frame", int),
        rows=_rows(_value(_value(data, "done", dict), "rows", list), frames),
        positions=_value(head, "positions", str),
        made_with={key: _value(made, key, str) for key in made},
    )


def _value(table: dict[str, Any], key: str, kind: type) -> Any:
    if type(table.get(key)) is not kind:
        raise _Wrong(f"{key} must be {kind.__name__}, not {shown(table[key]) if key in table else 'missing'}")
    return table[key]


def _rows(rows: list[Any], frames: int) -> tuple[Row, ...]:
    found: list[Row] = []
    before = 0
    for k, row in enumerate(rows):
        if not isinstance(row, list) or len(row) < 2 or type(row[0]) is not int or row[1] not in [*CALLS]:
            raise _Wrong(f"rows[{k}] is not a frame, one of {', '.join(CALLS)}, and what it needs: {shown(row)}")
        frame, call, *arguments = row
        if not before <= frame <= frames:
            raise _Wrong(f"rows[{k}] comes after {frame} frames: {before} to {frames} are left")
        before = frame
        kinds = CALLS[call]
        fits = len(arguments) == len(kinds) and all(type(a) in kind for a, kind in zip(arguments, kinds, strict=True))
        if not fits or not all(abs(a) <= MOST for a in arguments if type(a) in (int, float)):
            raise _Wrong(f"rows[{k}]: not what {call} needs: {shown(arguments)}")
        if call == "change_solver" and arguments[0] not in SOLVER_NAMES:
            raise _Wrong(f"rows[{k}]: {shown(arguments[0])} is not a solver: {', '.join(SOLVER_NAMES)}")
        found.append((frame, call, tuple(arguments)))
    return tuple(found)


def hash_of(simulation: Simulation) -> str:
    """SHA-256 of the positions, as little-endian float64."""
    return hashlib.sha256(simulation.positions().astype("<f8").tobytes()).hexdigest()


def made_with() -> dict[str, str]:
    """All that the last bits of a position may hang on."""
    arch = ti.cfg.arch.name
    return {"arch": "cpu" if arch in ("x64", "arm64") else arch, **machine(), "cpu": cpu_model()}


def differences(recording: Recording) -> list[str]:
    """What has changed since it was made, a line each: the same bits are not to be expected then."""
    then, now = recording.made_with, made_with()
    keys = [key for key in now if key != "python" and then.get(key) != now[key]]
    return [f"recorded with {key} {then.get(key, 'unknown')}, repeated with {now[key]}" for key in keys]
