"""The mouse has one owner from press to release."""

from __future__ import annotations

import pytest

from taichi_cloth.interact.pointer import ZOOM_STEPS, Gesture, Mouse, Owner, Pointer

NOTHING = Gesture()


def feed(
    pointer: Pointer, x: float = 0.5, y: float = 0.5, *held: str, panel: bool = False, widget: bool = False
) -> Gesture:
    mouse = Mouse(x, y, frozenset(held))
    return pointer.update(mouse, on_panel=panel, widget_changed=widget)


def test_moving_alone_does_nothing() -> None:
    pointer = Pointer()
    assert feed(pointer, 0.1) == feed(pointer, 0.9, panel=True) == NOTHING
    assert pointer.owner is Owner.IDLE


def test_a_pull_on_the_cloth_lasts_from_press_to_release() -> None:
    pointer = Pointer()
    assert feed(pointer, 0.5, 0.5, "left") == Gesture(press=True)
    assert feed(pointer, 0.6, 0.5, "left") == NOTHING
    assert pointer.owner is Owner.CLOTH
    assert feed(pointer, 0.6, 0.5) == Gesture(release=True)
    assert pointer.owner is Owner.IDLE
    assert feed(pointer, 0.6, 0.5) == NOTHING


def test_a_pull_goes_on_across_the_panel() -> None:
    pointer = Pointer()
    feed(pointer, 0.5, 0.5, "left")
    assert feed(pointer, 0.1, 0.5, "left", panel=True) == NOTHING
    assert pointer.owner is Owner.CLOTH
    assert feed(pointer, 0.1, 0.5, panel=True) == Gesture(release=True)


@pytest.mark.parametrize("button", ["left", "right", "middle"])
def test_a_press_on_the_panel_stays_with_the_panel(button: str) -> None:
    pointer = Pointer()
    assert feed(pointer, 0.1, 0.5, button, panel=True) == NOTHING
    assert feed(pointer, 0.9, 0.9, button, widget=True) == NOTHING
    assert pointer.owner is Owner.PANEL
    assert feed(pointer, 0.9, 0.9) == NOTHING


def test_a_widget_that_changes_during_a_pull_takes_the_mouse_over() -> None:
    """The user has moved the panel, so the press looked like one on the cloth."""
    pointer = Pointer()
    feed(pointer, 0.5, 0.5, "left")
    assert feed(pointer, 0.5, 0.5, "left", widget=True) == Gesture(release=True)
    assert pointer.owner is Owner.PANEL
    assert feed(pointer, 0.6, 0.5, "left") == NOTHING
    assert feed(pointer, 0.6, 0.5) == NOTHING


def test_a_press_on_nothing_waits_for_its_release() -> None:
    pointer = Pointer()
    assert feed(pointer, 0.5, 0.5, "left").press
    pointer.miss()
    assert feed(pointer, 0.7, 0.5, "left") == NOTHING
    assert feed(pointer, 0.7, 0.5, "left", "right") == NOTHING
    assert feed(pointer, 0.7, 0.5) == NOTHING
    assert feed(pointer, 0.7, 0.5, "left").press


def test_the_right_button_turns_and_the_middle_button_zooms() -> None:
    pointer = Pointer()
    assert feed(pointer, 0.5, 0.5, "right") == NOTHING
    assert feed(pointer, 0.7, 0.4, "right").orbit == pytest.approx((0.2, -0.1))
    assert feed(pointer, 0.9, 0.9) == NOTHING
    feed(pointer, 0.5, 0.5, "middle")
    assert feed(pointer, 0.5, 0.6, "middle").zoom == pytest.approx(0.1 * ZOOM_STEPS)
    assert pointer.owner is Owner.CAMERA


def test_the_first_button_wins() -> None:
    pointer = Pointer()
    feed(pointer, 0.5, 0.5, "left")
    assert feed(pointer, 0.6, 0.5, "left", "right") == NOTHING
    assert feed(pointer, 0.6, 0.5, "right") == Gesture(release=True)
    assert feed(pointer, 0.6, 0.5, "right") == NOTHING
    assert feed(pointer, 0.7, 0.5, "right").orbit == pytest.approx((0.1, 0.0))


def test_the_motion_before_a_press_turns_nothing() -> None:
    pointer = Pointer()
    feed(pointer, 0.0, 0.0)
    assert feed(pointer, 0.9, 0.9, "right") == NOTHING
