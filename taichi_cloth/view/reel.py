"""The pictures of a session that nobody looks at, one after another."""

from __future__ import annotations

from collections.abc import Callable

from .frames import Plan
from .portrait import portrait
from .raster import Raster
from .session import Session
from .video import Show


def reel(session: Session, plan: Plan, show: Show, on_frame: Callable[[int], None]) -> int:
    """Shows picture after picture as the session is looked at, and returns how many.

    Picture i shows the cloth after `i · every` frames. It ends early where the session freezes: the cloth blew up.
    """
    raster = Raster(plan.width, plan.height, plan.samples)
    shown = 0
    for k in range(plan.frames):
        if k > 0:
            session.advance(1)
        if k % plan.every == 0:
            show(portrait(raster, session.draw_list, session.camera, session.view))
            shown += 1
        on_frame(k)
        if session.frozen:
            break
    return shown
