"""The sweep over a grid in strips (`mesh/strips.py`): eight springs, or eight cells, at once."""

from operator import attrgetter
from typing import Any, NamedTuple

import taichi as ti

from ..mesh.strips import (
    A_ROW,
    ALONG,
    B_ROW,
    COLOUR,
    DIRECTION,
    DOWN,
    EDGE_ROW,
    FIRST,
    INSIDE,
    LINK_MASK,
    LINK_SHIFT,
    OVER,
    ROW_KINDS,
    ROW_MASK,
    ROW_SHIFT,
    STRIDE,
)
from .places import next_lane, put_back


class Treatment(NamedTuple):
    """What is done to a spring, and by name the fields it uses at its ends."""

    apply: Any
    reads: tuple[str, ...]
    changes: str
    damped: tuple[str, ...] = ()  # read too where springs have dashpots

    def ends(self, stages: Any) -> tuple[str, ...]:
        """All fields in use."""
        return (*self.reads, self.changes, *(self.damped if stages.spring_damping else ()))


@ti.func
def in_pass(p, y: int):
    """Whether a row's springs belong to the pass."""
    return (y >> p[ROW_SHIFT]) & p[ROW_MASK] == p[COLOUR]


@ti.func
def slot_of(p, n: int):
    """Slot, in its row, where spring n of a row begins."""
    return p[FIRST] + (n >> p[LINK_SHIFT]) * p[STRIDE] + (n & p[LINK_MASK])


@ti.func
def row_kind(y: int, rows: int):
    """Which of the kinds of row that differ in their springs."""
    kind = y & 1  # EVEN_ROW or ODD_ROW
    if y == 0 or y == rows - 1:
        kind = EDGE_ROW
    return kind


@ti.func
def row_of(p, y: int, rows: int, pitch: int):
    """Where row y of a pass begins: in slots of the first ends, of the springs and of their stiffness."""
    k = (p[DIRECTION] * ROW_KINDS + row_kind(y, rows)) * pitch
    return (y + p[A_ROW]) * pitch, (p[DIRECTION] * rows + y) * pitch, k


@ti.func
def for_strip_springs(
    cloth: ti.template(), stages: ti.template(), start: int, treat: ti.template(), controls: ti.template(), h: float
):
    """Treats every spring from pass `start` on, pass by pass. One loop over a table: a copy of the body for each
    direction would compile four times as long.

    Springs that leave their strip have their second ends fetched from the next lane, a column of them at a time, into
    slots behind the grid. In loops of their own: LLVM would mix the shift into the arithmetic and then treat lane
    after lane.
    """
    rows, pitch, spare = cloth.rows[None], cloth.pitch[None], cloth.slot_count[None]
    for s in range(start, cloth.pass_count[None]):
        p = cloth.passes[s]
        for y in range(rows - p[DOWN]):
            if in_pass(p, y):
                a, e, k = row_of(p, y, rows, pitch)
                b = (y + p[B_ROW]) * pitch + p[ALONG]
                for n in range(p[INSIDE]):
                    i = slot_of(p, n)
                    treat.apply(cloth, stages, a + i, b + i, e + i, cloth.stiffness[k + i], controls, h)
        for n in range(p[INSIDE], p[INSIDE] + p[OVER]):
            i = slot_of(p, n)
            beyond = p[B_ROW] * pitch + p[ALONG] + i - pitch
            for y in range(rows - p[DOWN]):
                for name in ti.static(treat.ends(stages)):
                    field = ti.static(attrgetter(name)(cloth))
                    field[spare + y] = next_lane(field[beyond + y * pitch])
            for y in range(rows - p[DOWN]):
                if in_pass(p, y):
                    a, e, k = row_of(p, y, rows, pitch)
                    treat.apply(cloth, stages, a + i, spare + y, e + i, cloth.stiffness[k + i], controls, h)
            field = ti.static(attrgetter(treat.changes)(cloth))
            for y in range(rows - p[DOWN]):
                if in_pass(p, y):
                    field[beyond + y * pitch] = put_back(field[beyond + y * pitch], field[spare + y])
