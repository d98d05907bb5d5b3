"""Whether a window can open. Must be known before trying: Taichi's window ends the process where it cannot."""

from __future__ import annotations

import ctypes
import os
import sys
from threading import Thread

VULKAN = "vulkan-1.dll" if sys.platform == "win32" else "libvulkan.so.1"
PATIENCE = 3.0  # [s] for an X server that takes the call but does not answer


def window_obstacle() -> str | None:
    """Why no window can open here, in a few words; None if one can.

    It asks the very libraries that the window uses, in some 25 ms. On macOS and Windows, where Taichi talks
    to the system's own window server, it finds no obstacle except a missing Vulkan on Windows.
    """
    if sys.platform == "darwin":
        return None  # Vulkan comes with Taichi there
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
    x11.XInitThreads()  # must come before any other call into the library
    x11.XOpenDisplay.restype = ctypes.c_void_p
    answers: list[int | None] = []

    def call() -> None:
        answers.append(x11.XOpenDisplay(None))

    caller = Thread(target=call, daemon=True)  # a server that hangs would hang us too
    caller.start()
    caller.join(PATIENCE)
    if not answers:
        return f"the X server at DISPLAY={display} does not answer"
    if answers[0] is None:
        return f"no X server at DISPLAY={display}, or it refused us"
    x11.XCloseDisplay(ctypes.c_void_p(answers[0]))
    return None


class _InstanceCreateInfo(ctypes.Structure):
    """VkInstanceCreateInfo with nothing asked for."""

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
        return f"Vulkan is missing: no {VULKAN}"
    instance, count = ctypes.c_void_p(), ctypes.c_uint32()
    info = _InstanceCreateInfo(structure_type=1)  # VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO
    if vulkan.vkCreateInstance(ctypes.byref(info), None, ctypes.byref(instance)) != 0:
        return "Vulkan finds no driver"
    failed = vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None) != 0
    vulkan.vkDestroyInstance(instance, None)
    return "Vulkan finds no graphics device" if failed or count.value == 0 else None
