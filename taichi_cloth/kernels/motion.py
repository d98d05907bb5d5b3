"""Motion of particles whose velocity is a field of its own."""

import taichi as ti

from .forces import take_acceleration
from .places import choose


@ti.func
def move_freely(
    cloth: ti.template(), stages: ti.template(), controls: ti.template(), h: float, kept: float, ahead: float
):
    """v ← kept·v + h·a; a pin stays at rest. Then x ← x + ahead·v.

    Remembers where the particle was, and where it would be without constraints, if there are any.
    """
    for i in range(cloth.slot_count[None]):
        x, velocity = cloth.x[i], cloth.velocity[i] * kept + take_acceleration(cloth, i, controls) * h
        velocity = choose(cloth.inverse_mass[i] > 0.0, velocity, velocity * 0.0)
        there = x + velocity * ahead
        cloth.velocity[i] = velocity
        cloth.x[i] = there
        if ti.static(stages.constrained):
            cloth.x_prev[i] = x
            cloth.predicted[i] = there


@ti.func
def predict_here(cloth: ti.template(), stages: ti.template()):
    """What moves particles from here on, velocities take up later."""
    if ti.static(stages.constrained):
        for i in range(cloth.slot_count[None]):
            cloth.predicted[i] = cloth.x[i]


@ti.func
def take_up_corrections(cloth: ti.template(), stages: ti.template(), h: float):
    """Adds what constraints and contact moved since it was predicted: v = (x − x_prev)/h, without its rounding."""
    if ti.static(stages.constrained):
        for i in range(cloth.slot_count[None]):
            change = (cloth.x[i] - cloth.predicted[i]) / h
            cloth.velocity[i] = cloth.velocity[i] + choose(cloth.inverse_mass[i] > 0.0, change, change * 0.0)
