"""Two other answers to contact than to be pushed out: a velocity that is turned round, and a force.

Both leave a particle where it is. What is reflected therefore sinks in by what it goes in a substep, and by more where
it is pulled on; what is repelled, by what its force takes to hold the cloth.
"""

import taichi as ti

from ..kernels.controls import (
    AREA_DENSITY,
    BODY_FRICTION,
    BODY_FROM,
    BODY_RESTITUTION,
    BODY_SIZE,
    BODY_STIFFNESS,
    BODY_TO,
    BODY_TURN,
)
from ..kernels.forces import velocity_of
from ..kernels.maths import TINY, friction_slide
from ..kernels.motion import strike
from ..kernels.places import cross, dot, length, spread, times
from ..kernels.poses import margin_at, posed, vector_at
from ..scene.model import COLLIDERS, REFLECTION, REPULSION
from .shapes import SHAPES
from .table import rows_of


@ti.func
def moving(table: ti.template(), s: int, seconds: float):
    """How a body goes [m/s] and turns [1/s] in a frame of that length."""
    travel = vector_at(table, s, BODY_TO) - vector_at(table, s, BODY_FROM)
    return travel / seconds, vector_at(table, s, BODY_TURN) / seconds


@ti.func
def met_by(
    cloth: ti.template(),
    stages: ti.template(),
    now: ti.template(),
    k: ti.template(),
    s: int,
    i: int,
    body: ti.template(),
):
    """How far a body would push a particle to its margin [m], and the particle's velocity relative to the surface."""
    center, axes, margin, speed, spin = ti.static(body)
    x = cloth.x[i]
    away = x - spread(center, x)
    size = vector_at(now.bodies, s, BODY_SIZE)
    push = ti.static(SHAPES[COLLIDERS[k]])(stages, axes, size, margin, away)
    surface = spread(speed, x) + cross(spread(spin, x), away)
    return push, velocity_of(cloth, stages, i, now.h) - surface


@ti.func
def reflect(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """Turns round the velocity of what comes nearer to a body within its margin, times the restitution."""
    for k in ti.static(range(len(COLLIDERS))):
        if ti.static(cloth.gathers):
            for s in ti.static(range(*rows_of(stages, REFLECTION, k))):
                reflect_from_one(cloth, stages, now, k, s)
        elif ti.static(stages.reflecting[k] > 0):
            for s in range(ti.static(rows_of(stages, REFLECTION, k)[0]), ti.static(rows_of(stages, REFLECTION, k)[1])):
                reflect_from_one(cloth, stages, now, k, s)


@ti.func
def reflect_from_one(cloth: ti.template(), stages: ti.template(), now: ti.template(), k: ti.template(), s: int):
    table = ti.static(now.bodies)
    restitution, friction = table[s, BODY_RESTITUTION], table[s, BODY_FRICTION]
    reached = (now.s + 1.0) / now.substeps
    center, axes = posed(table, s, reached)
    margin = margin_at(table, s, reached)
    speed, spin = moving(table, s, now.substeps * now.h)
    for i in range(cloth.slot_count[None]):
        push, velocity = met_by(cloth, stages, now, k, s, i, ti.static((center, axes, margin, speed, spin)))
        normal = times(push, 1.0 / ti.max(length(push), TINY))
        gained = times(normal, -(1.0 + restitution) * ti.min(dot(normal, velocity), 0.0))
        gained += friction_slide(gained, velocity + gained, friction)
        free = ti.select(cloth.inverse_mass[i] > 0.0, 1.0, 0.0)
        strike(cloth, stages, i, times(gained, free), now.h)


@ti.func
def add_repulsion(cloth: ti.template(), stages: ti.template(), now: ti.template(), steps: float):
    """Adds the force [N] of every body that repels, after so many substeps of the frame, where the scene has one."""
    for k in ti.static(range(len(COLLIDERS))):
        if ti.static(cloth.gathers):
            for s in ti.static(range(*rows_of(stages, REPULSION, k))):
                repel_from_one(cloth, stages, now, k, s, steps)
        elif ti.static(stages.repelling[k] > 0):
            for s in range(ti.static(rows_of(stages, REPULSION, k)[0]), ti.static(rows_of(stages, REPULSION, k)[1])):
                repel_from_one(cloth, stages, now, k, s, steps)


@ti.func
def repel_from_one(
    cloth: ti.template(), stages: ti.template(), now: ti.template(), k: ti.template(), s: int, steps: float
):
    """A pressure that grows with the depth: each particle stands for its mass over that of a square metre."""
    table = ti.static(now.bodies)
    rate = table[s, BODY_STIFFNESS] / now.controls[AREA_DENSITY]  # [1/s²]
    friction = table[s, BODY_FRICTION]
    center, axes = posed(table, s, steps / now.substeps)
    margin = margin_at(table, s, steps / now.substeps)
    speed, spin = moving(table, s, now.substeps * now.h)
    for i in range(cloth.slot_count[None]):
        push, velocity = met_by(cloth, stages, now, k, s, i, ti.static((center, axes, margin, speed, spin)))
        gained = push * (rate * now.h)  # [m/s] in a substep
        gained += friction_slide(gained, velocity + gained, friction)
        w = cloth.inverse_mass[i]
        mass = ti.select(w > 0.0, 1.0 / ti.max(w, TINY), 0.0)
        cloth.force[i] = cloth.force[i] + times(gained, mass / now.h)
