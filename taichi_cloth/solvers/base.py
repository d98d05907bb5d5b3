"""What a solver is given and what it must offer."""

from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..state import ClothState

# How a kernel takes the rows and tables of a `FrameInput`.
row = ti.types.ndarray(dtype=ti.f32, ndim=1)
table = ti.types.ndarray(dtype=ti.f32, ndim=2)


@dataclass(frozen=True)
class Stages:
    """The stages a scene names. Part of the compiled kernel: a stage that is False is not compiled."""

    wind: bool
    spheres: bool
    boxes: bool
    ground: bool

    @property
    def has_contact(self) -> bool:
        return self.spheres or self.boxes or self.ground


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
        """All of it in the order above, as every frame kernel ends its signature."""
        return tuple(getattr(self, f.name) for f in fields(self))


class Solver(Protocol):
    """One method. It owns how velocity is kept; positions, pins and forces are the same for all."""

    name: str
    springs: str  # the scene's section that holds its spring constants by family
    cloth: ClothState

    def advance_frame(self, frame: FrameInput) -> None:
        """Advances the cloth by `frame.substeps` substeps of `frame.h` seconds."""

    def velocities(self, h: float) -> NDArray[np.float64]:
        """Velocity of every particle [m/s], shape (N, 3), after substeps of h seconds."""

    def set_velocity(self, particle: int, velocity: NDArray[np.float64], h: float) -> None:
        """Gives one particle a velocity [m/s] for substeps of h seconds."""

    def change_substep(self, old: float, new: float) -> None:
        """Keeps every velocity when the length of a substep [s] changes."""

    def reset(self) -> None:
        """Forgets everything that moved; the cloth itself is put back by the simulation."""

    def moving(self) -> dict[str, NDArray[np.float32]]:
        """What a save must hold beside the cloth's positions: arrays of N rows by name."""

    def restore(self, moving: dict[str, NDArray[np.float32]]) -> None:
        """Takes back what `moving` gave."""

    def close(self) -> None:
        """Gives its own fields back."""
