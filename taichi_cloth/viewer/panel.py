"""The control panel: sliders, switches, statistics and key help.

It has pages, since the toolkit has no collapsible sections.
"""

from __future__ import annotations

import textwrap
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import taichi as ti

from ..render.camera import MAX_ZOOM_LEVEL
from ..render.colors import mean_spring_length
from ..scene.parameters import Parameter, parameters_of
from ..scene.presets import load_preset, scene_path
from ..scene.solver_catalog import SOLVER_CATALOG
from ..simulation.copies import FeatureTimes
from ..simulation.simulation import Simulation
from . import charts
from .charts import SOLVER_USES, alert
from .error_process import error_lines
from .input import ARROWS, HELP, MENU, MOUSE, OWN_FABRIC, PAGES, SHORTCUTS, chosen, display_name, names
from .session import Session
from .toolkit import PanelRect, Progress, Refusal, draw_lines, has_changed, saved_panel_rect, sub_window

# -- panel -------------------------------------------------------------------------------------------------------------

PANEL_NAME = "taichi_cloth"
PANEL_MARGIN = 10  # [pixels] between the panel and the edge of the window
PANEL_WIDTH = 392  # [pixels] a slider takes 65 % of it, which leaves 17 characters for its label
PANEL_HEIGHT = 700  # [pixels] room for the longest page
# Characters in a line: the toolkit's padding is 8 pixels, its scroll bar 14, and a character is 7 pixels wide.
LINE_LENGTH = (PANEL_WIDTH - 2 * 8 - 14) // 7
ENTRY_LENGTH = LINE_LENGTH - len("> ") - 1  # of an entry of a list: a button has a margin of 4 pixels on both sides
HELP_SIZE = (500, 420)  # [pixels] of the help over the picture: its lines are 68 characters
SUMMARY_LINES = 5  # lines of the statistics that most pages show, and then the error of a frame
BRIEF_LINES = 2  # the same without room for all: below a list, or in a panel that is lower than
FULL_HEIGHT = 560  # [pixels]
HIDDEN_TITLE = "message (H shows the panel)"  # of the caption of a note while the panel is hidden
GRAY_TITLE = "gray: no error is known"
NOTE_COLORS = {Refusal: (1.0, 0.6, 0.3), Progress: (1.0, 1.0, 1.0), str: (0.45, 0.9, 0.5)}  # by type of the note
LIST_LENGTH = 20  # names on a page, fewer in a low panel; a longer list has several pages
ROW_HEIGHT, LIST_EXTRA_HEIGHT = 23, 200  # [pixels] of a button; of a page with a list, without the names
GRAB_RADIUS = "grab_radius"  # name of the grab radius slider
FIRST_HELP = (
    "Drag cloth or a ball; drag beside it to orbit; I, O: zoom; A: help; Tab: next page. Move a slider for its help."
)
ZOOM = "zoom"
SLIDER_HELP = {
    GRAB_RADIUS: "Grab radius along the cloth: particles within it move with the grabbed one; 0 m grabs one particle",
    ZOOM: "Zoom: each step moves the eye a tenth closer to what it looks at; 0 is the camera of the scene",
}
ERRORS_HERE = "mm: the last error of a frame that was measured in this scene"
ERRORS_OF_SOLVERS = "errors and times of all solvers in this scene: docs/scene_errors.md"
# Kind of list of each page.
LIST_PAGES = {"Scenes": "scene", "Solvers": "solver", "Fabrics": "fabric", "Views": "view", "Speeds": "speed"}


