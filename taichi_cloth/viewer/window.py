"""The window: shows a running scene, and passes mouse and keyboard input to its session.

`--log FILE` writes one line of JSON for every displayed frame.
"""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Callable
from math import degrees
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Protocol, TextIO, TypeVar

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..render.camera import OrbitCamera
from ..render.colors import WindowLegend
from ..render.draw_list import DrawMesh
from ..render.shading import BACKGROUND
from ..scene.parameters import parameters_of
from ..simulation.frame_clock import FrameClock
from ..simulation.simulation import Simulation
from ..system import taichi_runtime as runtime
from .charts import CurveDrawing, statistics, top
from .input import HELP, SHORTCUTS, SPEEDS
from .panel import HIDDEN_TITLE, Panel, draw_caption, draw_gray_reason
from .session import Session
from .toolkit import Progress, Refusal


class FrameLog:
    """Writes entries to a file and flushes each of them, so that another program can follow the file.

    Raises OSError if the file cannot be opened or written.
    """

    def __init__(self, path: Path) -> None:
        self._file: TextIO = path.open("w", encoding="utf-8")

    def write(self, line: dict[str, object]) -> None:
        """Write one entry as a line of JSON. Raises OSError."""
        self._file.write(json.dumps(line) + "\n")
        self._file.flush()

    def __enter__(self) -> FrameLog:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._file.close()


def line_of(
    session: Session, displayed: int, cursor: tuple[float, float], aspect: float, draw_ms: float
) -> dict[str, object]:
    """Return the entry of one displayed frame.

    `displayed`: its number. `cursor`: the mouse, a screen point from (0, 0) at the bottom left to (1, 1). `aspect`:
    width over height of the window. `draw_ms`: time to draw it [ms].
    """
    simulation, camera, metrics = session.simulation, session.camera, session.metrics
    grabbed = next(iter(simulation.grabbed.tolist()), None)  # the particle grabbed first
    particle = None if grabbed is None else camera.to_screen(simulation.positions()[grabbed], aspect)[0][0].tolist()
    return {
        "displayed": displayed,
        "scene": simulation.scene.name,
        "solver": simulation.solver.name,
        "frame": simulation.frame,
        "physics_ms": round(session.physics_ms, 3),
        "draw_ms": round(draw_ms, 3),
        "max_strain": metrics.max_strain,
        "mean_strain": metrics.mean_strain,
        "view": session.view,
        "frozen": session.frozen,
        "panel": not session.hidden,
        "page": session.page,
        "charts": session.charts,
        "grab_radius": session.grab_radius,
        "fabric": simulation.scene.fabric.preset,
        "features": simulation.features,
        "mouse": session.pointer.owner.value,
        "cursor": list(cursor),
        "grabbed": grabbed,
        "grabbed_count": len(simulation.grabbed),
        "added_pins": simulation.added_pins.tolist(),
        "particle": particle,
        "eye": list(camera.eye),
        "target": camera.target.tolist(),
        "wind": simulation.params["wind"],
        "parameters": {name: simulation.params[name] for name in parameters_of(simulation.scene)},
        "frame_error": session.frame_error and session.frame_error.error,
    }


# -- memory ------------------------------------------------------------------------------------------------------------

MEMORY_STEP = 10**9  # [bytes]


class MemoryWatch:
    """Warns when memory has grown by a gigabyte: with a software Vulkan driver each displayed frame takes some."""

    def __init__(self) -> None:
        self._next = (runtime.peak_bytes() or 0) + MEMORY_STEP

    def warning(self) -> str:
        """Return a line for the user once per gigabyte, or an empty one."""
        used = runtime.peak_bytes() or 0
        if used < self._next:
            return ""
        self._next = used + MEMORY_STEP
        return Refusal(
            f"memory has grown to {used / MEMORY_STEP:.1f} GB. With a software Vulkan driver it grows with every frame:"
            " close the window now and then"
        )


# -- window ------------------------------------------------------------------------------------------------------------

S = TypeVar("S", bound=Session)

