"""Keyboard shortcuts, the actions of shortcuts and buttons, and lists to choose from.

The window acts on the shortcuts; the panel and docs/controls.md list them. The UI toolkit reports letters, Space, Tab,
Escape and the arrow keys only: no digits, no F-keys, no mouse wheel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..render.draw_list import VIEWS
from ..scene import parameters_of
from ..scene.fabric_schema import PRESET_NAMES
from ..scene.schema import SOLVER_NAMES
from ..simulation.copies import feature_times
from ..system.errors import UsageError
from .dragging import pick_under_cursor
from .toolkit import Refusal

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
    Shortcut("z", "Z", "undo", "undo grab or pin"),
    Shortcut("q", "Q", "rewind", "back in time", held=True),
    Shortcut("w", "W", "forward", "forward in time", held=True),
    Shortcut("g", "G", "wind", "wind on/off"),
    Shortcut("v", "V", "view", "next view"),
    Shortcut("t", "T", "solver", "next solver"),
    Shortcut("y", "Y", "fabric", "next fabric"),
    Shortcut("x", "X", "feature", "next feature off"),
    Shortcut("p", "P", "pin", "pin/unpin within radius"),
    Shortcut("j", "J", "smaller_radius", "shrink grab radius"),
    Shortcut("l", "L", "larger_radius", "grow grab radius"),
    Shortcut("d", "D", "restore_defaults", "restore defaults"),
    Shortcut("k", "K", "charts", "charts on/off"),
    Shortcut("u", "U", "errors", "measure errors"),
    Shortcut("b", "B", "previous_scene", "previous scene"),
    Shortcut("m", "M", "next_scene", "next scene"),
    Shortcut("e", "E", "export", "export OBJ file"),
    Shortcut("f", "F", "first_view", "frame cloth"),
    Shortcut("Tab", "Tab", "page", "next panel page"),
    Shortcut("a", "A", "help", "help"),
    Shortcut("h", "H", "hide", "show/hide panel"),
    Shortcut("s", "S", "screenshot", "take screenshot"),
    Shortcut("c", "C", "clip", "start/stop clip"),
    Shortcut("i", "I", "zoom_in", "zoom in", held=True),
    Shortcut("o", "O", "zoom_out", "zoom out", held=True),
    Shortcut("Left", "Left", "pan_left", "pan left", held=True),
    Shortcut("Right", "Right", "pan_right", "pan right", held=True),
    Shortcut("Up", "Up", "pan_up", "pan up", held=True),
    Shortcut("Down", "Down", "pan_down", "pan down", held=True),
    Shortcut("Escape", "Esc", "quit", "close page or quit"),
)

ARROWS = ("Left", "Right", "Up", "Down")  # the panel has one help entry for all four

MOUSE = (
    ("left drag", "grab cloth or a ball"),
    ("beside them", "orbit camera"),
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


ZOOM_RATE = 8.0  # [steps/s] while a key is held down
PAN_RATE = 0.5  # [heights of the image/s]

# Actions of keys that are held down: rates of zoom, pan right and pan up.
HELD_KEY_RATES = {
    "zoom_in": (ZOOM_RATE, 0.0, 0.0),
    "zoom_out": (-ZOOM_RATE, 0.0, 0.0),
    "pan_left": (0.0, -PAN_RATE, 0.0),
    "pan_right": (0.0, PAN_RATE, 0.0),
    "pan_down": (0.0, 0.0, -PAN_RATE),
    "pan_up": (0.0, 0.0, PAN_RATE),
}


# Actions of keys that are held down: seconds further back in each second.
REWIND_RATES = {"rewind": 1.0, "forward": -1.0}


def hold(session: Session, action: str, seconds: float) -> None:
    """Continue the action of a key that is held down, for that much wall time [s]."""
    if action in REWIND_RATES:
        session.go_back(session.rewind_buffer.further_back(REWIND_RATES[action] * seconds))
        return
    zoom, right, up = HELD_KEY_RATES[action]
    session.zoom(zoom * seconds)
    session.camera.pan(right * seconds, up * seconds)


class Deferred:
    """Actions that may compile for seconds, which wait until a frame was displayed whose note names them.

    Of each kind only the last is done, and with another scene nothing else, because it would be for this one. So keys
    that are pressed while the display pauses do not compile one thing after another.
    """

    def __init__(self) -> None:
        self._waiting: dict[str, Callable[[], None]] = {}
        self.wished: dict[str, str] = {}
        """The name that the waiting action changes to, by kind of list."""

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, kind: str, do: Callable[[], None]) -> bool:
        """Add an action. Return False if another scene is waiting."""
        if kind == "scene":
            self._waiting.clear()
        if "scene" in self._waiting:
            return False
        self._waiting[kind] = do
        return True

    def take(self) -> list[Callable[[], None]]:
        """Remove and return all actions."""
        waiting, self._waiting, self.wished = list(self._waiting.values()), {}, {}
        return waiting


# -- lists to choose from ----------------------------------------------------------------------------------------------

FABRICS = ("", *PRESET_NAMES)  # "": the scene's own
OWN_FABRIC = "own fabric"  # its label
SPEEDS = {"1": 1.0, "1/2": 0.5, "1/4": 0.25, "1/8": 0.125}  # simulated time per wall time, by name
LISTS: dict[str, tuple[str, ...]] = {"solver": SOLVER_NAMES, "fabric": FABRICS, "view": VIEWS, "speed": tuple(SPEEDS)}

# Actions that choose the neighbor of the present name in a list: kind and step.
NEIGHBORS = {
    "solver": ("solver", 1),
    "fabric": ("fabric", 1),
    "next_scene": ("scene", 1),
    "previous_scene": ("scene", -1),
}


def names(session: Session, kind: str) -> tuple[str, ...]:
    """Return the names of a list: of the scenes, solvers, fabrics, views or speeds."""
    return session.scenes if kind == "scene" else LISTS[kind]


def chosen(session: Session, kind: str) -> str:
    """Return the name that is in use."""
    simulation = session.simulation
    in_use = {"scene": simulation.scene.name, "solver": simulation.solver.name}
    return (in_use | {"fabric": session.fabric, "view": session.view, "speed": session.speed})[kind]


def neighbor(session: Session, kind: str, name: str, step: int) -> str:
    """Return the next (`step` 1) or previous (-1) name."""
    all_names = names(session, kind)
    return all_names[(all_names.index(name) + step) % len(all_names)]


def change_to(session: Session, kind: str, name: str, step: int = 0) -> None:
    """Change to a name. If the scene does not support it, the note says why.

    With a `step` other than 0 the next name that the scene supports follows, in this direction.
    """
    change = {"scene": session.open_scene, "solver": session.change_solver, "fabric": session.change_fabric}[kind]
    before, refused = chosen(session, kind), ""
    change(name)
    while step and chosen(session, kind) != name and name != before:
        refused = refused or session.note
        name = neighbor(session, kind, name, step)
        change(name)
    session.note = refused or session.note


def change_to_neighbor(session: Session, action: str) -> None:
    """Change to the neighbor that an action chooses."""
    kind, step = NEIGHBORS[action]
    change_to(session, kind, neighbor(session, kind, chosen(session, kind), step), step)


# -- actions -----------------------------------------------------------------------------------------------------------

MENU = "Menu"  # the page that lists the others
HELP = "Help"  # the page that is shown over the picture
PAGES = ("Sliders", "Scenes", "Solvers", "Fabrics", "Views", "Speeds", "Features", "Statistics", HELP)
GRAB_RADIUS_FACTOR = 1.25  # factor between two grab radii

# Other actions that may have to compile kernels, and what the user reads meanwhile.
COMPILING_ACTIONS = {"feature": "features", "time_features": "feature times"}


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
    if session.simulation.scene.wind is None:
        session.note = Refusal("this scene has no wind")
        return
    session.simulation.params["wind"] = not session.simulation.params["wind"]
    session.note = "wind on" if session.simulation.params["wind"] else "wind off: G turns it on"


def view(session: Session) -> None:
    session.view = VIEWS[(VIEWS.index(session.view) + 1) % len(VIEWS)]


def solver(session: Session) -> None:
    change_to_neighbor(session, "solver")


def fabric(session: Session) -> None:
    change_to_neighbor(session, "fabric")


def feature(session: Session) -> None:
    """Switch off the feature after the one that is off now, and switch that on. After the last all are on."""
    names = list(session.features)
    off = [k for k, name in enumerate(names) if not session.features[name]]
    next_index = off[-1] + 1 if off else 0
    session.set_features({name: k != next_index for k, name in enumerate(names)})
    if not session.note and next_index < len(names):
        session.note = f"without {display_name(names[next_index])} until it is checked in Features"


def time_features(session: Session) -> None:
    try:
        session.feature_times = feature_times(session.simulation, session.layout)
    except UsageError as error:
        session.note = Refusal(error)


def undo(session: Session) -> None:
    session.undo()


def pin(session: Session) -> None:
    """Pin the dragged particle, or else the one under the cursor; unpin it if it is pinned."""
    index = session.dragger.particle
    if index is None and session.cursor is not None:
        index = pick_under_cursor(session.simulation, session.camera, *session.cursor)
    session.pin(index)


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
    if session.simulation.scene.wind is not None:
        session.simulation.params["wind"] = True


def charts(session: Session) -> None:
    session.charts = not session.charts


def errors(session: Session) -> None:
    session.measure_errors(session.meter is None)


def page(session: Session) -> None:
    session.page = PAGES[(PAGES.index(session.page) + 1) % len(PAGES)] if session.page in PAGES else PAGES[0]


def menu(session: Session) -> None:
    session.page = MENU


def help(session: Session) -> None:
    """Show the help, or the first page if it is shown."""
    session.page = PAGES[0] if session.page == HELP else HELP


def previous_scene(session: Session) -> None:
    change_to_neighbor(session, "previous_scene")


def next_scene(session: Session) -> None:
    change_to_neighbor(session, "next_scene")


def export(session: Session) -> None:
    """Write the mesh of the cloth as it is now."""
    write = session.export
    session.note = session.capture.mesh(write, session.simulation) if write else Refusal("no mesh export here")


def save_scene(session: Session) -> None:
    """Write the scene with the present values of the sliders."""
    save = session.save
    session.note = session.capture.scene(save, session.simulation) if save else Refusal("no scenes are saved here")


def first_view(session: Session) -> None:
    """Return to the scene's view, from farther away if the cloth is not in the picture."""
    session.camera.reset()
    session.camera.include(session.simulation.positions(), session.size[0] / session.size[1])


