"""`verlet`: damped Verlet, then relaxation of distances. The method of the browser demos.

Position-based dynamics (Müller et al. 2007) in its plainest form: velocity is the difference of two
positions, and a stiffness of 0…1 says how much of a length error one iteration puts right. What stiffness
means therefore changes with substeps, iterations and grid.
"""

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..contact.push_out import push_out
from ..kernels.controls import KEPT, STIFFNESS
from ..kernels.forces import gather_accelerations
from ..kernels.grab import lead_held
from ..kernels.maths import verlet_step
from ..kernels.relax import relax_springs
from ..state import ClothState
from .base import FrameInput, Stages, row, table


@ti.func
def predict(cloth: ti.template(), kept: float, h: float):
    """Every particle goes on as it moved, pulled by the external forces; a pin stays."""
    for i in range(cloth.particle_count[None]):
        x = cloth.x[i]
        if cloth.inverse_mass[i] > 0.0:
            cloth.x[i] = verlet_step(x, cloth.x_prev[i], kept, cloth.acceleration[i], h)
        cloth.x_prev[i] = x


@ti.kernel
def advance(
    cloth: ti.template(),
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
    """A whole frame in one launch: a launch for every colour of every iteration would cost 20 times as much."""
    ti.loop_config(serialize=True)
    for s in range(substeps):
        step = 1.0 / substeps
        passed = (s + 1) * step
        gather_accelerations(cloth, stages, controls, h, s * h)
        predict(cloth, controls[KEPT], h)
        lead_held(cloth, held, controls, passed)
        for _ in range(iterations):
            relax_springs(cloth, controls[STIFFNESS])
            push_out(cloth, stages, spheres, boxes, ground, passed, step)


@ti.kernel
def rescale_velocities(cloth: ti.template(), ratio: float):
    for i in range(cloth.particle_count[None]):
        cloth.x_prev[i] = cloth.x[i] - (cloth.x[i] - cloth.x_prev[i]) * ratio


@ti.kernel
def throw(cloth: ti.template(), i: int, dx: float, dy: float, dz: float):
    cloth.x_prev[i] = cloth.x[i] - ti.math.vec3(dx, dy, dz)


class Verlet:
    """Advances a cloth by damped Verlet and relaxation; see `base.Solver` for the contract."""

    name = "verlet"
    springs = "springs"

    def __init__(self, cloth: ClothState, stages: Stages) -> None:
        self.cloth = cloth
        self.stages = stages

    def close(self) -> None:
        pass  # all it needs is in the cloth's own fields

    def reset(self) -> None:
        pass

    def advance_frame(self, frame: FrameInput) -> None:
        advance(self.cloth, self.stages, *frame.arguments)

    def velocities(self, h: float) -> NDArray[np.float64]:
        x, x_prev = (self.cloth.taken(f).astype(np.float64) for f in (self.cloth.x, self.cloth.x_prev))
        return (x - x_prev) / h

    def set_velocity(self, particle: int, velocity: NDArray[np.float64], h: float) -> None:
        throw(self.cloth, particle, *(float(v) * h for v in velocity))

    def change_substep(self, old: float, new: float) -> None:
        rescale_velocities(self.cloth, new / old)

    def moving(self) -> dict[str, NDArray[np.float32]]:
        return {}  # velocity is in the cloth's two positions

    def restore(self, moving: dict[str, NDArray[np.float32]]) -> None:
        pass