WINDOW_TITLE = "taichi_cloth"
BUTTON_CODES = {"left": ti.ui.LMB, "middle": ti.ui.MMB, "right": ti.ui.RMB}
WINDOW_POSITION = (40, 40)  # [pixels] of the window's top left corner on the screen
STATISTICS_EVERY = 0.25  # [s] interval of the statistics: short enough to follow, long enough to read
MAX_HOLD_SECONDS = (
    0.1  # [s] a key that is held down acts at most this long in one displayed frame, however long that took
)


def run(
    open_session: Callable[[], S],
    *,
    size: tuple[int, int] = (1280, 720),
    frames: int | None = None,
    log: Path | None = None,
    announce: Callable[[Simulation], None] = lambda simulation: None,
) -> S:
    """Open a window on a session. Return the closed session when the user quits, or after `frames` displayed frames.

    `open_session` makes the session. `size`: of the window [pixels]. `announce` is called before the first frame.
    Taichi must have been started, and `toolkit.window_obstacle()` must have returned None: if it cannot open a
    window, Taichi ends the process. Raises OSError if `log` cannot be written.
    """
    with contextlib.ExitStack() as stack:
        frame_log = stack.enter_context(FrameLog(log)) if log else None
        # The toolkit writes its settings, imgui.ini, to the working directory.
        folder = stack.enter_context(TemporaryDirectory(prefix="taichi_cloth_"))
        session = stack.enter_context(contextlib.closing(open_session()))
        session.draw_list.update(session.view, session.camera.eye)  # compiles before the window opens
        announce(session.simulation)
        with contextlib.chdir(folder):
            window = ti.ui.Window(WINDOW_TITLE, size, vsync=True, pos=WINDOW_POSITION)
            try:
                loop(window, session, Panel(size, Path(folder) / "imgui.ini"), frames, frame_log)
            finally:
                window.destroy()  # before the Taichi fields are released, and before Taichi stops
        line = session.finish()
        if line:
            print(line, flush=True)
    return session


STILL_FRAMES = 2  # displayed before the first frame is simulated: the toolkit shows the panel from the second on
SMALL_WIDTH = 1000  # [pixels] the panel covers much of a narrower window, where each scene begins framed beside it


def loop(window: ti.ui.Window, session: Session, panel: Panel, frames: int | None, frame_log: FrameLog | None) -> None:
    """Process input, simulate and draw, once for every displayed frame."""
    canvas, scene, gui, lens = window.get_canvas(), window.get_scene(), window.get_gui(), ti.ui.Camera()
    clock, overlays = FrameClock(time.perf_counter()), Overlays()
    draw_ms, show_ms, displayed = 0.0, 0.0, 0
    camera: OrbitCamera | None = None
    compiling = Progress(f"{session.simulation.scene.name}: compiling")  # the first frame
    session.note = session.note or compiling
    memory, idle = MemoryWatch(), Idle()
    # Text of the statistics; time [s] and number of displayed frames at its last update.
    text, updated, displayed_before = "", 0.0, 0
    while window.running and session.running and displayed != frames:
        now = time.perf_counter()
        due = clock.due(now, SPEEDS[session.speed]) if displayed >= STILL_FRAMES else 0
        size = window_size(window, panel.window_size)
        keys = pressed_keys(window)
        cursor = window.get_cursor_pos()
        if idle.has_nothing_new(now, session, (size, cursor, held_buttons(window), keys)):
            continue

        if now - updated > STATISTICS_EVERY:
            if not session.charts:
                session.measure()
            times = {"drawing": draw_ms, "display": show_ms}
            text = statistics(session, times, (displayed - displayed_before) / (now - updated))
            updated, displayed_before = now, displayed
            session.note = session.note or memory.warning()

        press_keys(window, session, keys, min(clock.elapsed, MAX_HOLD_SECONDS))
        widget_used = not session.hidden and panel.draw(gui, session, text)
        if session.page == HELP:
            panel.draw_help(gui)
        draw_gray_reason(gui, session, panel.window_size)
        if session.caption:
            title = HIDDEN_TITLE if session.is_allowed("hide") else "replay"
            draw_caption(gui, panel.window_size, title, session.caption)
        session.zoom(scroll_steps(window))
        session.camera.view_shift = 0.0 if session.hidden else panel.shift(size)
        if session.camera is not camera:  # that of a new scene
            camera = session.camera
            frame = camera.include if size[0] < SMALL_WIDTH else camera.fit_width
            frame(session.simulation.positions(), size[0] / size[1])
        on_panel = not session.hidden and panel.place.contains(cursor, size)
        on_panel |= session.page == HELP and panel.help_place.contains(cursor, size)
        session.on_pointer(cursor, held_buttons(window), size, on_panel=on_panel, widget_changed=widget_used)
        session.advance(due)
        if due > 0 and session.note is compiling:
            session.note = ""
        if session.charts or frame_log:  # charts and log need the metrics of every displayed frame
            session.measure()

        start = time.perf_counter()
        draw(canvas, scene, lens, session)
        if displayed > 0:  # Taichi 1.7.4 may never draw the scene if lines are drawn over its first frame
            overlays.draw(canvas, session, size, None if on_panel else cursor)
        draw_ms = 1e3 * (time.perf_counter() - start)
        if frame_log:
            frame_log.write(line_of(session, displayed, cursor, size[0] / size[1], draw_ms))
        start = time.perf_counter()
        window.show()
        show_ms = 1e3 * (time.perf_counter() - start)
        displayed += 1
        session.run_deferred()


