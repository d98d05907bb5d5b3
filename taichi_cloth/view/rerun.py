"""A recording, repeated: in the window, where the user looks on until it ends, or without one."""

from __future__ import annotations

import tempfile
import time
from base64 import b64decode
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import taichi as ti

from ..errors import WrongUse
from ..record.recording import Recording, hash_of
from .draw_list import VIEWS
from .session import Session

# What leaves the cloth alone, and may be done while it is repeated.
LOOKING = {"freeze", "step", "view", "first_view", "screenshot", "quit"}

# What may open the simulation anew.
OPENING = {"change_solver", "change_fabric", "change", "pin", "load", "reset"}


class Rerun(Session):
    """A session whose hand is the recording's; from its last frame on it is the user's.

    It shows the start at first. Raises WrongUse, here and from every frame, for what this scene cannot do.
    """

    def __init__(self, recording: Recording, out: Path = Path("out")) -> None:
        self.recording = recording
        self.repeated = 0  # frames
        self.is_equal: bool | None = None  # whether the positions at the end are those recorded; None before
        self._next = 0  # row
        super().__init__(recording.scene, recording.path, out)
        self.hidden = True
        try:
            self._do_what_is_due()
        except BaseException:
            self.close()
            raise

    @property
    def over(self) -> bool:
        return self.is_equal is not None

    # -- what the user may do --------------------------------------------------------------------------

    def obeys(self, action: str) -> bool:
        return self.over or action in LOOKING

    def point(self, cursor: tuple[float, float], held: frozenset[str], size: tuple[int, int], **more: bool) -> None:
        super().point(cursor, held if self.over else held - {"left"}, size, **more)

    # -- what was done ---------------------------------------------------------------------------------

    def _simulate(self, frames: int) -> None:
        start = time.perf_counter()
        for k in range(frames):
            if self.over:
                super()._simulate(frames - k)
                return
            self.forward()
            self.frozen |= self.over
            if self.frozen:
                break
        if frames:
            ti.sync()
            self.physics_ms = 1e3 * (time.perf_counter() - start) / frames

    def forward(self) -> None:
        """One frame, and what was done after it."""
        self.simulation.advance_frame()
        self._guard.sound()  # keeps what a blow-up goes back to
        self.repeated += 1
        self._do_what_is_due()

    def _do_what_is_due(self) -> None:
        rows = self.recording.rows
        while self._next < len(rows) and rows[self._next][0] == self.repeated:
            _, call, arguments = rows[self._next]
            try:
                self._do(call, *arguments)
            except ValueError as error:
                raise WrongUse(f"rows[{self._next}]: {call}: {error}") from None
            self._next += 1
        if self.repeated == self.recording.frames:
            self.is_equal = hash_of(self.simulation) == self.recording.positions
            self.note, self.hidden = self.verdict, False

    def _do(self, call: str, *arguments: Any) -> None:
        simulation = self.simulation
        match call:
            case "grab":
                index, *target, radius, hand = arguments
                simulation.grab(index, target, radius, hand)
            case "change_solver" | "change_fabric":
                with suppress(WrongUse):  # it could not be had then, either
                    getattr(simulation, call)(*arguments)
            case "change":
                simulation.change(self.recording.changed(*arguments))
            case "load":
                self._load(*arguments)
            case "restore":
                self._restore()
            case "view":
                self._look_in(*arguments)
            case "camera":
                self._look_from(*arguments)
            case _:
                getattr(simulation, call)(*arguments)
        if call in OPENING:
            self._renew()

    def _load(self, state: str) -> None:
        content = b64decode(state, validate=True)
        with tempfile.TemporaryDirectory(prefix="taichi_cloth_") as folder:
            path = Path(folder) / "state.npz"
            path.write_bytes(content)
            try:
                self.simulation.load(path)
            except ValueError as error:
                raise ValueError(str(error).removeprefix(f"{path}: ")) from None

    def _look_in(self, view: str) -> None:
        if view not in VIEWS:
            raise ValueError(f"{view!r} is no view: {', '.join(VIEWS)}")
        self.view = view

    def _look_from(self, azimuth: float, elevation: float, distance: float, *target: float) -> None:
        if distance <= 0:
            raise ValueError(f"a distance is above 0 m, not {distance}")
        camera = self.camera
        camera.azimuth, camera.elevation, camera.distance = azimuth, elevation, distance
        camera.target = np.array(target)

    @property
    def verdict(self) -> str:
        """One line: whether it came out as recorded."""
        total = self.recording.frames
        if self.is_equal is None:
            return f"ended after {self.repeated} of {total} frames: nothing to compare"
        return f"{total} frames repeated: " + (
            "the same to the last bit" if self.is_equal else "NOT the same, the positions at the end differ"
        )
