"""Check whether a window can open, before one is opened: on failure, Taichi's window ends the process."""

from __future__ import annotations

import ctypes
import os
import sys
from threading import Thread

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
