"""What the UI toolkit does not report: whether a window can open, where its panel is, if a slider moved. Its panels.

If a window cannot open, Taichi ends the process.
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
