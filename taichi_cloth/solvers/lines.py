"""`lines`: XPBD in which every row, every column and every diagonal of springs is solved exactly as a chain, in
implicit steps of second order.

A pull passes through the whole sheet in one iteration and not from neighbour to neighbour, so that one iteration is
enough however stiff and fine the cloth is. Bend springs take one pass of plain XPBD. With `tethers` it is the method
for pinned sheets that are to be stiff at few substeps.

What is left then is the error of the steps. XPBD's own are backward Euler's, wrong by the first order of h. Here a
substep is the two-stage method of Alexander 1977 (*Diagonally implicit Runge–Kutta methods for stiff O.D.E.'s*, section
2), which damps stiff vibrations as well and is of second order: two backward Euler steps of γh with γ = 1 − √½, and a
jump between them.

    (1)  x₁ = x + γh·v₁         v₁ = v + γh·a₁
    (2)  x* = x + (1 − γ)h·v₁   v* = v + (1 − γ)h·a₁ = v + (v₁ − v)·(1 − γ)/γ
    (3)  x₂ = x* + γh·v₂        v₂ = v* + γh·a₂

Forces of air and of bending are those of the place that is reached without them. What contact, tethers and the strain
limit take from a velocity is a stroke c and no acceleration: a jump adds it once, or it would throw back what a
collider has stopped, v* = v + c + (v₁ − c − v)·(1 − γ)/γ, and where it leads into a collider the place alone is
put right.
A frame counts stages: `now.s` goes up by two a substep, and `now.h` is half of one.
"""

from dataclasses import dataclass, replace
from math import ceil, sqrt
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..contact.push_out import push_out
from ..contact.responses import add_repulsion
from ..contact.self_collision import keep_apart
from ..contact.sticking import forget_anchors
from ..contact.tangles import find_tangles
from ..kernels.chains import begin_frame, forget_chains, solve_chains
from ..kernels.controls import KEPT
from ..kernels.forces import add_air, take_acceleration
from ..kernels.grab import lead_held
from ..kernels.places import choose
from ..kernels.springs import RELAX_COMPLIANT, add_bending, for_springs_from, limit_strain
from ..kernels.tethers import pull_tethers
from ..mesh.grid import MOST_BENDS
from ..mesh.topology import Topology
from ..scene.model import FRAME_SECONDS
from ..state import ClothState
from ..state.chains import list_chains, strip_chains
from ..state.fields import like_places
from ..state.pool import attached
from .base import FrameInput, Solver, Stages

GAMMA = 1 - sqrt(0.5)
LENGTH = 2 * GAMMA  # of a backward Euler step, in stages
JUMP = 2 * (1 - 2 * GAMMA)  # from the end of the first one, in stages: (1 − γ)h from its beginning

GRAVITY = 9.81  # [m/s²]
# Chains are linearised where they are, and what tension does across them is not part of that: a substep may not be
# longer than a wave along a hanging thread, √(g·L), takes for so many cells. (Swinging curtain: 1.33 stable, 1.67 not.)
COURANT = 1.4


@dataclass(eq=False)
class Start:
    """What a stage remembers besides where it began, `x_prev`, in the layout that is worked on."""

    velocity: Any  # [m/s]; from the first solution on, what the jump adds to it


@ti.func
def is_first(now: ti.template()):
    """Whether this is the first stage of a substep."""
    return now.s % 2 == 0


@ti.func
def end_of(now: ti.template()):
    """When the stage ends, in stages from the beginning of the frame."""
    end = now.s + 1.0
    if is_first(now):
        end = now.s + LENGTH
    return end


@ti.func
def coast(cloth: ti.template(), kept: float, h: float):
    """v ← kept·v; a pin stays at rest. x ← x + h·v, and remembers where a stage began."""
    for i in range(cloth.slot_count[None]):
        x, velocity = cloth.x[i], cloth.velocity[i] * kept
        velocity = choose(cloth.inverse_mass[i] > 0.0, velocity, velocity * 0.0)
        cloth.velocity[i] = velocity
        cloth.start.velocity[i] = velocity
        cloth.x_prev[i] = x
        cloth.x[i] = x + velocity * h


@ti.func
def accelerate(cloth: ti.template(), controls: ti.template(), h: float):
    """v ← v + h·a, x ← x + h²·a."""
    for i in range(cloth.slot_count[None]):
        gained = take_acceleration(cloth, i, controls) * h
        gained = choose(cloth.inverse_mass[i] > 0.0, gained, gained * 0.0)
        cloth.velocity[i] = cloth.velocity[i] + gained
        cloth.x[i] = cloth.x[i] + gained * h


