"""What every view draws: a soup of coloured triangles."""

from dataclasses import dataclass

import taichi as ti


@dataclass(eq=False)
class DrawMesh:
    """A triangle soup: corners 3t, 3t + 1 and 3t + 2 belong to triangle t. No triangle is ever culled.

    The fields are as long as the largest frame needs; a frame uses their first `corners` elements: the floor, from
    `solids_from` on bodies, from `cloth_from` on the cloth, lit on the side that is seen. Whoever draws takes `colour`
    as it is: all light is in it already, so that window and rasteriser show the same.
    """

    position: ti.MatrixField  # world space, m, shape (capacity,) of vec3 f32
    normal: ti.MatrixField  # of length 1, shape (capacity,) of vec3 f32
    albedo: ti.MatrixField  # without light, factors 0..1, shape (capacity,) of vec3 f32
    colour: ti.MatrixField  # as lit, factors 0..1, shape (capacity,) of vec3 f32
    corners: int = 0
    solids_from: int = 0
    cloth_from: int = 0
