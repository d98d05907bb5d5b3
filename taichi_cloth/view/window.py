"""The window: a running scene to look at, to pull at and to steer."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable
from math import degrees
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol, TypeVar

import taichi as ti

from ..interact.camera import OrbitCamera
from ..interact.keys import KEYS
from ..simulation import Simulation
from .clock import FrameClock
from .curves import top
from .draw_curves import CurveDrawing
from .draw_mesh import DrawMesh
from .journal import Journal, line_of
from .legend import WindowScale
from .lighting import BACKGROUND
from .panel import Panel, numbers
from .session import Session

S = TypeVar("S", bound=Session)

TITLE = "taichi_cloth"
BUTTON_CODES = {"left": ti.ui.LMB, "middle": ti.ui.MMB, "right": ti.ui.RMB}
POSITION = (40, 40)  # [pixels] of the window's top left corner on the screen
NUMBERS_EVERY = 0.25  # [s] often enough to follow, seldom enough to read; a log measures every picture
LONGEST_HOLD = 0.1  # [s] a held key acts at most this long in one picture, whatever the picture took


def run(
    open_session: Callable[[], S],
    *,
    size: tuple[int, int] = (1280, 720),
    frames: int | None = None,
    log: Path | None = None,
    announce: Callable[[Simulation], None] = lambda simulation: None,
) -> S:
    """Opens a window on a session and returns when the user closes it, or after `frames` displayed frames.

    The session comes back, closed. Taichi must have been started, and `display.window_obstacle()` must have found
    nothing: Taichi ends the process where it cannot open a window. `announce` is called before the first frame.
    Raises OSError when the log cannot be written.
    """
    with contextlib.ExitStack() as stack:
        journal = stack.enter_context(Journal(log)) if log else None
        # The toolkit drops its settings, imgui.ini, into the working folder.
        folder = stack.enter_context(TemporaryDirectory(prefix="taichi_cloth_"))
        session = stack.enter_context(contextlib.closing(open_session()))
        session.draw_list.update(session.view, session.camera.eye)  # compiled before there is a window to stand empty
        announce(session.simulation)
        with contextlib.chdir(folder):
            window = ti.ui.Window(TITLE, size, vsync=True, pos=POSITION)
            try:
                loop(window, session, Panel(size, Path(folder) / "imgui.ini"), frames, journal)
            finally:
                window.destroy()  # before the fields go, and before Taichi does
        line = session.finish()
        if line:
            print(line, flush=True)
    return session


def loop(window: Any, session: Session, panel: Panel, frames: int | None, journal: Journal | None) -> None:
    """One turn for every picture: input, physics, drawing."""
    canvas, scene, gui, lens = window.get_canvas(), window.get_scene(), window.get_gui(), ti.ui.Camera()
    clock, curves, scale = FrameClock(time.perf_counter()), CurveDrawing(), WindowScale()
    draw_ms, displayed = 0.0, 0
    text, told, told_at = "", 0.0, 0
    while window.running and session.running and displayed != frames:
        now = time.perf_counter()
        due = clock.due(now)
        size = shape(window, panel.window_size)
        cursor = window.get_cursor_pos()

        if now - told > NUMBERS_EVERY:
            if not session.curves:
                session.measure()
            text = numbers(session, draw_ms, (displayed - told_at) / (now - told))
            told, told_at = now, displayed

        press_keys(window, session, min(clock.elapsed, LONGEST_HOLD))
        used = not session.hidden and panel.draw(gui, session, text)
        session.camera.zoom(wheel(window))
        session.camera.shift = 0.0 if session.hidden else panel.shift(size)
        on_panel = not session.hidden and panel.place.contains(cursor, size)
        session.point(cursor, held_buttons(window), size, on_panel=on_panel, widget_changed=used)
        session.advance(due)
        if session.curves or journal:
            session.measure()

        start = time.perf_counter()
        draw(canvas, scene, lens, session)
        if session.view == "strain":
            scale.show(canvas, size, top() if session.curves else 0.0)
        if session.curves:
            curves.draw(canvas, session.history, size[0] / size[1])
        draw_ms = 1e3 * (time.perf_counter() - start)
        if journal:
            journal.write(line_of(session, displayed, cursor, size[0] / size[1], draw_ms))
        window.show()
        displayed += 1
        session.do_asked()


class Obedient(Protocol):
    """What keys act on."""

    def ask(self, action: str) -> None: ...
    def hold(self, action: str, seconds: float) -> None: ...


def press_keys(window: Any, session: Obedient, seconds: float) -> None:
    """Does what the keys ask for that were struck since the last picture, or are held down."""
    struck = [event.key for event in window.get_events(ti.ui.PRESS)]
    for code in struck:
        for key in KEYS:
            if key.code == code and not key.held:
                session.ask(key.action)
    for key in KEYS:
        if key.held and window.is_pressed(key.code):
            session.hold(key.action, seconds)


def wheel(window: Any) -> float:
    """Notches the mouse wheel was turned since the last picture, forwards positive.

    Taichi 1.7.4 does not tell; a later one that has `get_scroll_delta` gives (dx, dy) since the last call.
    """
    return float(window.get_scroll_delta()[1]) if hasattr(window, "get_scroll_delta") else 0.0


def held_buttons(window: Any) -> frozenset[str]:
    return frozenset(name for name, code in BUTTON_CODES.items() if window.is_pressed(code))


def shape(window: Any, first: tuple[int, int]) -> tuple[int, int]:
    """Size of the window in the units of its panel. `first` is the size it was opened with."""
    width, height = window.get_window_shape()
    # On a Retina display the toolkit reports physical pixels, twice as many each way.
    scale = max(1, round(width / first[0])) if sys.platform == "darwin" else 1
    return width // scale, height // scale


def draw(canvas: Any, scene: Any, lens: Any, session: Session) -> None:
    """Hands the picture of a session to the toolkit."""
    mesh = session.draw_list.update(session.view, session.camera.eye)
    aim(lens, session.camera)
    scene.set_camera(lens)
    canvas.set_background_color(BACKGROUND)
    submit(scene, mesh)
    canvas.scene(scene)


def aim(lens: Any, camera: OrbitCamera) -> None:
    """Sets the toolkit's camera so that it takes the same picture."""
    lens.position(*camera.eye)
    lens.lookat(*camera.looks_at)
    lens.up(0.0, 1.0, 0.0)
    lens.fov(degrees(camera.fov))


def submit(scene: Any, mesh: DrawMesh) -> None:
    """The soup as it is: its colours have their light in them."""
    scene.ambient_light((1.0, 1.0, 1.0))
    scene.mesh(mesh.position, normals=mesh.normal, per_vertex_color=mesh.colour, vertex_count=mesh.corners)
