"""How a body of the table in `controls.py` stands at a time within the frame."""

import taichi as ti
import taichi.math as tm

from .controls import BODY_AXES, BODY_FROM, BODY_GROWTH, BODY_MARGIN, BODY_TO, BODY_TURN
from .maths import TINY


@ti.func
def vector_at(table: ti.template(), row: int, column: int) -> tm.vec3:
    """Three neighbouring columns of a table as a vector."""
    return tm.vec3(table[row, column], table[row, column + 1], table[row, column + 2])


@ti.func
def turned_by(vector: tm.vec3):
    """3×3 matrix that turns about a vector by its length [radians] (Rodrigues)."""
    angle = vector.norm()
    k = vector / ti.max(angle, TINY)
    across = ti.Matrix([[0.0, -k.z, k.y], [k.z, 0.0, -k.x], [-k.y, k.x, 0.0]])
    return ti.Matrix.identity(ti.f32, 3) + ti.sin(angle) * across + (1.0 - ti.cos(angle)) * (across @ across)


@ti.func
def posed(table: ti.template(), row: int, share: float):
    """Its middle [m] and its axes after a share of the frame, in which it goes straight on and turns about one axis."""
    start = ti.Matrix([[table[row, BODY_AXES + 3 * r + c] for c in ti.static(range(3))] for r in ti.static(range(3))])
    travel = vector_at(table, row, BODY_TO) - vector_at(table, row, BODY_FROM)
    center = vector_at(table, row, BODY_FROM) + travel * share
    return center, turned_by(vector_at(table, row, BODY_TURN) * share) @ start


@ti.func
def margin_at(table: ti.template(), row: int, share: float) -> float:
    """Its margin [m] then; negative while it is smaller than it looks (`contact/release.py`)."""
    return table[row, BODY_MARGIN] + table[row, BODY_GROWTH] * share
