"""The table of colliders in kernels: its rows, and which bodies stand in which.

First come those that push out, kind by kind, then those that reflect, then those that repel.
"""

from typing import Any

import taichi as ti
import taichi.math as tm

from ..kernels.controls import BODY_AXES, BODY_FROM, BODY_TO, BODY_TURN
from ..kernels.maths import TINY
from ..scene.model import COLLIDERS


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
def posed(table: ti.template(), row: int, reached: float):
    """Middle [m] and axes of a body at a share of the frame, in which it goes straight on and turns about one axis."""
    start = ti.Matrix([[table[row, BODY_AXES + 3 * r + c] for c in ti.static(range(3))] for r in ti.static(range(3))])
    travel = vector_at(table, row, BODY_TO) - vector_at(table, row, BODY_FROM)
    center = vector_at(table, row, BODY_FROM) + travel * reached
    return center, turned_by(vector_at(table, row, BODY_TURN) * reached) @ start


def rows_of(stages: Any, response: int, k: int) -> tuple[int, int]:
    """Where the bodies of kind k and of one response begin in the table, and where they end (asked while compiling)."""
    projecting = tuple(getattr(stages, kind) for kind in COLLIDERS)
    counts = projecting, stages.reflecting, stages.repelling
    first = sum(map(sum, counts[:response])) + sum(counts[response][:k])
    return first, first + counts[response][k]
