"""The panel: sliders, switches and buttons, numbers, and the keys."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..interact.keys import ARROWS, KEYS, MOUSE
from ..measure.estimate import estimate
from ..scene.live import LiveKey, live_keys
from ..scene.model import FRAME_SECONDS
from ..simulation import Simulation
from .panel_place import Place, saved_place
from .session import Session

NAME = "taichi_cloth"
MARGIN = 10  # [pixels]
WIDTH = 392  # [pixels] a slider takes 65 % of it and leaves 17 letters for its label
HEIGHT = 697  # [pixels] of all that is below
LETTERS = (WIDTH - 2 * 8) // 7  # in a line: the toolkit's padding is 8 pixels, every letter 7 pixels wide
COLUMN = 25  # [letters]


class Panel:
    """Draws the panel of a session and obeys it. A widget's label is its identity: no two are alike."""

    def __init__(self, size: tuple[int, int], settings: Path) -> None:
        """`size` is that of the window when it opens [pixels]; `settings` is the toolkit's file of places."""
        self.window_size = size
        self._first_place = Place(MARGIN, MARGIN, WIDTH, min(HEIGHT, size[1] - 2 * MARGIN))
        self._settings = settings

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
            for key in live_keys(session.simulation.scene).values():
                used |= slide(gui, session, key)
            for action, label, before in switches(session):
                if gui.checkbox(label, before) != before:
                    session.act(action)
                    used = True
            for action, label in buttons(session):
                if gui.button(label):
                    session.act(action)
                    used = True
            for line in numbers.splitlines():
                gui.text(line)
            for line in textwrap.wrap(session.note, LETTERS) or [
                ""
            ]:  # an empty line: the keys below stay where they are
                gui.text(line, color=(1.0, 0.6, 0.3))
            for line in help_lines():
                gui.text(line)
        return used


def slide(gui: Any, session: Session, key: LiveKey) -> bool:
    """A slider for one live parameter; True if the user moved it."""
    label = f"{key.label} [{key.unit}]" if key.unit else key.label
    before = session.simulation.get(key.name)
    slider = gui.slider_int if key.is_int else gui.slider_float
    after = slider(label, before, key.low, key.high)
    # The toolkit answers in float32, and with what a user types after Ctrl+click.
    if math.isclose(after, before, rel_tol=1e-6, abs_tol=1e-9) or not math.isfinite(after):
        return False
    session.simulation.set(key.name, min(max(after, key.low), key.high))
    return True


def switches(session: Session) -> Iterator[tuple[str, str, bool]]:
    """Action, label and state of every switch."""
    yield "freeze", "Freeze", session.frozen
    if session.simulation.scene.wind is not None:
        yield "wind", "Wind", bool(session.simulation.get("wind"))


def buttons(session: Session) -> Iterator[tuple[str, str]]:
    """Action and label of every button."""
    yield "step", "Step"
    yield "reset", "Reset"
    yield "view", "Next view"
    yield "solver", "Next solver"
    yield "previous_scene", "Previous scene"
    yield "next_scene", "Next scene"


def numbers(session: Session, draw_ms: float, pictures: float) -> str:
    """The lines that tell how fast and how right the picture is; `pictures` were shown in a second."""
    simulation, measures = session.simulation, session.measures
    budget = 1e3 * FRAME_SECONDS
    strain, mean = 100 * measures.max_strain, 100 * measures.mean_strain
    lines = (
        f"{simulation.scene.name} · {session.view} · frame {simulation.frame} · {pictures:.0f} fps",
        f"physics {session.physics_ms:.1f} + drawing {draw_ms:.1f} of {budget:.1f} ms",
        f"strain: max {strain:.1f} %, mean {mean:.1f} %; {error_of(simulation)}",
        *([] if measures.crossings is None else [f"{measures.crossings} edges through the cloth itself"]),
        f"{simulation.method}: {' '.join(simulation.stages)}",
        *filter(None, [simulation.advice]),
    )
    return "\n".join(textwrap.fill(line, LETTERS, subsequent_indent="  ") for line in lines)


def error_of(s: Simulation) -> str:
    """What the running setting is wrong by in a swing, in % of the side, as far as it is known."""
    error = estimate(s.scene, s.solver.name, s.substeps, int(s.get("iterations")), s.get("gravity"))
    return "error unknown" if error is None else f"error about {100 * error:.2g} %"


def help_lines() -> list[str]:
    """Every key and mouse drag, two to a line."""
    entries = [f"{key.label:5} {key.help}" for key in KEYS if key.code not in ARROWS] + ["arrows: move the view"]
    entries += [f"{drag}: {help}" for drag, help in MOUSE]
    half = (len(entries) + 1) // 2
    return [f"{a:{COLUMN}} {b}" for a, b in zip(entries[:half], [*entries[half:], ""], strict=False)]
