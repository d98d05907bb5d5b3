"""Every reason why no window can open is found before one is tried."""

from __future__ import annotations

import os
import socket
import sys
from typing import Any

import pytest

from taichi_cloth.view import display
from taichi_cloth.view.display import window_obstacle

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="these are the obstacles of X11")


def test_a_working_screen_is_no_obstacle(screen: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", screen.display)
    obstacle = window_obstacle()
    assert obstacle is None or "Vulkan" in obstacle


def test_no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert window_obstacle() == "DISPLAY is not set"


def test_wayland_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert "Wayland" in str(window_obstacle())


@pytest.mark.parametrize("display", [":4711", "localhost:4711", "nonsense"])
def test_no_server_behind_the_display(display: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", display)
    assert f"no X server at DISPLAY={display}" in str(window_obstacle())


def test_a_server_that_does_not_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(display, "PATIENCE", 0.1)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("\0/tmp/.X11-unix/X4712")  # an abstract socket: no file is left
        server.listen()
        monkeypatch.setenv("DISPLAY", ":4712")
        assert "does not answer" in str(window_obstacle())


@pytest.mark.parametrize("drivers", ["/nonexistent", ""])
def test_no_vulkan_driver(drivers: str, screen: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", screen.display)
    monkeypatch.setenv("VK_ICD_FILENAMES", drivers or os.devnull)
    assert "Vulkan" in str(window_obstacle())


def test_no_vulkan_at_all(screen: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", screen.display)
    monkeypatch.setattr(display, "VULKAN", "libno-such-vulkan.so.1")
    assert "Vulkan is missing" in str(window_obstacle())
