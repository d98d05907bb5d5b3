"""Two sessions under the same keys and the same mouse, seen by one camera. It runs without a display."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from ..scene import Scene, live_keys
from .draw_list import DrawList
from .session import Session
from .sides import apart, camera_for, partners

# What both do; T, Y, X and P act on the side under the cursor, so that the two may differ in more than they began with.
BOTH = ("freeze", "step", "reset", "wind", "view", "smaller_hand", "larger_hand", "own_values")
ONE = ("solver", "fabric", "stage", "pin")


class Pair:
    """The left and the right side. Screen points run from (0, 0) at the bottom left of both to (1, 1)."""

    def __init__(self, left: Scene, right: Scene, aspect: float, out: Path = Path("out")) -> None:
        """`aspect` is the width over the height of a half when the window opens."""
        with ExitStack() as opened:
            sessions = []
            for scene in (left, right):
                sessions.append(Session(scene, out=out))
                opened.callback(sessions[-1].close)
            opened.pop_all()
        self.left, self.right = sessions
        self.left.camera = self.right.camera = camera_for(left, aspect)
        self.hidden = False
        self.running = True
        self._held: frozenset[str] = frozenset()  # buttons
        self._active = self.left  # the side under the cursor, or where a drag began
        a, b = self.left.simulation, self.right.simulation
        self._partner = {id(self.left): partners(a, b), id(self.right): partners(b, a)}

    @property
    def sides(self) -> tuple[Session, Session]:
        return self.left, self.right

    @property
    def draw_lists(self) -> tuple[DrawList, DrawList]:
        return self.left.draw_list, self.right.draw_list

    @property
    def view(self) -> str:
        return self.left.view

    @property
    def note(self) -> str:
        return self.left.note or self.right.note

    @property
    def mouse(self) -> str:
        """Whose the mouse is, on the side where it is."""
        return self._active.pointer.owner.value

    @property
    def apart(self) -> float:
        """Root mean square distance of the particles of both, as a share of the longer side."""
        return apart(self.left.simulation, self.right.simulation, self._partner[id(self.left)])

    def close(self) -> None:
        """Gives back what both hold."""
        for side in self.sides:
            side.close()

    def act(self, action: str) -> None:
        """Does what a key or button stands for; keys that are for one scene do nothing."""
        if action in BOTH:
            for side in self.sides:
                side.act(action)
        elif action in ONE:
            self._active.act(action)
        elif action == "first_view":
            self.left.act(action)
        elif action == "hide":
            self.hidden = not self.hidden
        elif action == "quit":
            self.running = False

    def ask(self, action: str) -> None:
        """As `Session.ask` does; `do_asked` follows the picture."""
        if action in ONE:
            self._active.ask(action)
        else:
            self.act(action)

    def do_asked(self) -> None:
        """What waited for a picture to be shown."""
        for side in self.sides:
            side.do_asked()

    def hold(self, action: str, seconds: float) -> None:
        """Goes on with the action of a key that is held down, for so much wall time."""
        self.left.hold(action, seconds)

    def set(self, name: str, value: float) -> None:
        """Sets a live parameter of both, as far as they have it."""
        for side in self.sides:
            if name in live_keys(side.simulation.scene):
                side.simulation.set(name, value)

    def point(
        self,
        cursor: tuple[float, float],
        held: frozenset[str],
        size: tuple[int, int],
        *,
        on_panel: bool,
        widget_changed: bool,
    ) -> None:
        """Takes one displayed frame's mouse. What is held on one side is held by the same hand on the other."""
        if not (held or self._held):  # a release is for the side of the press
            self._active = self.left if cursor[0] < 0.5 else self.right
        self._held = held
        active, other = self.sides if self._active is self.left else self.sides[::-1]
        u = 2 * cursor[0] - (active is self.right)
        half = size[0] // 2, size[1]
        active.point((u, cursor[1]), held, half, on_panel=on_panel, widget_changed=widget_changed)
        other.follow(active, self._partner[id(active)])

    def advance(self, frames: int) -> None:
        """Moves both on by so many frames, unless they are frozen; where one blows up the other stops with it."""
        for side in self.sides:
            side.advance(frames)
        for side in self.sides:
            side.frozen = self.left.frozen or self.right.frozen

    def measure(self) -> None:
        """Measures both."""
        for side in self.sides:
            side.measure()