class Panel:
    """Draws the panel of a session and applies the user's changes.

    The toolkit identifies widgets by their labels, so labels are unique.
    """

    def __init__(self, size: tuple[int, int], settings: Path) -> None:
        """`size`: of the window when it opens [pixels]. `settings`: the toolkit's imgui.ini."""
        self.window_size = size
        height = min(PANEL_HEIGHT, size[1] - 2 * PANEL_MARGIN)
        self._initial_place = PanelRect(PANEL_MARGIN, PANEL_MARGIN, PANEL_WIDTH, height)
        self._settings = settings
        self._moved = ""  # name of the slider that was moved last
        self._list_part = 0  # of a list that is longer than a page

    @property
    def place(self) -> PanelRect:
        """The panel's rectangle. If the user moves the panel, the value follows some seconds later."""
        return saved_panel_rect(self._settings, PANEL_NAME) or self._initial_place

    def shift(self, size: tuple[int, int]) -> float:
        """Return how far right the image must move to be centered in the area beside the panel [heights of the window].

        `size`: of the window [pixels].
        """
        return self._initial_place.right / 2 / size[1]

    def draw(self, gui: ti.ui.Gui, session: Session, statistics: str) -> bool:
        """Declare all widgets for this frame. Return whether the user changed one.

        `statistics`: the text that the function `statistics` returns.
        """
        changed = False
        with sub_window(gui, PANEL_NAME, self._initial_place, self.window_size):
            page = "" if session.page == MENU else f" ({session.page})"
            changed |= apply_changes(gui, session, buttons=[("menu", f"Menu{page}")])
            if session.page not in LIST_PAGES:
                freeze = ("freeze", "Freeze", session.frozen)
                buttons = [("reset", "Reset"), ("undo", "Undo")]
                changed |= apply_changes(gui, session, [freeze], buttons)
            pages = {
                MENU: self._menu_page,
                "Sliders": self._sliders_page,
                "Features": self._features_page,
                "Statistics": self._statistics_page,
                HELP: self._help_page,
            }
            changed |= pages.get(session.page, self._list_page)(gui, session, statistics)
            if session.frozen and session.page not in LIST_PAGES:  # below, so that no slider moves
                changed |= apply_changes(gui, session, buttons=[("step", "Step")])
                changed |= draw_rewind(gui, session)
            for line in wrap(session.note):
                gui.text(line, color=NOTE_COLORS[type(session.note)])
            for line in wrap(alert(session)):
                gui.text(line, color=NOTE_COLORS[Refusal])
            if session.page != "Statistics":
                for line in wrapped_lines(self._summary(session, statistics)):
                    gui.text(line)
            if session.page == "Sliders":  # last: a low panel has no room for it beside a note
                for line in wrap(help_for(self._moved, acting_parameters(session.simulation))):
                    gui.text(line)
            if session.charts and session.page not in LIST_PAGES:
                gui.text(f"charts of the last {charts.CHART_SECONDS:g} s:")
                for line, color in charts.legend(session.history):
                    gui.text(line, color=color)
        return changed

    def _summary(self, session: Session, statistics: str) -> list[str]:
        """Return what runs and the error of a frame, with its largest of a particle if that is what colors mean."""
        is_brief = session.page in LIST_PAGES or self._initial_place.height < FULL_HEIGHT
        lines = statistics.splitlines()[: BRIEF_LINES if is_brief else SUMMARY_LINES]
        shows_error = session.view == "error"
        errors = error_lines(session.meter, frozen=session.frozen)[: 1 + shows_error]
        return lines if is_brief and not shows_error else [*lines, *errors]

    # Each page declares its widgets, and returns whether the user changed one.

    def _menu_page(self, gui: ti.ui.Gui, session: Session, statistics: str) -> bool:
        """A button for each other page, and one that saves the scene."""
        pressed = [page for page in PAGES if gui.button(page)]
        session.page = next(iter(pressed), session.page)
        return apply_changes(gui, session, buttons=[("save_scene", "Save scene")]) or bool(pressed)

    def _list_page(self, gui: ti.ui.Gui, session: Session, statistics: str) -> bool:
        """A button for each name of a list, or of a part of it. The one in use is marked."""
        kind = LIST_PAGES[session.page]
        listed, in_use = names(session, kind), chosen(session, kind)
        length = max(1, min(LIST_LENGTH, (self._initial_place.height - LIST_EXTRA_HEIGHT) // ROW_HEIGHT))
        parts = -(-len(listed) // length)
        self._list_part += int(parts > 1 and gui.button(f"More {session.page.lower()}"))
        first = self._list_part % parts * length
        shown = listed[first : first + length]
        labels = {name: with_title(session, kind, name) for name in shown}
        errors = session.meter.by_solver if kind == "solver" and session.meter else {}
        labels |= {name: f"{name}: {errors[name]}" for name in shown if name in errors}
        pressed = [name for name, label in labels.items() if gui.button(f"> {label}" if name == in_use else label)]
        for name in pressed:
            if kind == "speed":
                session.speed = name
            else:
                session.choose(kind, name)
        more = [ERRORS_HERE if errors else "", ERRORS_OF_SOLVERS] if kind == "solver" else []
        for line in wrapped_lines([description(session, kind).replace("–", "-"), *more]):  # the font has no "–"
            gui.text(line)
        return bool(pressed)

    def _sliders_page(self, gui: ti.ui.Gui, session: Session, statistics: str) -> bool:
        """Runtime parameters that act, the grab radius, and the zoom."""
        changed = False
        keys = acting_parameters(session.simulation)
        if not session.simulation.params["wind"]:
            keys = {name: key for name, key in keys.items() if key.section != "wind"}
        for key in keys.values():
            if draw_slider(gui, session, key):
                changed, self._moved = True, key.name
        radius = gui.slider_float("Grab radius [m]", session.grab_radius, 0.0, session.max_grab_radius)
        if has_changed(radius, session.grab_radius):
            session.grab_radius = min(max(radius, 0.0), session.max_grab_radius)
            changed, self._moved = True, GRAB_RADIUS
        level = round(session.camera.zoom_level, 3) + 0.0  # never -0.0
        zoom = gui.slider_float("Zoom [steps]", level, -MAX_ZOOM_LEVEL, MAX_ZOOM_LEVEL)
        if has_changed(zoom, level):
            session.zoom(zoom - level)
            changed, self._moved = True, ZOOM
        if apply_changes(gui, session, buttons=[("restore_defaults", "Restore defaults")]):
            changed, self._moved = True, ""
        return changed

    def _features_page(self, gui: ti.ui.Gui, session: Session, statistics: str) -> bool:
        """Switches for features, and a button to time them."""
        simulation = session.simulation
        times = session.feature_times
        wind = simulation.scene.wind and [("wind", with_cost("wind", times), bool(simulation.params["wind"]))]
        changed = apply_changes(gui, session, switches=wind or ())
        before = session.features
        after = {name: gui.checkbox(with_cost(name, times), on) for name, on in before.items()}
        if after != before:
            session.request_features(after)
            changed = True
        changed |= apply_changes(gui, session, buttons=[("time_features", "Time features")])
        if times:
            gui.text(timing_line(times))
        return changed

    def _statistics_page(self, gui: ti.ui.Gui, session: Session, statistics: str) -> bool:
        """All statistics, and the switch for the charts."""
        for line in wrapped_lines(statistics.splitlines()):
            gui.text(line)
        errors = ("errors", "Measure errors", session.meter is not None)
        return apply_changes(gui, session, switches=[("charts", "Charts", session.charts), errors])

    def _help_page(self, gui: ti.ui.Gui, session: Session, statistics: str) -> bool:
        """Where the help is."""
        for line in wrap("The help is shown over the picture. A or Close help closes it."):
            gui.text(line)
        return apply_changes(gui, session, buttons=[("help", "Close help")])

    def draw_help(self, gui: ti.ui.Gui) -> None:
        """Draw the help on keys and mouse over the picture."""
        place = self.help_place
        with sub_window(gui, HELP, place, self.window_size):
            for line in help_lines(2 if place.width == HELP_SIZE[0] else 1):
                gui.text(line)

    @property
    def help_place(self) -> PanelRect:
        """The rectangle of the help, in the middle of the area beside the panel if there is room, and in the window."""
        size = [min(most, side - 2 * PANEL_MARGIN) for most, side in zip(HELP_SIZE, self.window_size, strict=True)]
        width, height = self.window_size
        left = min((self._initial_place.right + width - size[0]) // 2, width - size[0] - PANEL_MARGIN)
        return PanelRect(max(left, PANEL_MARGIN), (height - size[1]) // 2, size[0], size[1])


# -- widgets -----------------------------------------------------------------------------------------------------------

Switches = Sequence[tuple[str, str, bool]]  # action, label, state
Buttons = Sequence[tuple[str, str]]  # action, label


def draw_caption(gui: ti.ui.Gui, window_size: tuple[int, int], title: str, lines: Sequence[str]) -> None:
    """Draw lines where the panel would be. `window_size`: of the window when it opens [pixels]."""
    draw_lines(gui, title, wrapped_lines(lines), (PANEL_MARGIN, PANEL_MARGIN, PANEL_WIDTH), window_size)


def draw_gray_reason(gui: ti.ui.Gui, session: Session, window_size: tuple[int, int]) -> None:
    """Draw, in place of the color scale, why the view `error` has no colors, if there is room beside the panel."""
    left = window_size[0] - PANEL_MARGIN - PANEL_WIDTH
    if session.view == "error" and session.draw_list.scale("error") is None and left > PANEL_WIDTH + 2 * PANEL_MARGIN:
        line = error_lines(session.meter, frozen=session.frozen)[0]
        draw_lines(gui, GRAY_TITLE, wrap(line), (left, PANEL_MARGIN, PANEL_WIDTH), window_size)


def own_fabric(session: Session) -> str:
    """Return the label of the scene's own fabric: with its preset if it has one, short enough for a button."""
    preset = session.simulation.original_scene.fabric.preset
    return f"own ({preset})" if preset else OWN_FABRIC


fabric_title = cache(lambda name: load_preset(name).title)  # which reads a file


@cache
def shipped_title(name: str) -> str:
    """Return the title of a shipped scene, read without the rest of its file."""
    return str(tomllib.loads(scene_path(name).read_text(encoding="utf-8"))["title"])


def with_title(session: Session, kind: str, name: str) -> str:
    """Return the label of a name of a list: with a title or a use, as far as a line has room."""
    if kind == "fabric":
        label, title = (name, fabric_title(name).partition(": ")[2]) if name else (own_fabric(session), "")
    elif kind == "scene":
        initial = session.initial_scene  # the list opens it, and not a shipped scene of the same name
        label, title = name, initial.title if name == initial.name else shipped_title(name)
    else:
        label, title = name, SOLVER_USES[name] if kind == "solver" else ""
    return textwrap.shorten(f"{label}: {title}", ENTRY_LENGTH, placeholder=" ...") if title else label


def description(session: Session, kind: str) -> str:
    """Return what the name in use of a list stands for: one line, or an empty one."""
    scene = session.simulation.scene
    if kind == "fabric":
        return fabric_title(scene.fabric.preset) if scene.fabric.preset else ""
    known = {"scene": scene.title, "solver": SOLVER_CATALOG[scene.solver.name].summary}
    return (known | {"view": "what the picture shows", "speed": "simulated seconds per second"})[kind]


def apply_changes(gui: ti.ui.Gui, session: Session, switches: Switches = (), buttons: Buttons = ()) -> bool:
    """Declare switches and buttons, and run the actions of those that were used. Return whether there are any."""
    actions = [action for action, label, before in switches if gui.checkbox(label, before) != before]
    actions += [action for action, label in buttons if gui.button(label)]
    for action in actions:
        session.request(action)
    return bool(actions)


def with_cost(feature: str, times: FeatureTimes | None) -> str:
    """Return the label of a feature, with the time it adds to a frame if that was measured."""
    label = display_name(feature).capitalize()
    return f"{label} {times.cost_ms[feature]:+.2f} ms" if times and feature in times.cost_ms else label


def timing_line(times: FeatureTimes) -> str:
    """Return what the times of features were measured on."""
    return f"timed from frame {times.frame}: {times.ms:.2f} ms per frame"


def help_for(name: str, keys: Mapping[str, Parameter]) -> str:
    """Return the help of a slider: meaning, range, and default, which is the scene's value."""
    if name not in keys:
        return SLIDER_HELP.get(name, FIRST_HELP)
    key = keys[name]
    unit = f" {key.unit}" if key.unit else ""
    default = f"{key.value:g}" + ", which is raised" * (key.value < key.slider_min)  # to substeps that are stable
    return f"{key.label}: {key.help}; {key.slider_min:g} to {key.slider_max:g}{unit}, scene default {default}"


def draw_slider(gui: ti.ui.Gui, session: Session, key: Parameter, owner: str = "") -> bool:
    """Declare the slider of one runtime parameter. Return whether the user moved it. `owner`: in front of its label."""
    label = owner + (f"{key.label} [{key.unit}]" if key.unit else key.label)
    simulation = session.simulation
    before = simulation.substeps if key.name == "substeps" else simulation.params[key.name]
    slider = gui.slider_int if key.is_int else gui.slider_float
    after = slider(label, before, key.slider_min, key.slider_max)
    if not has_changed(after, before):
        return False
    simulation.params[key.name] = min(max(after, key.slider_min), key.slider_max)
    return True


def draw_rewind(gui: ti.ui.Gui, session: Session) -> bool:
    """Declare the slider that goes back in time. Return whether the user moved it."""
    back = gui.slider_float("Rewind [s]", session.rewind_buffer.back, 0.0, session.rewind_buffer.seconds)
    if not has_changed(back, session.rewind_buffer.back):
        return False
    session.go_back(min(max(back, 0.0), session.rewind_buffer.seconds))
    return True


MAX_THICKNESS = 0.5  # [cells] with a slider, of cloth that nothing penetrates: at two cells a frame takes seconds


def slider_parameters(simulation: Simulation) -> dict[str, Parameter]:
    """Return the runtime parameters with the ranges that sliders give them in this scene."""
    known, contact = parameters_of(simulation.scene), simulation.scene.self_collision
    if contact is not None and contact.penetration_free:
        thickness = known["self_collision_thickness"]
        most = max(contact.thickness, MAX_THICKNESS * mean_spring_length(simulation.topology))
        known["self_collision_thickness"] = replace(thickness, slider_max=min(thickness.slider_max, most))
    return known


def acting_parameters(simulation: Simulation) -> dict[str, Parameter]:
    """Return the runtime parameters that have an effect, with the ranges of their sliders.

    Without `iterations` for a solver that does not iterate, and with `substeps` from the fewest that are stable.
    """
    known, fewest = slider_parameters(simulation), simulation.built.min_stable_substeps
    substeps = known["substeps"]
    known["substeps"] = replace(substeps, slider_min=max(substeps.slider_min, fewest))
    idle = {"iterations"} if simulation.solver.info.is_explicit else set()
    idle |= {"substeps"} if fewest >= substeps.slider_max else set()
    return {name: key for name, key in known.items() if name not in idle}


# -- texts -------------------------------------------------------------------------------------------------------------


def wrap(text: str) -> list[str]:
    """Return text as lines that fit the panel."""
    return textwrap.wrap(text, LINE_LENGTH, subsequent_indent="  ")


def wrapped_lines(lines: Sequence[str]) -> list[str]:
    """Return all lines, wrapped."""
    return [part for line in lines for part in wrap(line)]


# -- help --------------------------------------------------------------------------------------------------------------

KEY_COLUMN = 34  # [characters] width of the first column of the help
FIRST_STEPS = (
    "Pull the cloth or a ball with the left button; the ring shows what is grabbed. Drag beside them to look around."
    " Sliders change the scene while it runs; Menu lists scenes, solvers, fabrics and views."
)


def help_lines(columns: int = 2) -> list[str]:
    """Return the help: how to begin, then keys and mouse, one or two entries to a line."""
    entries = [f"{key.label:5} {key.help}" for key in SHORTCUTS if key.code not in ARROWS] + ["arrows: pan camera"]
    entries += [f"{drag}: {help}" for drag, help in MOUSE]
    begin = textwrap.wrap(FIRST_STEPS, columns * KEY_COLUMN)
    if columns == 1:
        return [*begin, *entries]
    half = (len(entries) + 1) // 2
    return [*begin, *(f"{a:{KEY_COLUMN}} {b}" for a, b in zip(entries[:half], [*entries[half:], ""], strict=False))]
