"""Motion of particles whose velocity is a field of its own."""

import taichi as ti

from .forces import acceleration_of
from .places import choose


@ti.func
def kick(cloth: ti.template(), controls: ti.template(), h: float, kept: float):
    """v ← kept·v + h·a; a pin stays at rest."""
    for i in range(cloth.slot_count[None]):
        velocity = cloth.velocity[i] * kept + acceleration_of(cloth, i, controls) * h
        cloth.velocity[i] = choose(cloth.inverse_mass[i] > 0.0, velocity, velocity * 0.0)


@ti.func
def drift(cloth: ti.template(), h: float):
    """x ← x + h·v, and remembers where the particle was and where it would be without constraints."""
    for i in range(cloth.slot_count[None]):
        x = cloth.x[i]
        there = x + cloth.velocity[i] * h
        cloth.x_prev[i] = x
        cloth.x[i] = there
        cloth.predicted[i] = there


@ti.func
def take_up_corrections(cloth: ti.template(), h: float):
    """Adds what constraints and contact moved since `drift`: v = (x − x_prev)/h, without its rounding."""
    for i in range(cloth.slot_count[None]):
        change = (cloth.x[i] - cloth.predicted[i]) / h
        cloth.velocity[i] = cloth.velocity[i] + choose(cloth.inverse_mass[i] > 0.0, change, change * 0.0)