def screenshot(session: Session) -> None:
    """Save an image of the current frame, with a recording."""
    session.record_view()
    image = session.draw_list, session.camera, session.view, session.size
    session.note = session.capture.screenshot(session.recorder, *image)


def clip(session: Session) -> None:
    """Begin a clip, or end and render the one that is on."""
    if session.capture.clip_is_on:
        session.end_clip()
    else:
        session.restart_recording()
        session.note = session.capture.begin_clip()


def hide(session: Session) -> None:
    session.hidden = not session.hidden


def quit(session: Session) -> None:
    """Close the help, or leave another page of the panel for the sliders; quit from there."""
    if session.page == HELP or (session.page != PAGES[0] and not session.hidden):
        session.page = PAGES[0]
    else:
        session.running = False


def display_name(section: str) -> str:
    """Return the name of a scene section as the user reads it."""
    return section.replace("_", "-")


ACTIONS: dict[str, Callable[[Session], None]] = {
    action.__name__: action
    for action in (
        *(freeze, step, reset, wind, view, solver, fabric, feature, time_features, pin, smaller_radius, larger_radius),
        *(restore_defaults, charts, errors, page, menu, help, previous_scene, next_scene, export, first_view),
        *(screenshot, save_scene, clip, hide, quit, undo),
    )
}
