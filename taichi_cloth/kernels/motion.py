"""How particles move: on by themselves, and when something moves them."""

import taichi as ti

from .forces import take_acceleration
from .places import choose


@ti.func
def move_freely(
    cloth: ti.template(), stages: ti.template(), controls: ti.template(), h: float, kept: float, ahead: float
):
    """v ← kept·v + h·a; a pin stays at rest. Then x ← x + ahead·v. Remembers where the particle was, if it must."""
    for i in range(cloth.slot_count[None]):
        x, velocity = cloth.x[i], cloth.velocity[i] * kept + take_acceleration(cloth, i, controls) * h
        velocity = choose(cloth.inverse_mass[i] > 0.0, velocity, velocity * 0.0)
        cloth.velocity[i] = velocity
        cloth.x[i] = x + velocity * ahead
        if ti.static(stages.constrained):
            cloth.x_prev[i] = x


@ti.func
def displace(cloth: ti.template(), stages: ti.template(), i: int, move, h):
    """Moves a particle within a step of h seconds: x ← x + move, v ← v + move/h.

    The sum of it all is the v = (x − x_prev)/h of position-based dynamics, without the rounding of every x over h.
    Times 1/h, which is found once: six divisions for each spring were a sixth of a frame of `xpbd`.
    """
    cloth.x[i] = cloth.x[i] + move
    if ti.static(stages.own_velocity):
        cloth.velocity[i] = cloth.velocity[i] + move * (1.0 / h)


@ti.func
def strike(cloth: ti.template(), stages: ti.template(), i: int, gained, h):
    """Changes a particle's velocity [m/s] and leaves it where it is."""
    if ti.static(stages.own_velocity):
        cloth.velocity[i] = cloth.velocity[i] + gained
    else:
        cloth.x_prev[i] = cloth.x_prev[i] - gained * h


@ti.func
def put_right(cloth: ti.template(), stages: ti.template(), now: ti.template(), i: int, move):
    """Moves a particle that is where it cannot be."""
    if ti.static(now.pushes):
        displace(cloth, stages, i, move, now.h * now.lasts)
    else:
        cloth.x[i] = cloth.x[i] + move
