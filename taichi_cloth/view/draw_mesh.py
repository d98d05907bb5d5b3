"""What every view draws: a soup of coloured triangles, and the light that falls on it."""

from dataclasses import dataclass

import taichi as ti

from taichi_cloth.scene.model import Vec3


@dataclass(eq=False)
class DrawMesh:
    """A triangle soup: corners 3t, 3t + 1 and 3t + 2 belong to triangle t.

    The fields are as long as the largest frame needs; a frame uses their first `corners` elements.
    Triangles that start at corner `two_sided_from` or later are lit from both sides (cloth), earlier
    ones from the side their normals point to (ground, colliders). Neither kind is ever culled.
    """

    position: ti.MatrixField  # world space, m, shape (capacity,) of vec3 f32
    normal: ti.MatrixField  # any length, shape (capacity,) of vec3 f32
    colour: ti.MatrixField  # linear factors 0..1, shape (capacity,) of vec3 f32
    corners: int = 0
    two_sided_from: int = 0


@dataclass(frozen=True)
class Light:
    """A point light whose strength does not fall off with distance."""

    position: Vec3  # world space, m
    colour: Vec3  # linear factors 0..1


@dataclass(frozen=True)
class Lighting:
    """All the light of a picture, and the colour where there is no triangle."""

    ambient: Vec3  # linear factors 0..1
    lights: tuple[Light, ...]
    background: Vec3  # linear factors 0..1
