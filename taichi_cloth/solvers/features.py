"""What a solver is compiled for, and the arguments of a frame."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..collision.shapes import SHAPES
from ..kernels.step_params import StepContext
from ..scene.collider_schema import RESPONSES
from ..state.contact_data import SdfGrids
from ..state.surface_data import DeformingSurfaces


@dataclass(frozen=True)
class Features:
    """The features that a scene uses. They are compiled into the kernels: one that is False, 0 or None is left out."""

    wind: bool = False
    colliders: tuple[tuple[int, ...], ...] = ((0,) * len(SHAPES),) * len(RESPONSES)
    """Number of colliders by response and shape."""
    sdf: SdfGrids | None = None
    """Signed distance grids of rigid mesh colliders."""
    surfaces: DeformingSurfaces | None = None
    """Triangles of deforming mesh colliders."""
    continuous: bool = False
    """Continuous collision detection of at least one collider."""
    triangles: bool = False
    """At least one collider collides with triangles."""
    soft_compression: bool = False
    """Springs are softer in compression than in tension (`fabric.compression` is below 1)."""
    spring_damping: bool = False
    strain_limit: int = 0
    """Iterations of the strain limit."""
    tethers: bool = False
    max_distances: bool = False
    attachments: bool = False
    self_collision: bool = False
    self_triangles: bool = False
    """Self-collision of triangles and edges, not of particles only."""
    penetration_free: bool = False
    untangle: bool = False
    static_friction: bool = False
    friction_sums: bool = False
    """Friction with colliders is bounded by the sum over the iterations of a substep."""
    bending: bool = False
    membrane: bool = False
    """The cloth is a membrane, not a network of springs."""
    stores_velocity: bool = False
    """The solver stores velocities, instead of x − x_prev."""
    needs_previous_positions: bool = True

    @property
    def collider_count(self) -> int:
        """Number of rigid colliders."""
        return sum(map(sum, self.colliders))

    @property
    def has_surfaces(self) -> bool:
        return self.surfaces is not None


@dataclass(frozen=True)
class FrameInput:
    """The arguments of one frame. `kernels/step_params.py` names the columns of both arrays."""

    substeps: int
    iterations: int
    h: float
    """Length of a substep [s]."""
    grabbed_count: int
    params: NDArray[np.float32]
    """(PARAM_COUNT,)."""
    colliders: NDArray[np.float32]
    """(colliders + attachments, COLLIDER_COLUMNS)."""
    span: tuple[int, int] = (0, 0)
    """First substep and the one after the last; all if empty."""

    @property
    def first(self) -> int:
        return self.span[0]

    @property
    def last(self) -> int:
        """The substep after the last."""
        return self.span[1] or self.substeps

    def by_substep(self) -> Iterator["FrameInput"]:
        """Yield the frame's substeps one by one, which give the same bits as all at once."""
        return (replace(self, span=(s, s + 1)) for s in range(self.substeps))

    @property
    def arguments(self) -> tuple[object, ...]:
        """All fields but the span, in order, as `run_frame` takes them."""
        return self.substeps, self.iterations, self.h, self.grabbed_count, self.params, self.colliders

    @property
    def shared_arguments(self) -> dict[str, object]:
        """The fields of `StepContext` that are equal for all substeps, by name."""
        per_substep = {"s", *StepContext._field_defaults}
        return {name: getattr(self, name) for name in StepContext._fields if name not in per_substep}
