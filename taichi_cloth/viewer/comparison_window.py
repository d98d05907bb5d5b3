"""The window of a comparison: both halves, a panel with sliders for both sides, and the statistics of each.

The software rasterizer draws both halves, since the UI toolkit supports only one camera.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import taichi as ti

from ..render.split_view import SplitRenderer
from ..scene import parameters_of
from ..simulation.frame_clock import FrameClock
from .charts import blown_up_line, milliseconds
from .comparison import SHARED_ACTIONS, SIDE_ACTIONS, WINDOW_ACTIONS, Comparison
from .error_process import error_lines
from .input import OWN_FABRIC, SHORTCUTS
from .panel import (
    HIDDEN_TITLE,
    NOTE_COLORS,
    PANEL_MARGIN,
    PANEL_WIDTH,
    acting_parameters,
    draw_caption,
    draw_slider,
    slider_parameters,
    wrap,
    wrapped_lines,
)
from .session import Session
from .toolkit import PanelRect, Progress, has_changed, saved_panel_rect, sub_window
from .window import (
    MAX_HOLD_SECONDS,
    STATISTICS_EVERY,
    STILL_FRAMES,
    WINDOW_POSITION,
    WINDOW_TITLE,
    FrameLog,
    Idle,
    held_buttons,
    press_keys,
    pressed_keys,
    window_size,
)

ORDER_NOTE = "errors of frames add up or cancel: over 1 s the other side is nearer to the springs of the fabric"
VERLET_NOTE = (
    "verlet: more iterations stretch the cloth less, and may move it away from these springs (docs/frame_error.md)"
)
MAX_APART = 60  # frames between the errors of both sides, up to which they are compared without a warning
NAME = "compare"
SIDES = "left", "right"
SETTING = "substeps", "iterations"  # of each side's solver; all other sliders act on both sides
HEIGHT = 700  # [pixels] of the panel
BAND = PANEL_WIDTH + 2 * PANEL_MARGIN  # [pixels] column at the left that shows the panel and no image
BAND_COLOR = 40  # of 255
MIN_WIDTH = 2 * 100  # [pixels] minimum width of both images together, however narrow the window


# -- window ------------------------------------------------------------------------------------------------------------


def run(open_pair: Callable[[], Comparison], *, size: tuple[int, int], frames: int | None, log: Path | None) -> None:
    """Open a window on a comparison. Return when the user closes it, or after `frames` displayed frames.

    `open_pair` makes the comparison. `size`: of the window [pixels]. Taichi must have been started, and a display must
    be available (`toolkit.window_obstacle`). Raises OSError if `log` cannot be written.
    """
    with contextlib.ExitStack() as stack:
        frame_log = stack.enter_context(FrameLog(log)) if log else None
        folder = stack.enter_context(TemporaryDirectory(prefix="taichi_cloth_"))
        comparison = stack.enter_context(contextlib.closing(open_pair()))
        stack.enter_context(contextlib.chdir(folder))
        for letter, side in zip("ab", comparison.sides, strict=True):
            print(f"{letter}: {side.simulation.scene.name} · {side.simulation.method}", flush=True)
        window = ti.ui.Window(WINDOW_TITLE, size, vsync=True, pos=WINDOW_POSITION)
        stack.callback(window.destroy)  # before the Taichi fields are released
        loop(window, comparison, ComparisonPanel(size, Path(folder) / "imgui.ini"), frames, frame_log)


def loop(
    window: ti.ui.Window, comparison: Comparison, panel: ComparisonPanel, frames: int | None, frame_log: FrameLog | None
) -> None:
    """Process input, simulate and draw, once for every displayed frame."""
    canvas, gui, clock = window.get_canvas(), window.get_gui(), FrameClock(time.perf_counter())
    rendered_size, renderer = ((0, 0), 0), None  # of the window and the panel's column, that the renderer was made for
    lines: list[str] = []
    displayed, updated, draw_ms, idle = 0, 0.0, 0.0, Idle()
    compiling = Progress("compiling: the first frames take seconds")
    comparison.left.note = comparison.left.note or compiling
    while window.running and comparison.running and displayed != frames:
        now = time.perf_counter()
        due = clock.due(now) if displayed >= STILL_FRAMES else 0
        keys = pressed_keys(window)
        size, cursor = window_size(window, panel.window_size), window.get_cursor_pos()
        if idle.has_nothing_new(now, comparison.left, (size, cursor, held_buttons(window), keys, comparison.note)):
            continue
        if now - updated > STATISTICS_EVERY:
            comparison.measure()
            lines, updated = statistics(comparison, draw_ms), now
        widget_used = not comparison.hidden and panel.draw(gui, comparison, lines)
        if comparison.hidden and comparison.note:
            draw_caption(gui, panel.window_size, HIDDEN_TITLE, [comparison.note])
        band = 0 if comparison.hidden else band_of(size)
        image_size = size[0] - band, size[1]
        point = (cursor[0] * size[0] - band) / image_size[0], cursor[1]
        on_panel = point[0] < 0 or (not comparison.hidden and panel.place.contains(cursor, size))
        comparison.on_pointer(point, held_buttons(window), image_size, on_panel=on_panel, widget_changed=widget_used)
        press_keys(window, comparison, keys, min(clock.elapsed, MAX_HOLD_SECONDS))  # on the side where the mouse is now
        comparison.advance(due)
        if due > 0 and comparison.left.note is compiling:
            comparison.left.note = ""

        start = time.perf_counter()
        if renderer is None or (size, band) != rendered_size:
            renderer, rendered_size = SplitRenderer(*image_size, samples=1), (size, band)
            image = np.full((*size, 3), BAND_COLOR, np.uint8)  # the toolkit's origin is the bottom left
        comparison.image = renderer.draw(comparison.draw_lists, comparison.view, comparison.left.camera)
        image[band:] = comparison.image.transpose(1, 0, 2)[:, ::-1]
        canvas.set_image(image)
        draw_ms = 1e3 * (time.perf_counter() - start)
        if frame_log:
            comparison.measure()
            frame_log.write({"cursor": list(cursor)} | line_of(comparison, displayed, image_size, band))
        window.show()
        displayed += 1
        comparison.run_deferred()


def band_of(size: tuple[int, int]) -> int:
    """Return the width of the panel's column in a window of `size` [pixels]."""
    return max(0, min(BAND, size[0] - MIN_WIDTH))


