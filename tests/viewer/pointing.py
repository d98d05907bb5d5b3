"""What tests of a session share: where the cursor points, what it grabs, and an answer about errors."""

from __future__ import annotations

from typing import Any

from taichi_cloth.viewer.error_process import Answer
from taichi_cloth.viewer.session import Session

SIZE = (1280, 720)
ASPECT = SIZE[0] / SIZE[1]


def point(session: Session, cursor: tuple[float, float], *buttons: str, **more: Any) -> None:
    session.on_pointer(cursor, frozenset(buttons), SIZE, **{"on_panel": False, "widget_changed": False, **more})


def cursor_on(session: Session, particle: int) -> tuple[float, float]:
    u, v = session.camera.to_screen(session.simulation.positions()[particle], ASPECT)[0][0]
    return float(u), float(v)


PARTICLE = 18 * 30 + 26  # of the curtain, at the lower right: nothing hides it at the start


def grabbed(session: Session) -> int | None:
    """Return the particle that is dragged, or None."""
    particles = session.simulation.grabbed
    return int(particles[0]) if len(particles) else None


def grab(session: Session) -> tuple[float, float]:
    """Press the left button on the particle. Return its screen point."""
    cursor = cursor_on(session, PARTICLE)
    point(session, cursor, "left")
    assert grabbed(session) == PARTICLE
    return cursor


class ReadyPipe:
    """A connection on which an answer has arrived."""

    def __init__(self, answer: Answer) -> None:
        self._answer = answer

    def poll(self) -> bool:
        return True

    def recv(self) -> Answer:
        return self._answer

    def send(self, message: object) -> None:
        pass

    def close(self) -> None:
        pass
