"""What the UI toolkit does not report: whether a window can open, where its panel is, if a slider moved. The mouse.

If a window cannot open, Taichi ends the process.

A press of the mouse selects the panel, the cloth, a sphere or the camera, until the button is released. The toolkit
does not report whether its panel uses the mouse, so the position of the press decides: is it inside the panel's
rectangle? That rectangle is out of date for some seconds after the user has moved the panel. If a widget changes during
a drag, the press was on the panel, and the cloth is released.
"""

from __future__ import annotations

import ctypes
import math
import os
import re
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the check for a window runs before Taichi is imported
    import taichi as ti

VULKAN = "vulkan-1.dll" if sys.platform == "win32" else "libvulkan.so.1"
TIMEOUT = 3.0  # [s] timeout for an X server that accepts the connection but does not answer


def window_obstacle() -> str | None:
    """Return why no window can open on this machine, in a few words, or None if one can.

    On Linux it calls the libraries that the window uses, Xlib and Vulkan, which takes about 25 ms. On macOS and Windows
    Taichi uses the system's own window server: it then checks only Vulkan on Windows, and nothing on macOS.
    """
    if sys.platform == "darwin":
        return None  # Taichi brings its own Vulkan there
    if sys.platform == "win32":
        return _vulkan_obstacle()
    return _x11_obstacle() or _vulkan_obstacle()


def _x11_obstacle() -> str | None:
    display = os.environ.get("DISPLAY")
    if not display:
        wayland = os.environ.get("WAYLAND_DISPLAY")
        return "Wayland without XWayland: DISPLAY is not set" if wayland else "DISPLAY is not set"
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError:
        return "the library libX11.so.6 is missing"
    x11.XInitThreads()  # must be the first call into the library
    x11.XOpenDisplay.restype = ctypes.c_void_p
    results: list[int | None] = []

    def call() -> None:
        results.append(x11.XOpenDisplay(None))

    caller = Thread(target=call, daemon=True)  # the call blocks if the server does not answer
    caller.start()
    caller.join(TIMEOUT)
    if not results:
        return f"the X server at DISPLAY={display} does not answer"
    if results[0] is None:
        return f"no X server at DISPLAY={display}, or it refused the connection"
    x11.XCloseDisplay(ctypes.c_void_p(results[0]))
    return None


class _InstanceCreateInfo(ctypes.Structure):
    """VkInstanceCreateInfo without layers and extensions."""

    _fields_ = (
        ("structure_type", ctypes.c_int),
        ("next", ctypes.c_void_p),
        ("flags", ctypes.c_uint32),
        ("application", ctypes.c_void_p),
        ("layer_count", ctypes.c_uint32),
        ("layers", ctypes.c_void_p),
        ("extension_count", ctypes.c_uint32),
        ("extensions", ctypes.c_void_p),
    )


def _vulkan_obstacle() -> str | None:
    try:
        vulkan = ctypes.CDLL(VULKAN)
    except OSError:
        return f"Vulkan is missing: cannot load {VULKAN}"
    instance, count = ctypes.c_void_p(), ctypes.c_uint32()
    info = _InstanceCreateInfo(structure_type=1)  # VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO
    if vulkan.vkCreateInstance(ctypes.byref(info), None, ctypes.byref(instance)) != 0:
        return "Vulkan has no driver"
    failed = vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None) != 0
    vulkan.vkDestroyInstance(instance, None)
    return "Vulkan has no graphics device" if failed or count.value == 0 else None


# -- position of the panel ---------------------------------------------------------------------------------------------

# The toolkit does not report it, but saves it to its settings file some seconds after a move.

TITLE_HEIGHT = 19  # [pixels] height of a collapsed panel
LINE_HEIGHT, LINES_HEIGHT = 17, 36  # [pixels] of a line of text; of a panel of lines without any

# A section of imgui.ini. "Collapsed" is 1 if the user has collapsed the panel to its title bar.
SECTION = r"\[Window\]\[{name}\]\nPos=(-?\d+),(-?\d+)\nSize=(\d+),(\d+)\nCollapsed=(\d)"


@dataclass(frozen=True)
class PanelRect:
    """The rectangle of a panel, in pixels from the top left corner of the window."""

    left: int
    top: int
    width: int
    height: int

    @property
    def right(self) -> int:
        """Right edge [pixels]."""
        return self.left + self.width

    def contains(self, cursor: tuple[float, float], size: tuple[int, int]) -> bool:
        """Return whether a screen point (from the bottom left, 0…1) of a window of `size` [pixels] lies in it."""
        x, y = cursor[0] * size[0] - self.left, (1 - cursor[1]) * size[1] - self.top
        return 0 <= x <= self.width and 0 <= y <= self.height