@ti.func
def prepare_jump(cloth: ti.template()):
    """What (2) adds to a velocity, before contact takes from it."""
    for i in range(cloth.slot_count[None]):
        gained = cloth.velocity[i] - cloth.start.velocity[i]
        cloth.start.velocity[i] = gained * ti.static((1 - GAMMA) / GAMMA - 1)


@ti.func
def finish(cloth: ti.template(), first: bool, kept: float, ahead: float):
    """The jump (2), or after a second stage v ← kept·v."""
    for i in range(cloth.slot_count[None]):
        x, velocity = cloth.x[i], cloth.velocity[i]
        cloth.x_prev[i] = x
        if first:
            x = choose(cloth.inverse_mass[i] > 0.0, x + velocity * ahead, x)
            velocity = velocity + cloth.start.velocity[i]
        else:
            velocity = velocity * kept
        cloth.x[i] = x
        cloth.velocity[i] = velocity


@ti.func
def before(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    if now.s == 0:
        begin_frame(cloth)
    h, kept = now.h * LENGTH, 1.0
    if is_first(now):
        kept = now.controls[KEPT]
    find_tangles(cloth, stages, now)
    forget_anchors(cloth, stages, now)
    coast(cloth, kept, h)
    lead_held(cloth, stages, now, end_of(now))
    add_air(cloth, stages, ti.static(now._replace(h=2.0 * now.h)), 0.5 * end_of(now))
    add_repulsion(cloth, stages, now, end_of(now))
    add_bending(cloth, stages, now.controls, h)
    accelerate(cloth, now.controls, h)
    forget_chains(cloth)


@ti.func
def sweep(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    h = now.h * LENGTH
    solve_chains(cloth, stages, now.controls, h)
    first = cloth.chains.first_bend[None]
    for_springs_from(cloth, stages, first, MOST_BENDS, RELAX_COMPLIANT, now.controls, h)


@ti.func
def after(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    prepare_jump(cloth)
    pull_tethers(cloth, stages, ti.static(now._replace(lasts=LENGTH)))
    keep_apart(cloth, stages, ti.static(now._replace(lasts=LENGTH)))
    push_out(cloth, stages, ti.static(now._replace(s=end_of(now) - 1.0, lasts=LENGTH)))
    limit_strain(cloth, stages, now.controls, now.h * LENGTH)
    ahead = 0.0
    if is_first(now):
        ahead = JUMP
    finish(cloth, is_first(now), now.controls[KEPT], now.h * ahead)
    # What is led takes part in the jump: dashpots divide the way that it goes in a stage by the stage's length.
    lead_held(cloth, stages, now, end_of(now) + ahead)
    pull_tethers(cloth, stages, ti.static(now._replace(pushes=False)))
    push_out(cloth, stages, ti.static(now._replace(s=end_of(now) + ahead - 1.0, lasts=ahead, pushes=False)))


class Lines(Solver):
    """Advances a cloth by XPBD on chains, in substeps of two stages."""

    name = "lines"
    springs = "fabric"
    before = staticmethod(before)
    sweep = staticmethod(sweep)
    after = staticmethod(after)
    needs_rows = True
    constrains = False  # springs push velocities themselves

    def __init__(
        self, cloth: ClothState, topology: Topology, stiffness: NDArray[np.float64], stages: Stages, path: str
    ) -> None:
        super().__init__(cloth, topology, stiffness, stages, path)
        attached(self.work, "start", lambda: Start(like_places(self.work)))
        if self.work.in_lanes:
            strip_chains(self.work, topology, stiffness)
        else:
            list_chains(self.work, topology)

        threads = topology.rest[topology.family("structural")]
        side = float(np.ptp(topology.start, axis=0).max())
        self.crossing = sqrt(GRAVITY * side) / float(threads.min()) if len(threads) else 0.0  # [cells/s]

    def least_substeps(self, damping_time: float) -> int:
        return max(super().least_substeps(damping_time), ceil(FRAME_SECONDS * self.crossing / COURANT))

    def advance_frame(self, frame: FrameInput) -> None:
        controls = frame.controls.copy()
        controls[KEPT] = sqrt(controls[KEPT])  # half of it before a substep and half behind
        span = (2 * frame.span[0], 2 * frame.span[1])
        super().advance_frame(replace(frame, substeps=2 * frame.substeps, h=frame.h / 2, controls=controls, span=span))
