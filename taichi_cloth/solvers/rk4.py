"""`rk4`: the classical Runge–Kutta method with four stages, on the forces of `spring`. Fourth order: the method to
compare the others with where the motion is smooth (Hairer, Nørsett and Wanner 1993, *Solving Ordinary Differential
Equations I*, table II.1.2).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..contact.push_out import push_out
from ..contact.responses import add_repulsion
from ..contact.self_collision import keep_apart
from ..contact.sticking import forget_anchors
from ..contact.tangles import find_tangles
from ..kernels.controls import KEPT
from ..kernels.forces import add_air, take_acceleration
from ..kernels.grab import lead_held
from ..kernels.maths import TINY
from ..kernels.places import choose
from ..kernels.springs import add_spring_forces, limit_strain
from ..kernels.tethers import pull_tethers
from ..mesh.frequency import stable_runge_kutta_substeps
from ..mesh.topology import Topology
from ..scene.model import FRAME_SECONDS
from ..state import ClothState
from ..state.fields import like_places
from ..state.pool import attached
from .base import ExplicitSolver, Stages

MOST_DAMPING = 1.0  # of a substep: beyond, an explicit step overshoots


@dataclass(eq=False)
class Slopes:
    """What a substep remembers besides its start `x_prev`, in the layout that is worked on."""

    first_velocity: Any  # [m/s] at the start of the substep
    velocity: Any  # [m/s] mean of the stages so far, by their weights
    acceleration: Any  # [m/s²] the same


def slopes_of(work: Any) -> Slopes:
    """The slopes of a state."""
    return attached(work, "slopes", lambda: Slopes(*(like_places(work) for _ in range(3))))


@ti.func
def begin(cloth: ti.template()):
    """Remembers the start of the substep; what cannot move has no velocity."""
    for i in range(cloth.slot_count[None]):
        v = cloth.velocity[i]
        v = choose(cloth.inverse_mass[i] > 0.0, v, v * 0.0)
        cloth.x_prev[i] = cloth.x[i]
        cloth.velocity[i] = v
        cloth.slopes.first_velocity[i] = v
        cloth.slopes.velocity[i] = v * 0.0
        cloth.slopes.acceleration[i] = v * 0.0


@ti.func
def go_on(cloth: ti.template(), controls: ti.template(), rate: float, weight: float, ahead: float):
    """Adds the slope of this stage to the mean, and from the start goes `ahead` [s] along it.

    `rate` [1/s] is that at which velocity is lost: damping is one more acceleration here.
    """
    for i in range(cloth.slot_count[None]):
        v = cloth.velocity[i]
        a = take_acceleration(cloth, i, controls) - v * rate
        a = choose(cloth.inverse_mass[i] > 0.0, a, a * 0.0)
        cloth.slopes.velocity[i] = cloth.slopes.velocity[i] + v * weight
        cloth.slopes.acceleration[i] = cloth.slopes.acceleration[i] + a * weight
        cloth.x[i] = cloth.x_prev[i] + v * ahead
        cloth.velocity[i] = cloth.slopes.first_velocity[i] + a * ahead


@ti.func
def finish(cloth: ti.template(), h: float):
    """From the start along the mean slope."""
    for i in range(cloth.slot_count[None]):
        cloth.x[i] = cloth.x_prev[i] + cloth.slopes.velocity[i] * h
        cloth.velocity[i] = cloth.slopes.first_velocity[i] + cloth.slopes.acceleration[i] * h


@ti.func
def add_slope(cloth: ti.template(), stages: ti.template(), now: ti.template(), stage: int):
    """One of the four slopes. What is held is where the hand is at that time."""
    outer = stage == 0 or stage == 3
    time = ti.select(stage == 0, 0.0, ti.select(stage == 3, 1.0, 0.5))  # of this slope, in substeps
    lead_held(cloth, stages, now, now.s + time)
    add_air(cloth, stages, now, now.s + time)
    add_repulsion(cloth, stages, now, now.s + time)
    add_spring_forces(cloth, stages, now.controls, now.h)
    rate = ti.min(-ti.log(ti.max(now.controls[KEPT], TINY)), MOST_DAMPING) / now.h
    go_on(cloth, now.controls, rate, 1.0 / 6.0 if outer else 1.0 / 3.0, now.h if stage == 2 else 0.5 * now.h)


@ti.func
def after(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """One substep."""
    find_tangles(cloth, stages, now)
    forget_anchors(cloth, stages, now)
    begin(cloth)
    if ti.static(cloth.gathers):  # its loops are parallel: they may not stand in another
        for stage in ti.static(range(4)):
            add_slope(cloth, stages, now, stage)
    else:
        for stage in range(4):
            add_slope(cloth, stages, now, stage)
    finish(cloth, now.h)
    lead_held(cloth, stages, now, now.s + 1.0)
    pull_tethers(cloth, stages, now)
    keep_apart(cloth, stages, now)
    push_out(cloth, stages, now)
    limit_strain(cloth, stages, now.controls, now.h)


class Rk4(ExplicitSolver):
    """Advances a cloth by the classical Runge–Kutta method."""

    name = "rk4"
    springs = "fabric"
    after = staticmethod(after)

    def __init__(
        self, cloth: ClothState, topology: Topology, stiffness: NDArray[np.float64], stages: Stages, path: str
    ) -> None:
        super().__init__(cloth, topology, stiffness, stages, path)
        slopes_of(self.work)

    def least_substeps(self, damping_time: float) -> int:
        return stable_runge_kutta_substeps(self.frequency, damping_time, FRAME_SECONDS)