class Idle:
    """Tells when a frozen window need not be drawn: a software Vulkan driver needs a core for it, and takes memory."""

    AFTER = 1.0  # [s] without anything new: widgets change colors for a moment after the mouse was there
    REDRAW_EVERY = 0.5  # [s] another window may have covered it
    SLEEP = 0.02  # [s] between two looks at the input

    def __init__(self) -> None:
        self._seen: object = None
        self._new_since = self._drawn = 0.0  # [s]

    def has_nothing_new(self, now: float, session: Session, user: object) -> bool:
        """Return whether the picture at `now` [s] would be the last one again; then sleep. `user`: all input."""
        measured = session.frame_error and session.frame_error.frame
        view = *session.camera.eye, *session.camera.target
        seen = user, session.frozen, session.simulation.frame, view, session.note, measured
        if seen != self._seen or not session.frozen:
            self._seen, self._new_since = seen, now
        if now - self._new_since < self.AFTER or now - self._drawn > self.REDRAW_EVERY:
            self._drawn = now
            return False
        time.sleep(self.SLEEP)
        return True


# -- input -------------------------------------------------------------------------------------------------------------


class WindowSession(Protocol):
    """What keys act on: a `Session` or a `Comparison`."""

    def request(self, action: str) -> None: ...
    def on_key_held(self, action: str, seconds: float) -> None: ...


def pressed_keys(window: ti.ui.Window) -> list[str]:
    """Return the codes of the keys pressed since the last displayed frame.

    Read them before the cursor: a key that was pressed after a motion must not act where the cursor was before it.
    """
    return [event.key for event in window.get_events(ti.ui.PRESS)]


def press_keys(window: ti.ui.Window, session: WindowSession, pressed: list[str], seconds: float) -> None:
    """Run the actions of keys that were pressed, and those of keys that are held down; none while Ctrl is held.

    Ctrl+A selects the text of a number field, which the toolkit does not tell us. `seconds`: wall time for which held
    keys act [s].
    """
    if ti.ui.CTRL in pressed or window.is_pressed(ti.ui.CTRL):
        return
    for code in pressed:
        for key in SHORTCUTS:
            if key.code == code and not key.held:
                session.request(key.action)
    for key in SHORTCUTS:
        if key.held and window.is_pressed(key.code):
            session.on_key_held(key.action, seconds)


def scroll_steps(window: ti.ui.Window) -> float:
    """Return how many notches the mouse wheel turned since the last displayed frame, positive forward.

    Taichi 1.7.4 does not report the wheel, so this is 0. A later version that has `get_scroll_delta` returns (dx, dy)
    since the last call.
    """
    return float(window.get_scroll_delta()[1]) if hasattr(window, "get_scroll_delta") else 0.0


def held_buttons(window: ti.ui.Window) -> frozenset[str]:
    """Return the mouse buttons that are down, a subset of `input.BUTTONS`."""
    return frozenset(name for name, code in BUTTON_CODES.items() if window.is_pressed(code))


