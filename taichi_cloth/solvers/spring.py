"""`spring`: explicit symplectic Verlet on spring-damper forces. Second order, no iteration, and the most accurate
method wherever its small substeps can be paid for (Störmer–Verlet in kick–drift–kick form; Hairer, Lubich and
Wanner 2003, *Geometric numerical integration illustrated by the Störmer–Verlet method*, eq. 1.4).
"""

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..contact.push_out import push_out
from ..kernels.controls import KEPT
from ..kernels.forces import add_air, forget_forces
from ..kernels.grab import lead_held
from ..kernels.motion import drift, kick, take_up_corrections
from ..kernels.springs import for_springs, limit_strain, pull
from ..mesh.frequency import highest_frequency, stable_substeps
from ..mesh.topology import Topology
from ..scene.model import FRAME_SECONDS
from ..state import ClothState
from .base import Solver, Stages


@ti.func
def step(
    cloth: ti.template(),
    stages: ti.template(),
    s: int,
    substeps: int,
    iterations: int,
    h: float,
    held: int,
    controls: ti.template(),
    spheres: ti.template(),
    boxes: ti.template(),
    ground: ti.template(),
):
    """Half a kick opens the frame and half a kick closes it; the two halves between substeps are one."""
    share = 1.0 / substeps
    passed = (s + 1) * share
    forget_forces(cloth)
    add_air(cloth, stages, controls, h, s * h)
    for_springs(cloth, stages, pull, controls, h)
    if s == 0 or s == substeps:
        kick(cloth, controls, 0.5 * h, ti.sqrt(controls[KEPT]))
    else:
        kick(cloth, controls, h, controls[KEPT])
    if s < substeps:
        drift(cloth, h)
        lead_held(cloth, stages, held, controls, passed, h * substeps)
        push_out(cloth, stages, spheres, boxes, ground, passed, share)
        limit_strain(cloth, stages, controls, h)
        take_up_corrections(cloth, h)


class Spring(Solver):
    """Advances a cloth by explicit symplectic Verlet."""

    name = "spring"
    springs = "fabric"
    step = staticmethod(step)
    coloured = False
    iterates = False
    closing_steps = 1

    def __init__(
        self, cloth: ClothState, topology: Topology, stiffness: NDArray[np.float64], stages: Stages, path: str
    ) -> None:
        super().__init__(cloth, topology, stiffness, stages, path)
        self._frequency = highest_frequency(topology, stiffness)

    def least_substeps(self, damping_time: float) -> int:
        return stable_substeps(self._frequency, damping_time, FRAME_SECONDS)
