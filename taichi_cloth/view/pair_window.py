"""The window of `compare`: two scenes side by side. The rasteriser draws both, since the toolkit has one camera."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import taichi as ti

from ..interact.keys import KEYS
from ..scene import live_keys
from .clock import FrameClock
from .journal import Journal
from .pair import BOTH, ONE, Pair
from .panel import LETTERS, MARGIN, WARNING, WIDTH, differ, error_of, wrapped
from .panel_place import Place, saved_place
from .session import Session
from .sides import TwoPictures
from .window import LONGEST_HOLD, NUMBERS_EVERY, POSITION, TITLE, held_buttons, press_keys, shape

NAME = "compare"
HEIGHT = 560  # [pixels] of the panel
BAND = WIDTH + 2 * MARGIN  # [pixels] at the left, where the panel is and no picture
BAND_COLOUR = 40  # of 255
LEAST = 2 * 100  # [pixels] that both pictures have at least, however narrow the window


def run(open_pair: Callable[[], Pair], *, size: tuple[int, int], frames: int | None, log: Path | None) -> None:
    """Opens a window on a pair and returns when the user closes it, or after `frames` displayed frames.

    As for `window.run`: Taichi must have been started, and there must be a display. Raises OSError for a log that
    cannot be written.
    """
    with contextlib.ExitStack() as stack:
        journal = stack.enter_context(Journal(log)) if log else None
        folder = stack.enter_context(TemporaryDirectory(prefix="taichi_cloth_"))
        pair = stack.enter_context(contextlib.closing(open_pair()))
        stack.enter_context(contextlib.chdir(folder))
        window = ti.ui.Window(TITLE, size, vsync=True, pos=POSITION)
        stack.callback(window.destroy)  # before the fields go
        loop(window, pair, PairPanel(size, Path(folder) / "imgui.ini"), frames, journal)


def loop(window: Any, pair: Pair, panel: PairPanel, frames: int | None, journal: Journal | None) -> None:
    """One turn for every picture: input, physics, drawing."""
    canvas, gui, clock = window.get_canvas(), window.get_gui(), FrameClock(time.perf_counter())
    drawn, pictures = (0, 0), None  # for which size
    lines: list[str] = []
    displayed, told, draw_ms = 0, 0.0, 0.0
    while window.running and pair.running and displayed != frames:
        now = time.perf_counter()
        due = clock.due(now)
        size, cursor = shape(window, panel.window_size), window.get_cursor_pos()
        if now - told > NUMBERS_EVERY:
            pair.measure()
            lines, told = figures(pair, draw_ms), now
        used = not pair.hidden and panel.draw(gui, pair, lines)
        press_keys(window, pair, min(clock.elapsed, LONGEST_HOLD))
        band = 0 if pair.hidden else band_of(size)
        both = size[0] - band, size[1]
        at = (cursor[0] * size[0] - band) / both[0], cursor[1]
        on_panel = at[0] < 0 or (not pair.hidden and panel.place.contains(cursor, size))
        pair.point(at, held_buttons(window), both, on_panel=on_panel, widget_changed=used)
        pair.advance(due)

        start = time.perf_counter()
        if pictures is None or both != drawn:
            pictures, drawn = TwoPictures(*both, samples=1), both
            image = np.full((*size, 3), BAND_COLOUR, np.uint8)  # the toolkit counts from the bottom left
        image[band:] = pictures.draw(pair.draw_lists, pair.view, pair.left.camera).transpose(1, 0, 2)[:, ::-1]
        canvas.set_image(image)
        draw_ms = 1e3 * (time.perf_counter() - start)
        if journal:
            pair.measure()
            journal.write({"cursor": list(cursor)} | line_of(pair, displayed, both, band))
        window.show()
        displayed += 1
        pair.do_asked()


def band_of(size: tuple[int, int]) -> int:
    """How much of a window of so many pixels is the panel's."""
    return max(0, min(BAND, size[0] - LEAST))


