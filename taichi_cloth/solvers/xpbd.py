"""`xpbd`: position-based dynamics with compliance. Springs have SI constants, and what they mean does not change
with substeps, iterations or grid once the iteration converges (Macklin et al. 2016, *XPBD*, Algorithm 1).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..contact.push_out import push_out
from ..kernels.controls import KEPT, STIFFNESS
from ..kernels.forces import gather_accelerations
from ..kernels.grab import lead_held
from ..kernels.relax import relax_compliant
from ..pool import Pool
from ..state import ClothState, padded
from .base import FrameInput, Stages, row, table


@dataclass(eq=False)
class Scratch:
    """What the method keeps beside the cloth's own fields."""

    velocity: Any  # [m/s] vec3 (N,). Kept, not rebuilt as (x − x_prev)/h: that loses small steps in float32
    predicted: Any  # [m] vec3 (N,) where the particle would be without constraints
    multiplier: Any  # [kg·m] (E,) λ of each spring, summed over the iterations of a substep


def _allocate(particles: int, springs: int) -> Scratch:
    return Scratch(
        velocity=ti.Vector.field(3, ti.f32, particles),
        predicted=ti.Vector.field(3, ti.f32, particles),
        multiplier=ti.field(ti.f32, springs),
    )


_pool = Pool(_allocate)


@ti.func
def predict(cloth: ti.template(), scratch: ti.template(), kept: float, h: float):
    """x̃ = x + h·v + h²·a (step 1); a pin stays."""
    for i in range(cloth.particle_count[None]):
        cloth.x_prev[i] = cloth.x[i]
        if cloth.inverse_mass[i] > 0.0:
            scratch.velocity[i] = scratch.velocity[i] * kept + cloth.acceleration[i] * h
            cloth.x[i] = cloth.x[i] + scratch.velocity[i] * h
        scratch.predicted[i] = cloth.x[i]


@ti.func
def forget_multipliers(cloth: ti.template(), scratch: ti.template()):
    """λ = 0 (step 4): once a substep. Once an iteration would make every spring too soft."""
    for e in range(cloth.batch_first[cloth.batch_count[None]]):
        scratch.multiplier[e] = 0.0


@ti.func
def update_velocities(cloth: ti.template(), scratch: ti.template(), h: float):
    """v = (x − x_prev)/h (step 15), written as what the constraints added to the predicted velocity."""
    for i in range(cloth.particle_count[None]):
        if cloth.inverse_mass[i] > 0.0:
            scratch.velocity[i] = scratch.velocity[i] + (cloth.x[i] - scratch.predicted[i]) / h


@ti.kernel
def advance(
    cloth: ti.template(),
    scratch: ti.template(),
    stages: ti.template(),
    substeps: int,
    iterations: int,
    h: float,
    held: int,
    controls: row,
    spheres: table,
    boxes: table,
    ground: table,
):
    """A whole frame in one launch; steps as numbered in Algorithm 1."""
    ti.loop_config(serialize=True)
    for s in range(substeps):
        step = 1.0 / substeps
        passed = (s + 1) * step
        gather_accelerations(cloth, stages, controls, h, s * h)
        predict(cloth, scratch, controls[KEPT], h)
        lead_held(cloth, held, controls, passed)
        forget_multipliers(cloth, scratch)
        for _ in range(iterations):  # steps 5–13
            relax_compliant(cloth, scratch.multiplier, controls[STIFFNESS], h)
            push_out(cloth, stages, spheres, boxes, ground, passed, step)
        update_velocities(cloth, scratch, h)


@ti.kernel
def throw(cloth: ti.template(), scratch: ti.template(), i: int, vx: float, vy: float, vz: float, h: float):
    velocity = ti.math.vec3(vx, vy, vz)
    scratch.velocity[i] = velocity
    cloth.x_prev[i] = cloth.x[i] - velocity * h


class Xpbd:
    """Advances a cloth by XPBD; see `base.Solver` for the contract."""

    name = "xpbd"
    springs = "fabric"

    def __init__(self, cloth: ClothState, stages: Stages) -> None:
        self.cloth = cloth
        self.stages = stages
        self.scratch = _pool.take(cloth.x.shape[0], cloth.ends.shape[0])
        self.reset()

    def close(self) -> None:
        _pool.give_back(self.scratch)

    def reset(self) -> None:
        self.scratch.velocity.fill(0.0)

    def advance_frame(self, frame: FrameInput) -> None:
        advance(self.cloth, self.scratch, self.stages, *frame.arguments)

    def velocities(self, h: float) -> NDArray[np.float64]:
        return self.cloth.taken(self.scratch.velocity).astype(np.float64)

    def set_velocity(self, particle: int, velocity: NDArray[np.float64], h: float) -> None:
        throw(self.cloth, self.scratch, particle, *(float(v) for v in velocity), h)

    def change_substep(self, old: float, new: float) -> None:
        pass  # velocity is kept as such

    def moving(self) -> dict[str, NDArray[np.float32]]:
        return {"velocity": self.cloth.taken(self.scratch.velocity)}

    def restore(self, moving: dict[str, NDArray[np.float32]]) -> None:
        self.scratch.velocity.from_numpy(padded(moving["velocity"], self.scratch.velocity.shape[0]))
