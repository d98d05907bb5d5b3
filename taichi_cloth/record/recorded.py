"""A simulation that remembers what was done to it."""

from __future__ import annotations

from base64 import b64encode
from os import PathLike
from typing import Any

from numpy.typing import ArrayLike

from ..given import numbers
from ..save_file import packed
from ..scene import Scene, scene_to_toml
from ..simulation import Simulation

LONG = 100_000  # calls: half an hour of frames, or some minutes of pulling

Row = tuple[int, str, tuple[Any, ...]]  # after how many frames, what, with which arguments


def who(row: Row) -> tuple[int, int]:
    """Particle and hand of a row that grabs."""
    return row[2][0], row[2][-1]


class Take:
    """All that was done since a moment, in order: every call that decides how the cloth moves, and who looked at it.

    A hand and a slider are three numbers and one a frame; a frame in which nothing is done costs nothing.
    """

    def __init__(self, first_frame: int) -> None:
        """`first_frame`: the simulation's own number of the frame it begins with."""
        self.first_frame = first_frame
        self.frames = 0  # since then
        self.rows: list[Row] = []
        self._looks: dict[str, tuple[Any, ...]] = {}

    @property
    def is_long(self) -> bool:
        """Whether it takes so long to repeat that a recording had better begin anew."""
        return self.frames + len(self.rows) > LONG

    def add(self, call: str, *arguments: Any) -> None:
        row = (self.frames, call, arguments)
        # Between two frames only the last place of a hand counts: a picture that waits adds nothing.
        if call == "grab" and self.rows and self.rows[-1][:2] == row[:2] and who(self.rows[-1]) == who(row):
            self.rows[-1] = row
        else:
            self.rows.append(row)

    def look(self, call: str, *arguments: Any) -> None:
        """How it is looked at from now on; nothing is added where that is known."""
        if self._looks.get(call) != arguments:
            self._looks[call] = arguments
            self.add(call, *arguments)


class Recorded(Simulation):
    """A simulation whose `take` says how it came to be as it is, from the first frame on or from `begin_anew`.

    A call is added once it is done: what one call does by another comes out twice then, and does nothing the second
    time. One that raises has changed nothing and adds nothing, but for a method that could not be had.
    """

    def __init__(self, scene: Scene, path: str | None = None) -> None:
        self.take = Take(0)
        self.asked_path = path
        self._radii: dict[int, float] = {}  # [m] of the patch that each hand took
        super().__init__(scene, path)
        self.first_scene = self.scene

    def begin_anew(self) -> None:
        """Forgets what was done up to now: the take goes on from the present state."""
        state = self._state()
        self.take = Take(self.frame)
        if self.scene != self.first_scene:
            self.take.add("change", scene_to_toml(self.scene))
        self.take.add("load", state)

    def _end_frame(self) -> None:
        super()._end_frame()
        self.take.frames += 1

    def reset(self) -> None:
        super().reset()
        self.take.add("reset")

    def place(self, positions: ArrayLike, velocities: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        super().place(positions, velocities)
        self.take.add("place", numbers(positions).tolist(), numbers(velocities).tolist())

    def set(self, name: str, value: float | bool) -> None:
        super().set(name, value)
        self.take.add("set", name, self.get(name))

    def change_solver(self, name: str) -> None:
        try:
            super().change_solver(name)
        finally:  # the cloth has been taken out of its fields and put back, which may change a last bit
            self.take.add("change_solver", name)

    def change(self, scene: Scene) -> None:
        super().change(scene)
        self.take.add("change", scene_to_toml(self.scene))

    def change_fabric(self, name: str) -> None:
        try:
            super().change_fabric(name)
        finally:  # as another method does
            self.take.add("change_fabric", name)

    def grab(self, index: int, target: ArrayLike, radius: float = 0.0, hand: int = 0) -> None:
        moved = self.grabbed_by(hand) == index
        super().grab(index, target, radius, hand)
        if not moved:
            self._radii[hand] = float(radius)
        self.take.add("grab", int(index), *numbers(target).tolist(), self._radii.get(hand, 0.0), int(hand))

    def pin(self, index: int, on: bool = True) -> None:
        super().pin(index, on)
        self.take.add("pin", int(index), bool(on))

    def release(self, hand: int = 0) -> None:
        held = self.grabbed_by(hand) is not None
        super().release(hand)
        if held:
            self.take.add("release", int(hand))

    def load(self, path: str | PathLike[str]) -> None:
        super().load(path)
        self.take.add("load", self._state())

    def _state(self) -> str:
        """What `save` writes, as text."""
        return b64encode(packed(scene_to_toml(self.scene), self._moving())).decode()
