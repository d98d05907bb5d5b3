"""The panel: sliders, switches, figures and the keys on pages, since the toolkit cannot fold."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..interact.keys import ARROWS, KEYS, MOUSE
from ..measure.estimate import estimate
from ..scene.live import LiveKey, live_keys
from ..scene.model import FRAME_SECONDS
from ..simulation import Simulation
from . import curves
from .panel_place import Place, saved_place
from .session import PAGES, Session, words
from .stage_times import StageTimes

NAME = "taichi_cloth"
MARGIN = 10  # [pixels]
WIDTH = 392  # [pixels] a slider takes 65 % of it and leaves 17 letters for its label
HEIGHT = 640  # [pixels] of the page that is fullest
LETTERS = (WIDTH - 2 * 8) // 7  # in a line: the toolkit's padding is 8 pixels, every letter 7 pixels wide
COLUMN = 25  # [letters]
LEAST_ERROR = 1e-4  # of the side
SHORT = 3  # lines of the figures that stand on every page
WARNING = (1.0, 0.6, 0.3)
HAND = "hand"
FIRST_HELP = "drag the cloth; M opens the next scene, Tab turns pages; a slider that is moved is explained here"
HAND_HELP = "Hand: what is so near on the sheet goes with the particle that is pulled; 0 m: that one alone"
CHOICES = (
    ("solver", "Next solver"),
    ("fabric", "Next fabric"),
    ("view", "Next view"),
    ("next_scene", "Next scene"),
    ("previous_scene", "Previous scene"),
)


class Panel:
    """Draws the panel of a session and obeys it. A widget's label is its identity: no two are alike."""

    def __init__(self, size: tuple[int, int], settings: Path) -> None:
        """`size` is that of the window when it opens [pixels]; `settings` is the toolkit's file of places."""
        self.window_size = size
        self._first_place = Place(MARGIN, MARGIN, WIDTH, min(HEIGHT, size[1] - 2 * MARGIN))
        self._settings = settings
        self._moved = ""  # the slider that was moved last

    @property
    def place(self) -> Place:
        """Where the panel is; some seconds behind the user who moves it."""
        return saved_place(self._settings, NAME) or self._first_place

    def shift(self, size: tuple[int, int]) -> float:
        """How far right of the middle the picture belongs, to be in the middle of what is left free [heights]."""
        return self._first_place.right / 2 / size[1]

    def draw(self, gui: Any, session: Session, numbers: str) -> bool:
        """Declares every widget for this frame; True if one of them was used."""
        place, (width, height) = self._first_place, self.window_size
        used = False
        with gui.sub_window(NAME, place.left / width, place.top / height, place.width / width, place.height / height):
            used |= obey(gui, session, switches=[("freeze", "Freeze", session.frozen)], buttons=buttons(session))
            show = {"Sliders": self._sliders, "Stages": self._stages, "Numbers": self._numbers, "Keys": self._keys}
            used |= show[session.page](gui, session, numbers)
            for line in wrapped(session.note):
                gui.text(line, color=WARNING)
            if session.page != "Numbers":
                for line in numbers.splitlines()[:SHORT]:
                    gui.text(line)
            if session.curves:
                gui.text(f"curves of the last {curves.SPAN:g} s:")
                for line, colour in curves.legend(session.history.rows):
                    gui.text(line, color=colour)
        return used

    # -- pages: each declares its widgets, and tells whether one was used --------------------------------

    def _sliders(self, gui: Any, session: Session, numbers: str) -> bool:
        """Every live parameter, the hand, and what the one is that was moved last."""
        used = False
        keys = live_keys(session.simulation.scene)
        for key in keys.values():
            if slide(gui, session, key):
                used, self._moved = True, key.name
        radius = gui.slider_float("Hand [m]", session.radius, 0.0, session.largest_radius)
        if differ(radius, session.radius):
            session.radius = min(max(radius, 0.0), session.largest_radius)
            used, self._moved = True, HAND
        used |= obey(gui, session, buttons=[("own_values", "Scene's values")])
        for line in wrapped(help_for(self._moved, keys)):
            gui.text(line)
        return used

    def _stages(self, gui: Any, session: Session, numbers: str) -> bool:
        """What is simulated, of what and by which method; how it is shown; which scene."""
        simulation = session.simulation
        times = session.stage_times
        wind = simulation.scene.wind and [("wind", with_cost("wind", times), bool(simulation.get("wind")))]
        used = obey(gui, session, switches=wind or ())
        before = session.stages
        after = {name: gui.checkbox(with_cost(name, times), on) for name, on in before.items()}
        if after != before:
            session.ask_to_switch(after)
            used = True
        used |= obey(gui, session, buttons=[("time_stages", "Time the stages"), *CHOICES])
        if times:
            gui.text(f"from frame {times.frame} on a frame took {times.ms:.2f} ms")
        for line in (*wrapped(simulation.method), f"fabric: {simulation.scene.fabric.preset or 'of the scene'}"):
            gui.text(line)
        return used

    def _numbers(self, gui: Any, session: Session, numbers: str) -> bool:
        """All figures."""
        for line in numbers.splitlines():
            gui.text(line)
        return obey(gui, session, switches=[("curves", "Curves", session.curves)])

    def _keys(self, gui: Any, session: Session, numbers: str) -> bool:
        """What keys and mouse do."""
        for line in help_lines():
            gui.text(line)
        return False


