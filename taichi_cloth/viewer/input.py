"""Input: keyboard shortcuts, the actions of shortcuts and buttons, and what the mouse acts on.

The window acts on the shortcuts; the panel and docs/controls.md list them. The UI toolkit reports letters, Space, Tab,
Escape and the arrow keys only: no digits, no F-keys, no mouse wheel.

A press of the mouse selects the panel, the cloth or the camera, until the button is released. The toolkit does not
report whether its panel uses the mouse, so the position of the press decides: is it inside the panel's rectangle? That
rectangle is out of date for some seconds after the user has moved the panel. If a widget changes during a drag of the
cloth, the press was on the panel, and the cloth is released.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from ..render.draw_list import VIEWS
from ..scene import parameters_of
from ..scene.schema import PRESET_NAMES, SOLVER_NAMES
from ..system.errors import UsageError

if TYPE_CHECKING:
    from .session import Session

# -- shortcuts ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Shortcut:
    """A key of the keyboard and its action."""

    code: str
    """The toolkit's name of the key."""
    label: str
    """Its name in help texts."""
    action: str
    """The action for `Session.act`, or for `Session.on_key_held` if `held`."""
    help: str
    held: bool = False
    """Whether it acts continuously while it is down."""


SHORTCUTS = (
    Shortcut(" ", "Space", "freeze", "freeze/resume"),
    Shortcut("n", "N", "step", "step one frame"),
    Shortcut("r", "R", "reset", "reset"),
    Shortcut("g", "G", "wind", "wind on/off"),
    Shortcut("v", "V", "view", "next view"),
    Shortcut("t", "T", "solver", "next solver"),
    Shortcut("y", "Y", "fabric", "next fabric"),
    Shortcut("x", "X", "feature", "next feature off"),
    Shortcut("p", "P", "pin", "pin/unpin particle"),
    Shortcut("j", "J", "smaller_radius", "shrink grab radius"),
    Shortcut("l", "L", "larger_radius", "grow grab radius"),
    Shortcut("d", "D", "restore_defaults", "restore defaults"),
    Shortcut("k", "K", "charts", "charts on/off"),
    Shortcut("b", "B", "previous_scene", "previous scene"),
    Shortcut("m", "M", "next_scene", "next scene"),
    Shortcut("e", "E", "export", "export OBJ file"),
    Shortcut("f", "F", "first_view", "reset camera"),
    Shortcut("Tab", "Tab", "page", "next panel page"),
    Shortcut("h", "H", "hide", "show/hide panel"),
    Shortcut("s", "S", "screenshot", "take screenshot"),
    Shortcut("c", "C", "clip", "start/stop clip"),
    Shortcut("i", "I", "zoom_in", "zoom in", held=True),
    Shortcut("o", "O", "zoom_out", "zoom out", held=True),
    Shortcut("Left", "Left", "pan_left", "pan left", held=True),
    Shortcut("Right", "Right", "pan_right", "pan right", held=True),
    Shortcut("Up", "Up", "pan_up", "pan up", held=True),
    Shortcut("Down", "Down", "pan_down", "pan down", held=True),
    Shortcut("Escape", "Esc", "quit", "quit"),
)

ARROWS = ("Left", "Right", "Up", "Down")  # the panel has one help entry for all four

MOUSE = (
    ("left drag", "grab cloth"),
    ("right drag", "orbit camera"),
    ("middle drag", "zoom"),
)


def table() -> list[str]:
    """Return the lines of a Markdown table of mouse and keys, two entries to a row, for `docs/controls.md`."""
    entries = [*MOUSE, *((key.label, key.help) for key in SHORTCUTS)]
    half = (len(entries) + 1) // 2
    left, right = entries[:half], [*entries[half:], ("", "")]
    rows = [f"| {a} | {what} | {b} | {other} |" for (a, what), (b, other) in zip(left, right, strict=False)]
    return ["| mouse, key | | key | |", "|---|---|---|---|", *rows]


# -- actions -----------------------------------------------------------------------------------------------------------

PAGES = ("Sliders", "Features", "Statistics", "Keys")
FABRICS = ("", *PRESET_NAMES)
GRAB_RADIUS_FACTOR = 1.25  # factor between two grab radii

# Actions that may have to compile kernels, and what the user reads meanwhile.
COMPILING_ACTIONS = {
    "solver": "next solver",
    "fabric": "next fabric",
    "feature": "features",
    "time_features": "feature times",
    "next_scene": "next scene",
    "previous_scene": "previous scene",
}


def freeze(session: Session) -> None:
    session.frozen = not session.frozen
    session.note = ""


def step(session: Session) -> None:
    session.frozen = True
    session.simulate(1)


def reset(session: Session) -> None:
    session.release_all()
    session.rebuild(session.simulation.reset)


def wind(session: Session) -> None:
    session.simulation.params["wind"] = not session.simulation.params["wind"]


def view(session: Session) -> None:
    session.view = VIEWS[(VIEWS.index(session.view) + 1) % len(VIEWS)]


def solver(session: Session) -> None:
    """Switch to the next solver that supports the scene; grabs remain."""
    next_index = SOLVER_NAMES.index(session.simulation.solver.name) + 1
    session.note = ""
    for name in SOLVER_NAMES[next_index:] + SOLVER_NAMES[: next_index - 1]:
        try:
            session.simulation.switch_solver(name)
            break
        except UsageError as error:
            session.note = str(error)
    session.refresh()


def fabric(session: Session) -> None:
    """Switch to the next fabric that the solver and the scene support. The note names the first that they do not."""
    next_index = FABRICS.index(session.fabric) + 1
    refused = ""
    for name in FABRICS[next_index:] + FABRICS[: next_index - 1]:
        session.change_fabric(name)
        if session.fabric == name:
            break
        refused = refused or session.note
    session.note = refused


