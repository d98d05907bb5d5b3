"""What a solver is given, what it must offer, and the frame that all of them share."""

from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from .. import lanes
from ..kernels.layout import load, store
from ..mesh.topology import Topology
from ..state import ClothState

# How a kernel takes the rows and tables of a `FrameInput`.
row = ti.types.ndarray(dtype=ti.f32, ndim=1)
table = ti.types.ndarray(dtype=ti.f32, ndim=2)


@dataclass(frozen=True)
class Stages:
    """The stages a scene names. Part of the compiled kernel: a stage that is False is not compiled."""

    wind: bool = False
    spheres: bool = False
    boxes: bool = False
    ground: bool = False
    spring_damping: bool = False
    strain_limit: bool = False
    own_velocity: bool = False  # the solver keeps velocity as a field and not as x − x_prev


@dataclass(frozen=True)
class FrameInput:
    """What steers one frame. Columns of the rows and tables: `kernels/controls.py`."""

    substeps: int
    iterations: int
    h: float  # [s] length of a substep
    held: int  # index of the held particle, -1 for none
    controls: NDArray[np.float32]  # (controls.COUNT,)
    spheres: NDArray[np.float32]  # (spheres, SPHERE_COLUMNS)
    boxes: NDArray[np.float32]  # (boxes, BOX_COLUMNS)
    ground: NDArray[np.float32]  # (0 or 1, GROUND_COLUMNS)

    @property
    def arguments(self) -> tuple[Any, ...]:
        """All of it in the order above, as `run_frame` takes it."""
        return tuple(getattr(self, f.name) for f in fields(self))


@ti.kernel
def run_frame(
    step: ti.template(),
    cloth: ti.template(),
    work: ti.template(),
    stages: ti.template(),
    steps: int,
    substeps: int,
    iterations: int,
    h: float,
    held: int,
    controls: row,
    spheres: table,
    boxes: table,
    ground: table,
):
    """A whole frame in one launch: a launch for every colour of every iteration would cost 20 times as much.

    `work` is the layout that `step` moves: the cloth itself, or its strips.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        load(work, cloth, stages)
        for s in range(steps):
            step(work, stages, s, substeps, iterations, h, held, controls, spheres, boxes, ground)
        store(work, cloth, stages)


@ti.kernel
def set_vector(field: ti.template(), i: int, x: float, y: float, z: float):
    field[i] = ti.math.vec3(x, y, z)


class Solver:
    """One method: a `step` that moves the cloth by one substep, and how velocity is kept.

    Positions, pins, forces and contact are the same for all; so is the frame. `path` names the layout that
    is worked on: `list` (springs one by one, any mesh) or `lanes` (eight at a time, grids).
    """

    name: ClassVar[str]
    springs: ClassVar[str]  # the scene's section that holds its spring constants by family
    step: ClassVar[Any]  # Taichi function: (work, stages, s, substeps, iterations, h, held, controls, colliders …)
    paths: ClassVar[tuple[str, ...]] = ("list", "lanes")
    own_velocity: ClassVar[bool] = True
    coloured: ClassVar[bool] = True  # a sweep moves particles as it goes
    iterates: ClassVar[bool] = True  # `iterations` means something
    closing_steps: ClassVar[int] = 0  # calls of `step` after the last substep

    def __init__(
        self, cloth: ClothState, topology: Topology, stiffness: NDArray[np.float64], stages: Stages, path: str
    ) -> None:
        """`stiffness`: of every spring, (E,), in the unit of the section `springs`."""
        self.cloth = cloth
        self.path = path
        self.stages = replace(stages, own_velocity=self.own_velocity)
        coloured = self.coloured or stages.strain_limit
        self._lanes = lanes.take(topology, stiffness, coloured=coloured) if path == "lanes" else None

    def advance_frame(self, frame: FrameInput) -> None:
        """Advances the cloth by `frame.substeps` substeps of `frame.h` seconds."""
        run_frame(
            self.step,
            self.cloth,
            self._lanes or self.cloth,
            self.stages,
            frame.substeps + self.closing_steps,
            *frame.arguments,
        )

    def least_substeps(self, damping_time: float) -> int:
        """The fewest substeps of a frame with which the method is stable, with dashpots of this time [s]."""
        return 1

    def velocities(self, h: float) -> NDArray[np.float64]:
        """Velocity of every particle [m/s], shape (N, 3), after substeps of h seconds."""
        return self.cloth.taken(self.cloth.velocity).astype(np.float64)

    def set_velocities(self, velocities: NDArray[np.float64], h: float) -> None:
        """Gives every particle a velocity [m/s], shape (N, 3), for substeps of h seconds."""
        self.cloth.fill(self.cloth.velocity, velocities)

    def set_velocity(self, particle: int, velocity: NDArray[np.float64], h: float) -> None:
        """Gives one particle a velocity [m/s] for substeps of h seconds."""
        set_vector(self.cloth.velocity, particle, *map(float, velocity))

    def change_substep(self, old: float, new: float) -> None:
        """Keeps every velocity when the length of a substep [s] changes."""

    def close(self) -> None:
        """Gives the fields back that are not the cloth's own."""
        if self._lanes is not None:
            lanes.give_back(self._lanes)
            self._lanes = None
