"""Rows of the table of colliders, read in kernels."""

import taichi as ti
import taichi.math as tm

from ..kernels.maths import TINY


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