def feature(session: Session) -> None:
    """Switch off the feature after the one that is off now, and switch that on. After the last all are on."""
    names = list(session.features)
    off = [k for k, name in enumerate(names) if not session.features[name]]
    next_index = off[-1] + 1 if off else 0
    session.set_features({name: k != next_index for k, name in enumerate(names)})
    if not session.note and next_index < len(names):
        session.note = f"without {display_name(names[next_index])}"


def time_features(session: Session) -> None:
    session.time_features()


def pin(session: Session) -> None:
    session.pin_under_cursor()


def smaller_radius(session: Session) -> None:
    shrinks = session.grab_radius > session.default_grab_radius / 2
    session.grab_radius = session.grab_radius / GRAB_RADIUS_FACTOR if shrinks else 0.0


def larger_radius(session: Session) -> None:
    larger = max(session.grab_radius * GRAB_RADIUS_FACTOR, session.default_grab_radius / 2)
    session.grab_radius = min(larger, session.max_grab_radius)


def restore_defaults(session: Session) -> None:
    session.grab_radius = session.default_grab_radius
    for parameter in parameters_of(session.simulation.scene).values():
        session.simulation.params[parameter.name] = parameter.value


def charts(session: Session) -> None:
    session.charts = not session.charts


def page(session: Session) -> None:
    session.page = PAGES[(PAGES.index(session.page) + 1) % len(PAGES)]


def previous_scene(session: Session) -> None:
    session.open_neighbor(-1)


def next_scene(session: Session) -> None:
    session.open_neighbor(1)


def export(session: Session) -> None:
    session.export_mesh()


def first_view(session: Session) -> None:
    session.camera.reset()


def screenshot(session: Session) -> None:
    session.screenshot()


def clip(session: Session) -> None:
    session.begin_or_end_clip()


def hide(session: Session) -> None:
    session.hidden = not session.hidden


def quit(session: Session) -> None:
    session.running = False


def display_name(section: str) -> str:
    """Return the name of a scene section as the user reads it."""
    return section.replace("_", "-")


ACTIONS: dict[str, Callable[[Session], None]] = {
    action.__name__: action
    for action in (
        *(freeze, step, reset, wind, view, solver, fabric, feature, time_features, pin, smaller_radius, larger_radius),
        *(restore_defaults, charts, page, previous_scene, next_scene, export, first_view, screenshot, clip, hide, quit),
    )
}


# -- the mouse ---------------------------------------------------------------------------------------------------------

BUTTONS = ("left", "right", "middle")
ZOOM_STEPS = 20.0  # zoom steps for a drag over the height of the window


class Target(Enum):
    """What the mouse acts on."""

    IDLE = "idle"
    PANEL = "panel"
    CLOTH = "cloth"
    CAMERA = "camera"
    NOTHING = "nothing"  # the press hit nothing; no action until the release


@dataclass(frozen=True)
class Mouse:
    """The mouse in one displayed frame."""

    x: float
    """Distance from the window's left edge [heights of the window]."""
    y: float
    """Distance from its lower edge [heights of the window]."""
    held: frozenset[str] = frozenset()
    """The buttons that are down, a subset of `BUTTONS`."""


@dataclass(frozen=True)
class Gesture:
    """What the mouse does in one displayed frame."""

    press: bool = False
    """Try to grab the cloth here. The caller calls `Pointer.miss` if there is none."""
    release: bool = False
    """Release the cloth."""
    orbit: tuple[float, float] = (0.0, 0.0)
    """Motion of the camera to the right and up [heights of the window]."""
    zoom: float = 0.0
    """Zoom steps, positive toward the target."""


class Pointer:
    """Turns buttons and motion into gestures. The first button pressed counts; others are ignored until its release."""

    def __init__(self) -> None:
        self.owner = Target.IDLE
        """What the mouse acts on now."""
        self._button = ""
        self._last = Mouse(0.0, 0.0)

    def update(self, mouse: Mouse, *, on_panel: bool, widget_changed: bool) -> Gesture:
        """Process the mouse of one displayed frame. Return its gesture.

        `on_panel`: whether the cursor is inside the panel's rectangle. `widget_changed`: whether a widget of the panel
        has changed in this frame.
        """
        right, up = mouse.x - self._last.x, mouse.y - self._last.y
        self._last = mouse
        if self.owner is Target.IDLE:
            return self._begin(mouse, on_panel)
        if self._button not in mouse.held:
            grabbed = self.owner is Target.CLOTH
            self.owner = Target.IDLE
            return Gesture(release=grabbed)
        if self.owner is Target.CLOTH and widget_changed:
            self.owner = Target.PANEL
            return Gesture(release=True)
        if self.owner is Target.CAMERA:
            return Gesture(zoom=ZOOM_STEPS * up) if self._button == "middle" else Gesture(orbit=(right, up))
        return Gesture()

    def _begin(self, mouse: Mouse, on_panel: bool) -> Gesture:
        if not mouse.held:
            return Gesture()
        self._button = min(mouse.held, key=BUTTONS.index)
        if on_panel:
            self.owner = Target.PANEL
            return Gesture()
        self.owner = Target.CLOTH if self._button == "left" else Target.CAMERA
        return Gesture(press=self.owner is Target.CLOTH)

    def miss(self) -> None:
        """Ignore the mouse until its button is up: the press hit no cloth, or the grabbed cloth was released."""
        if self.owner is Target.CLOTH:
            self.owner = Target.NOTHING