def sub_window(
    gui: ti.ui.Gui, name: str, place: PanelRect, window_size: tuple[int, int]
) -> AbstractContextManager[object]:
    """Begin a panel at `place`, where it stays until the user moves it. `window_size`: when it opens [pixels]."""
    width, height = window_size
    rect = place.left / width, place.top / height, place.width / width, place.height / height
    panel: AbstractContextManager[object] = gui.sub_window(name, *rect)
    return panel


def draw_lines(
    gui: ti.ui.Gui, title: str, lines: Sequence[str], top: tuple[int, int, int], window_size: tuple[int, int]
) -> None:
    """Draw a panel that is as high as its lines. `top`: left and top edge and width [pixels]."""
    # The toolkit keeps the size with which a name was first shown. It does not show what follows ##.
    name, height = f"{title}##{len(lines)}", LINES_HEIGHT + len(lines) * LINE_HEIGHT
    with sub_window(gui, name, PanelRect(*top, height), window_size):
        for line in lines:
            gui.text(line)


def saved_panel_rect(settings: Path, name: str) -> PanelRect | None:
    """Return the rectangle of the panel `name` from the toolkit's settings file, or None if it is not there yet."""
    try:
        match = re.search(SECTION.format(name=re.escape(name)), settings.read_text(encoding="utf-8"))
    except OSError:
        return None
    if match is None:
        return None
    left, top, width, height, collapsed = map(int, match.groups())
    return PanelRect(left, top, width, TITLE_HEIGHT if collapsed else height)


def has_changed(after: float, before: float) -> bool:
    """Return whether the user moved a slider from `before` to `after`.

    The toolkit returns values rounded to float32. After Ctrl+click it returns any number that the user types.
    """
    return math.isfinite(after) and not math.isclose(after, before, rel_tol=1e-6, abs_tol=1e-9)


# -- the mouse ---------------------------------------------------------------------------------------------------------

BUTTONS = ("left", "right", "middle")
ZOOM_STEPS = 20.0  # zoom steps for a drag over the height of the window


class Target(Enum):
    """What the mouse acts on."""

    IDLE = "idle"
    PANEL = "panel"
    CLOTH = "cloth"
    CAMERA = "camera"
    NOTHING = "nothing"  # the grabbed cloth was released; no action until the button is up


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
    """Try to grab the cloth or a sphere here. The caller calls `Pointer.orbit_instead` if there is none."""
    release: bool = False
    """Release it."""
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

    def orbit_instead(self) -> None:
        """Orbit the camera until the button is up: the press hit no cloth."""
        self.owner = Target.CAMERA

    def ignore(self) -> None:
        """Ignore the mouse until its button is up: the grabbed cloth was released."""
        if self.owner is Target.CLOTH:
            self.owner = Target.NOTHING


# -- notes: lines for the user about what was done ---------------------------------------------------------------------


class Refusal(str):
    """A note that something was not done, and why."""


class Progress(str):
    """A note about what is going on."""


PIN_MOVED = "pin moved; Z puts it back"
PULLED_TOO_FAR = "pulled too far; L grabs more"
TOO_FAR = 1.0  # largest strain of a cloth that is pulled, above which the note says so
ONLY_PINS = "only pins of the scene here: P unpins them"
FROZEN_DRAG = "frozen: hold the button and press Space or N, and what you drag follows the mouse"
DRAG_NOTES = FROZEN_DRAG, PULLED_TOO_FAR  # shown until the drag ends
UNDONE = "undone; Space continues", "undone, and slider changes since; Space continues"  # with equal, other sliders
NOTHING_TO_UNDO = "nothing to undo: no grab or pin since the start or a change of scene, solver, fabric or features"

# What notes and statistics call by a key: the names of controls of the browser page, which a phone has too.
CONTROLS = {
    "hold the button and press Space or N, and what you drag follows the mouse": (
        "hold it and press Freeze or Step, and what you drag follows"
    ),
    "Space continues": "press Freeze to continue",
    "Z puts it back": "Undo puts it back",
    "L grabs more": "a larger Grab radius grabs more",
    "P unpins them": "the key P unpins them",
    "G turns it on": "Wind in Features turns it on",
    "not measured (U)": "not measured: see Measure errors",
    "N runs a frame": "Step runs a frame",
}


def without_keys(text: str) -> str:
    """Return lines for the user with names of controls in place of keys."""
    for key, control in CONTROLS.items():
        text = text.replace(key, control)
    return text
