"""The sweep over a grid in strips (`mesh/strips.py`): eight springs, or eight cells, at once."""

from operator import attrgetter
from typing import Any, NamedTuple

import taichi as ti
import taichi.math as tm

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
    ONWARD,
    OVER,
    REACH,
    ROW_KINDS,
    ROW_MASK,
    ROW_SHIFT,
    STRIDE,
)
from .places import from_previous, next_lane, put_back, spread


class Treatment(NamedTuple):
    """What is done to a spring that moves its ends."""

    apply: Any
    damped: tuple[str, ...] = ()  # fields that are read where springs have dashpots

    def changes(self, stages: Any) -> tuple[str, ...]:
        """Names of the fields that it changes at the ends."""
        return ("x", "velocity") if stages.own_velocity else ("x",)

    def fields(self, stages: Any) -> tuple[str, ...]:
        """Names of all fields that it uses there."""
        return (*self.changes(stages), "inverse_mass", *(self.damped if stages.spring_damping else ()))


class Share(NamedTuple):
    """What a spring gives to the sum of its end a and takes from that of b; by name the fields it reads there."""

    of: Any
    reads: tuple[str, ...]
    into: str
    damped: tuple[str, ...] = ()

    def fields(self, stages: Any) -> tuple[str, ...]:
        """All fields that are read."""
        return (*self.reads, *(self.damped if stages.spring_damping else ()))


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
                for name in ti.static(treat.fields(stages)):
                    field = ti.static(getattr(cloth, name))
                    field[spare + y] = next_lane(field[beyond + y * pitch])
            for y in range(rows - p[DOWN]):
                if in_pass(p, y):
                    a, e, k = row_of(p, y, rows, pitch)
                    treat.apply(cloth, stages, a + i, spare + y, e + i, cloth.stiffness[k + i], controls, h)
            for y in range(rows - p[DOWN]):
                if in_pass(p, y):
                    for name in ti.static(treat.changes(stages)):
                        field = ti.static(getattr(cloth, name))
                        field[beyond + y * pitch] = put_back(field[beyond + y * pitch], field[spare + y])


# -- sums: nothing moves, so no spring has to wait for another -------------------------------------------------------


@ti.func
def fetch_beyond(cloth: ti.template(), names: ti.template(), into: ti.template(), width: ti.template()):
    """The first columns of every strip, as the strip before it sees them: behind the grid, `width` slots for each row.

    What is read, by the names of the fields, one lane earlier; the sums there, in field `into`, begin at zero.
    """
    pitch, spare = cloth.pitch[None], cloth.slot_count[None]
    sums = ti.static(attrgetter(into)(cloth))
    for y in range(cloth.rows[None]):
        for j in range(width):
            here, there = y * pitch + j, spare + y * width + j
            for name in ti.static(names):
                field = ti.static(attrgetter(name)(cloth))
                field[there] = next_lane(field[here])
            sums[there] = spread(tm.vec3(0.0), sums[there])


@ti.func
def bring_back(cloth: ti.template(), into: ti.template(), width: ti.template()):
    """Adds what was summed there to the strips it belongs to."""
    pitch, spare = cloth.pitch[None], cloth.slot_count[None]
    sums = ti.static(attrgetter(into)(cloth))
    for y in range(cloth.rows[None]):
        for j in range(width):
            here = y * pitch + j
            sums[here] = sums[here] + from_previous(sums[spare + y * width + j])


@ti.func
def sum_strip_springs(cloth: ti.template(), stages: ti.template(), share: ti.template(), controls: ti.template(), h):
    """Every spring's share to the sums of both its ends, in one pass over the grid: what a particle gets from the
    springs that begin at it stays in registers.
    """
    rows, pitch, spare = cloth.rows[None], cloth.pitch[None], cloth.slot_count[None]
    fetch_beyond(cloth, ti.static(share.fields(stages)), share.into, REACH)
    sums = ti.static(attrgetter(share.into)(cloth))
    for y in range(rows):
        for i in range(pitch):
            a = y * pitch + i
            total = sums[a]
            for d in ti.static(range(len(ONWARD))):
                down, along = ti.static(ONWARD[d])
                if cloth.used[d] and 0 <= y + down < rows:
                    top = y + ti.static(min(down, 0))
                    k = (d * ROW_KINDS + row_kind(top, rows)) * pitch + i
                    b = a + down * pitch + along
                    if i + along >= pitch:
                        b = spare + (y + down) * REACH + i + along - pitch
                    e = (d * rows + top) * pitch + i
                    given = share.of(cloth, stages, a, b, e, cloth.stiffness[k], controls, h)
                    total += given
                    sums[b] = sums[b] - given
            sums[a] = total
    bring_back(cloth, share.into, REACH)
