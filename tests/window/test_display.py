"""Every reason why no window can open is found before one is opened."""

from __future__ import annotations

import os
import socket
import sys
from typing import Any

import pytest

from taichi_cloth.viewer import toolkit
from taichi_cloth.viewer.toolkit import window_obstacle

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the obstacles are those of X11")


def test_a_working_screen_is_no_obstacle(screen: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", screen.display)
    obstacle = window_obstacle()
    assert obstacle is None or "Vulkan" in obstacle


def test_an_unset_display_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert window_obstacle() == "DISPLAY is not set"


def test_wayland_without_xwayland_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert "Wayland" in str(window_obstacle())


@pytest.mark.parametrize("display", [":4711", "localhost:4711", "nonsense"])
def test_a_display_without_a_server_is_reported(display: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", display)
    assert f"no X server at DISPLAY={display}" in str(window_obstacle())


def test_a_server_that_does_not_answer_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(toolkit, "TIMEOUT", 0.1)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("\0/tmp/.X11-unix/X4712")  # an abstract socket leaves no file
        server.listen()
        monkeypatch.setenv("DISPLAY", ":4712")
        assert "does not answer" in str(window_obstacle())


@pytest.mark.parametrize("drivers", ["/nonexistent", ""])
def test_a_missing_vulkan_driver_is_reported(drivers: str, screen: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", screen.display)
    monkeypatch.setenv("VK_ICD_FILENAMES", drivers or os.devnull)
    assert "Vulkan" in str(window_obstacle())


def test_a_missing_vulkan_library_is_reported(screen: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", screen.display)
    monkeypatch.setattr(toolkit, "VULKAN", "libno-such-vulkan.so.1")
    assert "Vulkan is missing" in str(window_obstacle())