def window_size(window: ti.ui.Window, first: tuple[int, int]) -> tuple[int, int]:
    """Return the size of the window in the pixels that its panel uses. `first`: the size it was opened with."""
    width, height = window.get_window_shape()
    # On a Retina display the toolkit reports physical pixels, twice as many in each direction.
    scale = max(1, round(width / first[0])) if sys.platform == "darwin" else 1
    return width // scale, height // scale


# -- drawing -----------------------------------------------------------------------------------------------------------


def draw(canvas: ti.ui.Canvas, scene: ti.ui.Scene, lens: ti.ui.Camera, session: Session) -> None:
    """Draw the scene of a session on the canvas."""
    mesh = session.draw_list.update(session.view, session.camera.eye)
    set_camera(lens, session.camera)
    scene.set_camera(lens)
    canvas.set_background_color(BACKGROUND)
    submit(scene, mesh)
    canvas.scene(scene)


class Overlays:
    """What is drawn over the picture: color scale, grab ring and charts."""

    def __init__(self) -> None:
        self._charts, self._legend, self._ring = CurveDrawing(), WindowLegend(), GrabRing()

    def draw(
        self, canvas: ti.ui.Canvas, session: Session, size: tuple[int, int], cursor: tuple[float, float] | None
    ) -> None:
        """Draw on a canvas of `size` [pixels]. `cursor`: a screen point, or None over the panel."""
        if scale := session.draw_list.scale(session.view):
            self._legend.show(canvas, scale, size, top() if session.charts else 0.0)
        if cursor is not None:
            self._ring.draw(canvas, session, cursor, size)
        if session.charts:
            self._charts.draw(canvas, session.history, size[0] / size[1])


RING_SEGMENTS = 48
MIN_RING_RADIUS = 4.0  # [pixels] a smaller ring is not drawn: one particle is grabbed
RING_WIDTH = 0.0015  # [window heights]
RING_COLOR, GRABBING_RING_COLOR = (0.35, 0.36, 0.38), (0.95, 0.70, 0.10)


class GrabRing:
    """A ring at the cursor with the grab radius, as far away as the grabbed particle, or else the camera's target."""

    def __init__(self) -> None:
        self._ends = ti.Vector.field(2, ti.f32, 2 * RING_SEGMENTS)

    def draw(self, canvas: ti.ui.Canvas, session: Session, cursor: tuple[float, float], size: tuple[int, int]) -> None:
        """Draw the ring around `cursor` on a canvas of `size` [pixels], unless it is tiny."""
        camera, grabbed = session.camera, session.dragger.particle
        depth = camera.distance
        if grabbed is not None:
            depth = float(camera.to_screen(session.simulation.positions()[grabbed], 1.0)[1][0])
        radius = camera.on_screen(session.grab_radius, depth)  # [image heights]
        if radius * size[1] >= MIN_RING_RADIUS:
            self._ends.from_numpy(ring(cursor, radius, size[0] / size[1]))
            canvas.lines(self._ends, RING_WIDTH, color=RING_COLOR if grabbed is None else GRABBING_RING_COLOR)


def ring(center: tuple[float, float], radius: float, aspect: float) -> NDArray[np.float32]:
    """Return the ends of the lines of a ring as screen points, (2·`RING_SEGMENTS`, 2). `radius` [image heights]."""
    angles = 2 * np.pi / RING_SEGMENTS * ((np.arange(2 * RING_SEGMENTS) + 1) // 2)
    points = np.array(center) + radius * np.stack([np.cos(angles) / aspect, np.sin(angles)], axis=1)
    return points.astype(np.float32)


def set_camera(lens: ti.ui.Camera, camera: OrbitCamera) -> None:
    """Set the toolkit's camera `lens` to the same projection as `camera`."""
    lens.position(*camera.eye)
    lens.lookat(*camera.look_at)
    lens.up(0.0, 1.0, 0.0)
    lens.fov(degrees(camera.fov))


def submit(scene: ti.ui.Scene, mesh: DrawMesh) -> None:
    """Draw the triangles of `mesh` without lighting: their colors include it."""
    scene.ambient_light((1.0, 1.0, 1.0))
    scene.mesh(mesh.position, normals=mesh.normal, per_vertex_color=mesh.color, vertex_count=mesh.corners)
