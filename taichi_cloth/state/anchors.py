"""Fields of the anchors of pairs that touch (`contact/sticking.py`)."""

from dataclasses import dataclass
from typing import Any

import taichi as ti

from . import fields
from .pool import attached


@dataclass(eq=False)
class Anchors:
    """Row by row, as the list of pairs (`state/near.py`)."""

    gap: Any  # [m] vec3 from the second particle to the first, when they met
    pushed: Any  # [m] how far a substep has pushed them apart, in all its iterations
    met: Any  # the last substep in which they touched


def anchor(work: Any) -> None:
    """Gives a cloth that has its `near`, or its strips, their `anchors`."""
    room = work.near.pairs.rows.shape[0]
    attached(work, "anchors", lambda: _allocate(room))


def _allocate(room: int) -> Anchors:
    return Anchors(gap=fields.rows(3, room, ti.f32), pushed=fields.numbers(room), met=fields.numbers(room, kind=ti.i32))
