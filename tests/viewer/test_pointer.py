"""The target of the mouse stays the same from press to release."""

from __future__ import annotations

import pytest

from taichi_cloth.viewer.toolkit import ZOOM_STEPS, Gesture, Mouse, Pointer, Target

NOTHING = Gesture()


def feed(
    pointer: Pointer, x: float = 0.5, y: float = 0.5, *held: str, panel: bool = False, widget: bool = False
) -> Gesture:
    mouse = Mouse(x, y, frozenset(held))
    return pointer.update(mouse, on_panel=panel, widget_changed=widget)


def test_motion_without_a_button_has_no_effect() -> None:
    pointer = Pointer()
    assert feed(pointer, 0.1) == feed(pointer, 0.9, panel=True) == NOTHING
    assert pointer.owner is Target.IDLE


def test_a_drag_of_the_cloth_lasts_from_press_to_release() -> None:
    pointer = Pointer()
    assert feed(pointer, 0.5, 0.5, "left") == Gesture(press=True)
    assert feed(pointer, 0.6, 0.5, "left") == NOTHING
    assert pointer.owner is Target.CLOTH
    assert feed(pointer, 0.6, 0.5) == Gesture(release=True)
    assert pointer.owner is Target.IDLE
    assert feed(pointer, 0.6, 0.5) == NOTHING


def test_a_drag_continues_over_the_panel() -> None:
    pointer = Pointer()
    feed(pointer, 0.5, 0.5, "left")
    assert feed(pointer, 0.1, 0.5, "left", panel=True) == NOTHING
    assert pointer.owner is Target.CLOTH
    assert feed(pointer, 0.1, 0.5, panel=True) == Gesture(release=True)


@pytest.mark.parametrize("button", ["left", "right", "middle"])
def test_a_press_on_the_panel_acts_on_the_panel_until_the_release(button: str) -> None:
    pointer = Pointer()
    assert feed(pointer, 0.1, 0.5, button, panel=True) == NOTHING
    assert feed(pointer, 0.9, 0.9, button, widget=True) == NOTHING
    assert pointer.owner is Target.PANEL
    assert feed(pointer, 0.9, 0.9) == NOTHING


def test_a_widget_that_changes_during_a_drag_releases_the_cloth() -> None:
    """The panel was moved, and its stored rectangle is out of date: the press seemed to be on the cloth."""
    pointer = Pointer()
    feed(pointer, 0.5, 0.5, "left")
    assert feed(pointer, 0.5, 0.5, "left", widget=True) == Gesture(release=True)
    assert pointer.owner is Target.PANEL
    assert feed(pointer, 0.6, 0.5, "left") == NOTHING
    assert feed(pointer, 0.6, 0.5) == NOTHING


def test_a_press_beside_the_cloth_orbits() -> None:
    pointer = Pointer()
    assert feed(pointer, 0.5, 0.5, "left").press
    pointer.orbit_instead()
    assert feed(pointer, 0.7, 0.4, "left").orbit == pytest.approx((0.2, -0.1))
    assert pointer.owner is Target.CAMERA
    assert feed(pointer, 0.7, 0.4) == NOTHING
    assert feed(pointer, 0.7, 0.4, "left").press


def test_a_press_whose_cloth_was_released_is_ignored_until_its_end() -> None:
    pointer = Pointer()
    assert feed(pointer, 0.5, 0.5, "left").press
    pointer.ignore()
    assert feed(pointer, 0.7, 0.5, "left") == NOTHING
    assert feed(pointer, 0.7, 0.5, "left", "right") == NOTHING
    assert feed(pointer, 0.7, 0.5) == NOTHING
    assert feed(pointer, 0.7, 0.5, "left").press


def test_the_right_button_orbits_and_the_middle_button_zooms() -> None:
    pointer = Pointer()
    assert feed(pointer, 0.5, 0.5, "right") == NOTHING
    assert feed(pointer, 0.7, 0.4, "right").orbit == pytest.approx((0.2, -0.1))
    assert feed(pointer, 0.9, 0.9) == NOTHING
    feed(pointer, 0.5, 0.5, "middle")
    assert feed(pointer, 0.5, 0.6, "middle").zoom == pytest.approx(0.1 * ZOOM_STEPS)
    assert pointer.owner is Target.CAMERA


def test_other_buttons_are_ignored_until_the_first_is_released() -> None:
    pointer = Pointer()
    feed(pointer, 0.5, 0.5, "left")
    assert feed(pointer, 0.6, 0.5, "left", "right") == NOTHING
    assert feed(pointer, 0.6, 0.5, "right") == Gesture(release=True)
    assert feed(pointer, 0.6, 0.5, "right") == NOTHING
    assert feed(pointer, 0.7, 0.5, "right").orbit == pytest.approx((0.1, 0.0))


def test_motion_before_a_press_does_not_orbit() -> None:
    pointer = Pointer()
    feed(pointer, 0.0, 0.0)
    assert feed(pointer, 0.9, 0.9, "right") == NOTHING