def aspect_of(size: tuple[int, int]) -> float:
    """Width over height of a half, in a window of so many pixels that has its panel."""
    return (size[0] - band_of(size)) / 2 / size[1]


class PairPanel:
    """Sliders that act on both, and the figures of each."""

    def __init__(self, size: tuple[int, int], settings: Path) -> None:
        """As for `panel.Panel`."""
        self.window_size = size
        self._first_place = Place(MARGIN, MARGIN, WIDTH, min(HEIGHT, size[1] - 2 * MARGIN))
        self._settings = settings

    @property
    def place(self) -> Place:
        """Where the panel is; some seconds behind the user who moves it."""
        return saved_place(self._settings, NAME) or self._first_place

    def draw(self, gui: Any, pair: Pair, lines: list[str]) -> bool:
        """Declares every widget for this frame; True if one of them was used."""
        place, (width, height) = self._first_place, self.window_size
        used = False
        with gui.sub_window(NAME, place.left / width, place.top / height, place.width / width, place.height / height):
            for name, key in live_keys(pair.left.simulation.scene).items():
                if name in ("substeps", "iterations"):  # each side has its own
                    continue
                before = pair.left.simulation.get(name)
                label = f"{key.label} [{key.unit}]" if key.unit else key.label
                after = gui.slider_float(label, before, key.low, key.high)
                if differ(after, before):
                    pair.set(name, min(max(after, key.low), key.high))
                    used = True
            for label in ("Freeze", "Step", "Reset", "View"):
                if gui.button(label):
                    pair.act(label.lower())
                    used = True
            for line in lines:
                gui.text(line)
            for line in wrapped(pair.note):
                gui.text(line, color=WARNING)
            for line in help_lines():
                gui.text(line)
        return used


def help_lines() -> list[str]:
    """Keys for both sides, and those for the one under the cursor."""
    found = []
    for what, actions in (("both", BOTH), ("the side under the cursor", ONE)):
        keys = ", ".join(f"{key.label} {key.help}" for key in KEYS if key.action in actions)
        found += wrapped(f"{what}: {keys}")
    return found


def figures(pair: Pair, draw_ms: float) -> list[str]:
    """What there is to say of both."""
    found = [line for name, side in zip(("left", "right"), pair.sides, strict=True) for line in of_side(name, side)]
    return [*found, f"apart: {pair.apart:.2%} of the side", f"drawing both: {draw_ms:.1f} ms"]


def of_side(name: str, side: Session) -> list[str]:
    simulation, measures = side.simulation, side.measures
    return [
        *wrapped(f"{name}: {simulation.method}"),
        f"  {side.physics_ms:.1f} ms, strain {100 * measures.max_strain:.1f} %, {error_of(simulation)}"[:LETTERS],
    ]


def line_of(pair: Pair, displayed: int, both: tuple[int, int], band: int) -> dict[str, Any]:
    """What there is to say of one picture, for `--log`: `both` have so many pixels, right of a band [pixels]."""
    aspect = both[0] / 2 / both[1]
    sides = []
    for k, side in enumerate(pair.sides):
        simulation = side.simulation
        held = simulation.grabbed
        particle = None
        if held is not None:
            u, v = side.camera.to_screen(simulation.positions()[held], aspect)[0][0].tolist()
            particle = [(band + both[0] * (u + k) / 2) / (band + both[0]), v]
        sides.append(
            {
                "solver": simulation.solver.name,
                "frame": simulation.frame,
                "grabbed": held,
                "particle": particle,
                "physics_ms": round(side.physics_ms, 3),
                "max_strain": side.measures.max_strain,
                "live": {name: simulation.get(name) for name in live_keys(simulation.scene)},
            }
        )
    whole = {"displayed": displayed, "mouse": pair.mouse, "apart": pair.apart, "frozen": pair.left.frozen}
    return {**whole, "sides": sides}
