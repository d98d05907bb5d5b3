"""The sweep over a grid in strips (`mesh/strips.py`): eight springs, or eight cells, at once."""

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
    GROUP,
    GROUPS,
    ROW_KINDS,
    ROW_MASK,
    ROW_SHIFT,
    STRIDE,
)


@ti.func
def for_strip_springs(
    cloth: ti.template(), stages: ti.template(), start: int, treat: ti.template(), controls: ti.template(), h: float
):
    """`treat` on every spring from pass `start` on, pass by pass.

    Within a row first come the springs inside the strips, then those between them. One loop over a table: a copy of
    the body for each direction would compile four times as long.
    """
    pitch = cloth.pitch[None]
    rows = cloth.rows[None]
    for s in range(start, cloth.pass_count[None]):
        p = cloth.passes[s]
        for y in range(rows - p[DOWN]):
            if (y >> p[ROW_SHIFT]) & p[ROW_MASK] == p[COLOUR]:
                a = (y + p[A_ROW]) * pitch
                b = (y + p[B_ROW]) * pitch + p[ALONG]
                e = (p[DIRECTION] * rows + y) * pitch
                kind = y & 1  # EVEN_ROW or ODD_ROW
                if y == 0 or y == rows - 1:
                    kind = EDGE_ROW
                k = (p[DIRECTION] * ROW_KINDS + kind) * pitch
                for g in range(p[GROUPS]):
                    first = p[FIRST] + g * p[STRIDE]
                    end = first + p[GROUP]
                    border = ti.max(first, ti.min(end, pitch - p[ALONG]))
                    for i in range(first, border):
                        treat(cloth, stages, a + i, b + i, e + i, cloth.stiffness[k + i], False, controls, h)
                    for i in range(border, end):
                        treat(cloth, stages, a + i, b + i - pitch, e + i, cloth.stiffness[k + i], True, controls, h)