Switches = Sequence[tuple[str, str, bool]]  # action, label, state
Buttons = Sequence[tuple[str, str]]  # action, label


def obey(gui: Any, session: Session, switches: Switches = (), buttons: Buttons = ()) -> bool:
    """Declares switches and buttons and does what is asked; True if one was used."""
    asked = [action for action, label, before in switches if gui.checkbox(label, before) != before]
    asked += [action for action, label in buttons if gui.button(label)]
    for action in asked:
        session.ask(action)
    return bool(asked)


def with_cost(stage: str, times: StageTimes | None) -> str:
    """The label of a stage, with what it costs where that was measured."""
    label = words(stage).capitalize()
    return f"{label} {times.less[stage]:+.2f} ms" if times and stage in times.less else label


def help_for(name: str, keys: Mapping[str, LiveKey]) -> str:
    """What a slider is for."""
    if name == HAND:
        return HAND_HELP
    if name not in keys:
        return FIRST_HELP
    key = keys[name]
    unit = f" {key.unit}" if key.unit else ""
    return f"{key.label}: {key.help}; {key.low:g} to {key.high:g}{unit}, of this scene {key.value:g}"


def slide(gui: Any, session: Session, key: LiveKey) -> bool:
    """A slider for one live parameter; True if the user moved it."""
    label = f"{key.label} [{key.unit}]" if key.unit else key.label
    before = session.simulation.get(key.name)
    slider = gui.slider_int if key.is_int else gui.slider_float
    after = slider(label, before, key.low, key.high)
    if not differ(after, before):
        return False
    session.simulation.set(key.name, min(max(after, key.low), key.high))
    return True


def differ(after: float, before: float) -> bool:
    """Whether the user moved a slider. The toolkit answers in float32, and with what is typed after Ctrl+click."""
    return math.isfinite(after) and not math.isclose(after, before, rel_tol=1e-6, abs_tol=1e-9)


def buttons(session: Session) -> Buttons:
    """Those on every page."""
    next_page = PAGES[(PAGES.index(session.page) + 1) % len(PAGES)]
    return [("step", "Step"), ("reset", "Reset"), ("page", f"{session.page} > {next_page}")]


def wrapped(text: str) -> list[str]:
    """Lines that are as wide as the panel."""
    return textwrap.wrap(text, LETTERS, subsequent_indent="  ")


def numbers(session: Session, draw_ms: float, pictures: float, drawing: str = "drawing") -> str:
    """The lines that tell how fast and how right the picture is.

    `pictures` were shown in a second; each took `draw_ms` [ms] of `drawing`.

    The first `SHORT` stand on every page.
    """
    simulation, measures, topology = session.simulation, session.measures, session.simulation.topology
    physics, shown, measuring = (f"{t:.{int(t < 10)}f}" for t in (session.physics_ms, draw_ms, session.measuring_ms))
    strain, mean = 100 * measures.max_strain, 100 * measures.mean_strain
    lines = (
        f"{simulation.scene.name} · {session.view} · frame {simulation.frame} · {pictures:.0f} fps",
        f"physics {physics} + {drawing} {shown} + measuring {measuring} of {1e3 * FRAME_SECONDS:.1f} ms",
        f"strain: max {strain:.1f} %, mean {mean:.1f} %; {error_of(simulation)}",
        f"energy: kinetic {measures.kinetic_energy:.3g} J, of height {measures.potential_energy:.3g} J",
        f"deepest in a collider: {1e3 * measures.penetration:.3g} mm",
        *([] if measures.crossings is None else [f"{measures.crossings} edges through the cloth itself"]),
        f"{simulation.method}: {' '.join(simulation.stages)}",
        f"{topology.particle_count} particles, {topology.spring_count} springs, {topology.pinned.sum()} pins",
        *filter(None, [simulation.advice]),
    )
    return "\n".join("\n".join(wrapped(line)) for line in lines)


def error_of(s: Simulation) -> str:
    """What the running setting is wrong by in a swing, in % of the side, as far as it is known."""
    error = estimate(s.scene, s.solver.name, s.substeps, int(s.get("iterations")), s.get("gravity"))
    if error is None:
        return "error unknown"
    # What a swing of one sheet is wrong by says nothing of another scene beyond this.
    return f"error about {100 * error:.2g} %" if error >= LEAST_ERROR else f"error below {100 * LEAST_ERROR:g} %"


def help_lines() -> list[str]:
    """Every key and mouse drag, two to a line."""
    entries = [f"{key.label:5} {key.help}" for key in KEYS if key.code not in ARROWS] + ["arrows: move the view"]
    entries += [f"{drag}: {help}" for drag, help in MOUSE]
    half = (len(entries) + 1) // 2
    return [f"{a:{COLUMN}} {b}" for a, b in zip(entries[:half], [*entries[half:], ""], strict=False)]
