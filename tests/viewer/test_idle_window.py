"""A frozen window is not drawn while nothing is new."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

from taichi_cloth.simulation.copies import FrameError
from taichi_cloth.viewer.error_process import Answer
from taichi_cloth.viewer.session import Session
from taichi_cloth.viewer.window import Idle

INTERVAL = Idle.SLEEP  # [s] between two looks at the input


@pytest.fixture
def session(monkeypatch: pytest.MonkeyPatch, session: Session) -> Session:
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    return session


def drawn(idle: Idle, session: Session, start: float, seconds: float) -> int:
    """Return how often a window is drawn in a time from `start` [s], without input."""
    looks = round(seconds / INTERVAL)
    return sum(not idle.has_nothing_new(start + k * INTERVAL, session, "no input") for k in range(looks))


def test_a_running_window_is_always_drawn(session: Session) -> None:
    assert drawn(Idle(), session, 0.0, 5.0) == round(5.0 / INTERVAL)


def test_a_frozen_window_is_drawn_twice_a_second_after_one_second(session: Session) -> None:
    session.frozen, idle = True, Idle()
    assert drawn(idle, session, 0.0, Idle.AFTER) == round(Idle.AFTER / INTERVAL)
    assert drawn(idle, session, Idle.AFTER, 20.0) == pytest.approx(20.0 / Idle.REDRAW_EVERY, abs=2)


def note(session: Session) -> None:
    session.note = "saved"


@pytest.mark.parametrize(
    "change",
    [
        note,
        lambda session: session.act("step"),
        lambda session: session.act("freeze"),
        lambda session: session.camera.orbit(0.1, 0.0),
        lambda session: session.camera.pan(0.1, 0.0),
        lambda session: session.camera.zoom(1.0),
    ],
)
def test_what_is_new_is_drawn_at_once(session: Session, change: Callable[[Session], None]) -> None:
    session.frozen, idle = True, Idle()
    drawn(idle, session, 0.0, 5.0)
    assert idle.has_nothing_new(5.0, session, "no input")
    change(session)
    assert not idle.has_nothing_new(5.0 + INTERVAL, session, "no input")


def test_input_is_drawn_at_once(session: Session) -> None:
    session.frozen, idle = True, Idle()
    drawn(idle, session, 0.0, 5.0)
    assert idle.has_nothing_new(5.0, session, "no input")
    assert not idle.has_nothing_new(5.0 + INTERVAL, session, "a key")


def test_an_error_measured_of_a_frozen_cloth_is_shown(session: Session) -> None:
    session.measure_errors(True)
    session.frozen, idle = True, Idle()
    drawn(idle, session, 0.0, 5.0)
    assert session.meter is not None
    assert idle.has_nothing_new(5.0 - INTERVAL, session, "no input")
    session.meter.answer = Answer(FrameError(1, 0.1, 0.1, 0.0, None, 0.1, np.ones(720), 0.1))
    assert not idle.has_nothing_new(5.0, session, "no input")