def aspect_of(size: tuple[int, int]) -> float:
    """Return width over height of one half, in a window of `size` [pixels] that shows its panel."""
    return (size[0] - band_of(size)) / 2 / size[1]


# -- panel -------------------------------------------------------------------------------------------------------------


class ComparisonPanel:
    """The panel of a comparison: sliders for both sides or for the solver of each, and statistics of each side."""

    def __init__(self, size: tuple[int, int], settings: Path) -> None:
        """`size`: of the window when it opens [pixels]. `settings`: the toolkit's imgui.ini."""
        self.window_size = size
        self._initial_place = PanelRect(
            PANEL_MARGIN, PANEL_MARGIN, PANEL_WIDTH, min(HEIGHT, size[1] - 2 * PANEL_MARGIN)
        )
        self._settings = settings

    @property
    def place(self) -> PanelRect:
        """The panel's rectangle. If the user moves the panel, the value follows some seconds later."""
        return saved_panel_rect(self._settings, NAME) or self._initial_place

    def draw(self, gui: ti.ui.Gui, comparison: Comparison, lines: list[str]) -> bool:
        """Declare all widgets for this frame. Return whether the user changed one. `lines`: of `statistics`."""
        with sub_window(gui, NAME, self._initial_place, self.window_size):
            draw_sliders = draw_setting_sliders if comparison.shows_settings else draw_shared_sliders
            changed = draw_sliders(gui, comparison)
            is_frozen, other = comparison.left.frozen, "both sides" if comparison.shows_settings else "each solver"
            freeze = {"Resume": "freeze", "Step": "step"} if is_frozen else {"Freeze": "freeze"}
            for label, action in {**freeze, "Reset": "reset", "View": "view", f"Sliders for {other}": "page"}.items():
                if gui.button(label):
                    comparison.act(action)
                    changed = True
            if is_frozen:
                gui.text("frozen: Space resumes", color=NOTE_COLORS[Progress])
            for line in wrap(comparison.note):
                gui.text(line, color=NOTE_COLORS[type(comparison.note)])
            for line in help_lines() if comparison.shows_keys else [*lines, *wrap(short_help())]:
                gui.text(line)
        return changed


def draw_setting_sliders(gui: ti.ui.Gui, comparison: Comparison) -> bool:
    """Declare the sliders for the solver of each side. Return whether the user moved one."""
    changed = False
    for name, side in zip(SIDES, comparison.sides, strict=True):
        for key in acting_parameters(side.simulation).values():
            if key.name in SETTING:
                changed |= draw_slider(gui, side, key, f"{name}: ")
    return changed


def draw_shared_sliders(gui: ti.ui.Gui, comparison: Comparison) -> bool:
    """Declare the sliders that act on both sides. Return whether the user moved one."""
    changed = False
    for name, key in slider_parameters(comparison.left.simulation).items():
        if name in SETTING:
            continue
        before = comparison.left.simulation.params[name]
        label = f"{key.label} [{key.unit}]" if key.unit else key.label
        after = gui.slider_float(label, before, key.slider_min, key.slider_max)
        if has_changed(after, before):
            comparison.set_parameter(name, min(max(after, key.slider_min), key.slider_max))
            changed = True
    return changed


