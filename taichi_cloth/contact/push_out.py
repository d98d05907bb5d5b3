"""Keeps particles out of spheres, boxes and the ground by moving them to the surface, with friction."""

import taichi as ti
import taichi.math as tm

from ..kernels.controls import (
    BOX_CENTER,
    BOX_FRICTION,
    BOX_HALF,
    BOX_MARGIN,
    GROUND_FRICTION,
    GROUND_HEIGHT,
    SPHERE_FRICTION,
    SPHERE_FROM,
    SPHERE_REACH,
    SPHERE_TO,
)
from ..kernels.maths import friction_slide, out_of_box, out_of_sphere


@ti.func
def vector_at(table: ti.template(), row: int, column: int) -> tm.vec3:
    """Three neighbouring columns of a table as a vector."""
    return tm.vec3(table[row, column], table[row, column + 1], table[row, column + 2])


@ti.func
def push_out(
    cloth: ti.template(),
    stages: ti.template(),
    spheres: ti.template(),
    boxes: ti.template(),
    ground: ti.template(),
    passed: float,
    step: float,
):
    """Moves every free particle out of the scene's colliders.

    `passed` is the share of the frame that is over at the end of this substep and `step` the substep's
    share of the frame: a sphere travels in a straight line from its first to its last place of the frame.
    """
    if ti.static(stages.has_contact):
        for i in range(cloth.particle_count[None]):
            if cloth.inverse_mass[i] > 0.0:
                x = cloth.x[i]
                if ti.static(stages.spheres):
                    for s in range(spheres.shape[0]):
                        travel = vector_at(spheres, s, SPHERE_TO) - vector_at(spheres, s, SPHERE_FROM)
                        center = vector_at(spheres, s, SPHERE_FROM) + travel * passed
                        push = out_of_sphere(x, center, spheres[s, SPHERE_REACH])
                        x += push + friction_slide(
                            push, x - cloth.x_prev[i] - travel * step, spheres[s, SPHERE_FRICTION]
                        )
                if ti.static(stages.boxes):
                    for b in range(boxes.shape[0]):
                        push = out_of_box(
                            x, vector_at(boxes, b, BOX_CENTER), vector_at(boxes, b, BOX_HALF), boxes[b, BOX_MARGIN]
                        )
                        x += push + friction_slide(push, x - cloth.x_prev[i], boxes[b, BOX_FRICTION])
                if ti.static(stages.ground):
                    push = tm.vec3(0.0, tm.max(ground[0, GROUND_HEIGHT] - x[1], 0.0), 0.0)
                    x += push + friction_slide(push, x - cloth.x_prev[i], ground[0, GROUND_FRICTION])
                cloth.x[i] = x
