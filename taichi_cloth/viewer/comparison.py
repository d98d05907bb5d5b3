"""Two sessions side by side, with shared keys, mouse and camera."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from ..render.draw_list import VIEWS, DrawList
from ..render.image_files import Pixels, write_png
from ..render.split_view import camera_for_both, nearest_vertex_map, rms_distance
from ..scene import Scene, parameters_of
from ..system.errors import error_text
from ..system.files import next_free_path
from .input import HELD_KEY_RATES, SHORTCUTS
from .session import Session
from .toolkit import Refusal

# Actions on both sides, and actions on the side under the cursor only, so that the sides may differ in more settings.
SHARED_ACTIONS = (
    *("freeze", "step", "reset", "wind", "view", "smaller_radius", "larger_radius", "restore_defaults", "errors"),
)
SIDE_ACTIONS = ("solver", "fabric", "feature", "pin")
WINDOW_ACTIONS = ("first_view", "screenshot", "page", "hide", "quit")


class Comparison:
    """The left and the right session. Screen points run from (0, 0) at the bottom left of both images to (1, 1)."""

    def __init__(
        self,
        left: Scene,
        right: Scene,
        aspect: float,
        out: Path = Path("out"),
        *,
        view: str = VIEWS[0],
        errors: bool = False,
    ) -> None:
        """`aspect`: width over height of one half when the window opens. `view`: of both sides.

        `errors`: whether to measure the errors of frames.
        """
        with ExitStack() as opened:
            sessions = []
            for scene in (left, right):
                sessions.append(Session(scene, out=out))
                opened.callback(sessions[-1].close)
            opened.pop_all()
        self.left, self.right = sessions
        self.left.view = self.right.view = view
        for side in self.sides:
            side.measure_errors(errors)
        self.left.camera = self.right.camera = camera_for_both(left, aspect)
        self._out = out.absolute()  # the window changes the working directory
        self.image: Pixels | None = None
        """The last image of both sides, if there was one."""
        self.hidden = False
        """Whether the panel is hidden."""
        self.shows_keys = False
        """Whether the panel lists the keys instead of statistics."""
        self.shows_settings = False
        """Whether the panel has sliders for the solver of each side instead of those for both sides."""
        self.running = True
        """False once the user has quit."""
        self._buttons: frozenset[str] = frozenset()  # mouse buttons that were down in the last displayed frame
        self._active = self.left  # the side under the cursor; during a drag, the side where it began
        a, b = self.left.simulation, self.right.simulation
        self._partners = {id(self.left): nearest_vertex_map(a, b), id(self.right): nearest_vertex_map(b, a)}

    @property
    def sides(self) -> tuple[Session, Session]:
        """The left and the right session."""
        return self.left, self.right

    @property
    def draw_lists(self) -> tuple[DrawList, DrawList]:
        """The draw lists of both sides."""
        return self.left.draw_list, self.right.draw_list

    @property
    def view(self) -> str:
        """The view of both sides."""
        return self.left.view

    @property
    def note(self) -> str:
        """One line for the user, of the left side if it has one, else of the right side."""
        return self.left.note or self.right.note

    @property
    def mouse(self) -> str:
        """What the mouse acts on, on the active side: a value of `dragging.Target`."""
        return self._active.pointer.owner.value

    @property
    def rms_distance(self) -> float:
        """Root mean square distance between the particles of both sides, as a fraction of the cloth's longer side."""
        return rms_distance(self.left.simulation, self.right.simulation, self._partners[id(self.left)])

    def close(self) -> None:
        """Release the resources of both sides."""
        for side in self.sides:
            side.close()

    def act(self, action: str) -> None:
        """Run the action of a key or button. Ignores actions that a comparison does not support."""
        if action in SHARED_ACTIONS:
            for side in self.sides:
                side.act(action)
        elif action in SIDE_ACTIONS:
            self._active.act(action)
        elif action == "first_view":
            self.left.act(action)
        elif action == "hide":
            self.hidden = not self.hidden
        elif action == "quit":
            self.running, self.shows_keys = self.shows_keys, False
        elif action == "screenshot":
            self.take_screenshot()
        elif action == "page":
            self.shows_settings = not self.shows_settings
        elif action == "help":
            self.shows_keys = not self.shows_keys
        else:
            key = next(key for key in SHORTCUTS if key.action == action)
            self.show(Refusal(f"{key.label}: {key.help}: not in a comparison"))

    def show(self, note: str) -> None:
        """Show one line for the user."""
        self.left.note, self.right.note = note, ""

    def take_screenshot(self) -> None:
        """Write the last image of both sides, without the panel, to a new file of the output folder."""
        if self.image is None:
            return
        folder = self._out / f"compare_{self.left.simulation.scene.name}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path = next_free_path(folder, "shot").with_suffix(".png")
            write_png(path, self.image)
        except OSError as error:
            self.show(Refusal(f"screenshot failed: {error_text(error)}"))
        else:
            self.show(f"wrote {path.relative_to(self._out.parent)}")

    def request(self, action: str) -> None:
        """Run an action. If it may compile for seconds, first display a frame whose note says so (`run_deferred`)."""
        sides = self.sides if action in SHARED_ACTIONS else (self._active,) if action in SIDE_ACTIONS else ()
        for side in self.sides if sides else ():
            side.note = ""  # one line is shown, the one about this action
        for side in sides:
            side.request(action)
        if not sides:
            self.act(action)

    def run_deferred(self) -> None:
        """Run the deferred actions. Call it after a frame was displayed."""
        for side in self.sides:
            side.run_deferred()

    def on_key_held(self, action: str, seconds: float) -> None:
        """Continue the action of a key that is held down, for that much wall time [s]."""
        if action in HELD_KEY_RATES:  # the sides share the camera
            self.left.on_key_held(action, seconds)

    def set_parameter(self, name: str, value: float) -> None:
        """Set a runtime parameter on each side that has it."""
        for side in self.sides:
            if name in parameters_of(side.simulation.scene):
                side.simulation.params[name] = value

    def on_pointer(
        self,
        cursor: tuple[float, float],
        buttons: frozenset[str],
        size: tuple[int, int],
        *,
        on_panel: bool,
        widget_changed: bool,
    ) -> None:
        """Process the mouse of one displayed frame. A grab on one side also grabs the same point of the other cloth.

        `cursor`: a screen point. `size`: of both images together [pixels]. Other arguments as for `Session.on_pointer`.
        """
        if not (buttons or self._buttons):  # a release belongs to the side of its press
            self._active = self.left if cursor[0] < 0.5 else self.right
        self._buttons = buttons
        active, other = self.sides if self._active is self.left else self.sides[::-1]
        u = 2 * cursor[0] - (active is self.right)
        half = size[0] // 2, size[1]
        active.on_pointer((u, cursor[1]), buttons, half, on_panel=on_panel, widget_changed=widget_changed)
        other.dragger.mirror(active.dragger, self._partners[id(active)], active.grab_radius)

    def _measure_together(self) -> None:
        """Have the same frame of both sides measured: one waits for the other, unless that cannot be measured."""
        meters = [side.meter for side in self.sides if side.meter and not side.meter.is_refused]
        for meter in meters:
            meter.receive()
        ready = [meter.is_free for meter in meters]
        for meter in meters:
            meter.is_held = not all(ready)

    def advance(self, frames: int) -> None:
        """Advance both sides by a number of frames, unless they are frozen. If one diverges, both freeze."""
        self._measure_together()
        for side, other in (self.sides, self.sides[::-1]):
            was_frozen = side.frozen
            side.advance(frames)
            if side.frozen and not was_frozen:  # its note says why
                other.note = ""
        for side in self.sides:
            side.frozen = self.left.frozen or self.right.frozen

    def measure(self) -> None:
        """Update the metrics of both sides."""
        for side in self.sides:
            side.measure()