SCOPES = {"both sides": SHARED_ACTIONS, "side under the cursor": SIDE_ACTIONS, "window": WINDOW_ACTIONS}


def help_lines() -> list[str]:
    """Return the keys with what they do, by what they act on."""
    lines = []
    for scope, actions in SCOPES.items():
        lines += [f"{scope}:", *(f"  {key.label:6} {key.help}" for key in SHORTCUTS if key.action in actions)]
    return [*lines, "  I, O, arrows: camera", "A: statistics"]


def short_help() -> str:
    """Return the keys that act on one side, and the one that lists all."""
    keys = ", ".join(key.label for key in SHORTCUTS if key.action in SIDE_ACTIONS)
    return f"A: list of keys; {keys} act on the side under the cursor"


def statistics(comparison: Comparison, draw_ms: float) -> list[str]:
    """Return lines of text with the statistics of both sides. `draw_ms`: time to draw both [ms]."""
    lines = [line for name, side in zip(SIDES, comparison.sides, strict=True) for line in side_statistics(name, side)]
    distance = f"{comparison.rms_distance:.2%} of the cloth's side"
    frame = f"frame {comparison.left.simulation.frame}: RMS distance {distance}"
    notes = [frame, apart(comparison), *explanations(comparison)]
    return [*lines, *wrapped_lines(notes), f"view: {comparison.view}, drawing: {draw_ms:.1f} ms"]


def apart(comparison: Comparison) -> str:
    """Return a line if the errors of both sides are of frames more than `MAX_APART` apart; empty if not."""
    frames = [side.frame_error.frame for side in comparison.sides if side.frame_error]
    if len(frames) < 2 or abs(frames[0] - frames[1]) <= MAX_APART:
        return ""
    return f"the errors are of frames {abs(frames[0] - frames[1])} apart"


def explanations(comparison: Comparison) -> list[str]:
    """Return lines about errors that seem to contradict each other: of a frame and over a second, and of `verlet`."""
    answers = [side.meter.answer for side in comparison.sides if side.meter and side.meter.answer]
    known = [(one.error.error, one.growth) for one in answers if one.error and one.growth]
    lines = []
    if len(known) == 2 and (known[0][0] < known[1][0]) != (known[0][1] < known[1][1]):
        lines.append(ORDER_NOTE)
    is_verlet = any(side.simulation.solver.name == "verlet" for side in comparison.sides)
    return [*lines, VERLET_NOTE] if answers and is_verlet else lines


def side_statistics(name: str, side: Session) -> list[str]:
    """Return lines of text with the solver, time, strain and error of one side."""
    simulation, metrics = side.simulation, side.metrics
    error, *parts = error_lines(side.meter, frozen=side.frozen)
    errors = [error, *(parts if side.view == "error" else parts[1:])]  # colors show the largest error of a particle
    return [
        *wrap(f"{name}: {simulation.method} · {simulation.scene.fabric.preset or OWN_FABRIC}"),
        f"  {milliseconds(side.physics_ms)} ms, strain {100 * metrics.max_strain:.1f} %",
        *(part for line in [*errors, blown_up_line(side)] if line for part in wrap(f"  {line.strip()}")),
    ]


def line_of(comparison: Comparison, displayed: int, image_size: tuple[int, int], band: int) -> dict[str, object]:
    """Return the `--log` entry of one displayed frame.

    `image_size`: of both images together [pixels]. `band`: width of the panel's column at their left [pixels].
    """
    aspect = image_size[0] / 2 / image_size[1]
    sides = []
    for k, side in enumerate(comparison.sides):
        simulation = side.simulation
        grabbed = next(iter(simulation.grabbed.tolist()), None)  # the particle grabbed first
        particle = None
        if grabbed is not None:
            u, v = side.camera.to_screen(simulation.positions()[grabbed], aspect)[0][0].tolist()
            particle = [(band + image_size[0] * (u + k) / 2) / (band + image_size[0]), v]
        sides.append(
            {
                "solver": simulation.solver.name,
                "frame": simulation.frame,
                "grabbed": grabbed,
                "particle": particle,
                "physics_ms": round(side.physics_ms, 3),
                "max_strain": side.metrics.max_strain,
                "parameters": {name: simulation.params[name] for name in parameters_of(simulation.scene)},
            }
        )
    shared = {
        "displayed": displayed,
        "mouse": comparison.mouse,
        "rms_distance": comparison.rms_distance,
        "frozen": comparison.left.frozen,
    }
    return {**shared, "sides": sides}
