"""The solver interface, its inputs, and the frame loop that all solvers share."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..collision.self_broadphase import check_atomic_sums
from ..collision.shapes import SHAPES
from ..geometry.stability_bounds import max_damping_time, max_frequency, min_force_substeps
from ..geometry.topology import Topology
from ..geometry.weave_model import WeaveModel
from ..kernels.forces import clear_forces
from ..kernels.layout import pack, unpack
from ..kernels.step_params import StepContext, collider_array, param_array
from ..scene.collider_schema import PROJECTION, RESPONSES
from ..scene.schema import FRAME_SECONDS
from ..scene.solver_catalog import SolverInfo
from ..state import ClothState
from ..state import field_pool as fields
from ..state.cloth_state import Layout
from ..state.constraint_data import (
    attach_bending_links,
    attach_max_distances,
    attach_membrane,
    attach_tethers,
    attach_thread_bends,
)
from ..state.contact_data import (
    SdfGrids,
    attach_colored_triangles,
    attach_friction_anchors,
    attach_friction_sums,
    attach_self_contact,
)
from ..state.layouts import acquire_parallel, acquire_simd, release_simd
from ..state.pair_data import attach_pair_data
from ..state.surface_data import DeformingSurfaces, attach_surface_contacts
from ..system.taichi_compat import RepeatedLaunch, no_scalarization
from .graph_runner import GraphRunner
from .pipeline import final_phases


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
    """The cloth has triangles of a membrane or a weave, not a network of springs."""
    weave: int = 0
    """Most pieces of a curve of a weave."""
    thread_bending: bool = False
    """Threads of the weave resist bending by curves."""
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


@ti.func
def no_op(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """An empty phase."""


@ti.kernel
def run_frame(
    predict: ti.template(),
    iterate: ti.template(),
    finalize: ti.template(),
    end_frame: ti.template(),
    cloth: ti.template(),
    layout: ti.template(),
    features: ti.template(),
    first: int,
    last: int,
    substeps: int,
    iterations: int,
    h: float,
    grabbed_count: int,
    params: param_array,
    colliders: collider_array,
):
    """Run the substeps from `first` to `last` on one thread. A launch for every color of every iteration would cost 20
    times as much.

    `layout` is the cloth's serial state, or its SIMD layout. Substep number `substeps` is the final half step of a
    solver that has one: only its `predict` runs. `end_frame` follows the last of the frame.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        pack(layout, cloth, features)
        for s in range(first, last):
            ctx = ti.static(StepContext(s, substeps, h, grabbed_count, params, colliders))
            predict(layout, features, ctx)
            if s < substeps:
                for _k in range(iterations):
                    iterate(layout, features, ctx)
                finalize(layout, features, ctx)
        if last >= substeps:
            end_frame(
                layout,
                features,
                ti.static(StepContext(substeps, substeps, h, grabbed_count, params, colliders)),
            )
        unpack(layout, cloth, features)


@ti.kernel
def reset_forces(cloth: ti.template()):
    clear_forces(cloth)


class Solver:
    """A time integration method. A substep is `predict`, then `iterate` once an iteration, then `finalize`. The frame
    ends with `end_frame`.

    Positions, pins, forces and contact are shared by all solvers, and so is the frame loop. `layout` is the data layout
    the solver works on: serial (one particle after another, any mesh), SIMD (eight at a time, grids) or parallel (the
    serial fields, with a thread for each particle or each spring of a color; for GPUs).
    """

    name: ClassVar[str]
    """Name in `SOLVER_CATALOG`; `solvers/__init__.py` sets it, and `info`."""
    info: ClassVar[SolverInfo]
    predict: ClassVar[Any] = staticmethod(no_op)
    iterate: ClassVar[Any] = staticmethod(no_op)
    finalize: ClassVar[Any] = staticmethod(no_op)
    end_frame: ClassVar[Any] = staticmethod(no_op)
    stores_velocity: ClassVar[bool] = True
    """Velocity is a field, not x − x_prev."""
    needs_coloring: ClassVar[bool] = True
    """An iteration moves particles spring by spring."""
    needs_previous_positions: ClassVar[bool] = True
    """Springs need positions at the start of the substep."""
    iterates_contact: ClassVar[bool] = False
    """Colliders are part of each iteration."""
    final_half_step: ClassVar[bool] = False
    """A frame ends with one more `predict`."""

    def __init__(
        self, cloth: ClothState, topology: Topology, stiffness: NDArray[np.float64], features: Features, layout: str
    ) -> None:
        """`stiffness` of every spring, (E,), in the unit of `info.stiffness_section`. `layout`: one of `LAYOUTS`."""
        self.cloth = cloth
        self.layout_name = layout
        projected = (
            features.collider_count
            or features.has_surfaces
            or features.strain_limit
            or features.tethers
            or features.max_distances
            or features.self_collision
        )
        weave = topology.membrane if isinstance(topology.membrane, WeaveModel) else None
        self.features = replace(
            features,
            stores_velocity=self.stores_velocity,
            needs_previous_positions=self.needs_previous_positions or bool(projected),
            friction_sums=self.iterates_contact and (any(features.colliders[PROJECTION]) or features.has_surfaces),
            bending=len(topology.bending_links.ends) > 0,
            membrane=topology.membrane is not None,
            weave=weave.point_count if weave else 0,
            thread_bending=weave is not None and len(weave.bends.width) > 0,
        )
        colored = self.needs_coloring or features.strain_limit > 0
        self.layout: Layout = cloth
        if layout == "simd":
            self.layout = acquire_simd(topology, stiffness, colored=colored)
        self._attach_features(topology)
        self.frequency = self._force_frequency(topology, stiffness)
        """Highest angular frequency by forces that are explicit in time [rad/s]."""
        with no_scalarization(self.layout.is_simd):
            reset_forces(self.layout)
        self.runner = GraphRunner(self.layout, self.features)
        self._run_frame = RepeatedLaunch(run_frame, scalarize=not self.layout.is_simd)

    def _attach_features(self, topology: Topology) -> None:
        """Set the fields that the features need."""
        if self.features.self_collision:
            check_atomic_sums()
        if self.layout_name == "parallel":
            self.layout = acquire_parallel(self.cloth, topology)
        if self.features.triangles:
            attach_colored_triangles(self.layout, topology)
        if self.features.tethers:
            attach_tethers(self.layout, topology)
        if self.features.max_distances:
            attach_max_distances(self.layout, topology)
        if self.features.bending:
            attach_bending_links(self.layout, topology)
        if topology.membrane is not None:
            attach_membrane(self.layout, topology.membrane, topology.particle_count)
        if isinstance(topology.membrane, WeaveModel) and self.features.thread_bending:
            attach_thread_bends(self.layout, topology.membrane.bends, topology.particle_count)
        if self.features.penetration_free:
            attach_pair_data(self.layout, topology)
        elif self.features.self_collision:
            attach_self_contact(self.layout, topology)
        if self.features.has_surfaces:
            attach_surface_contacts(self.layout, topology)
        if self.features.static_friction:
            attach_friction_anchors(self.layout)
        if self.features.friction_sums:
            attach_friction_sums(self.layout)

    def rebuild_topology(self, topology: Topology, stiffness: NDArray[np.float64]) -> None:
        """Continue with other springs and triangles, not more than at first, between the same particles.

        `stiffness` of every spring, (E,). Not for the SIMD layout, which has the springs of whole rows.
        """
        self.cloth.upload_topology(topology, stiffness)
        self._attach_features(topology)

    def step(self, frame: FrameInput) -> None:
        """Advance the cloth by `frame.substeps` substeps of `frame.h` seconds."""
        if self.layout.is_parallel:
            self._step_in_parallel(frame)
            return
        last = frame.last + self._has_half_step(frame)
        phases = self.predict, self.iterate, self.finalize, self.end_frame
        self._run_frame(*phases, self.cloth, self.layout, self.features, frame.first, last, *frame.arguments)

    def _has_half_step(self, frame: FrameInput) -> bool:
        return self.final_half_step and frame.last == frame.substeps

    def _ends_frame(self, frame: FrameInput) -> bool:
        """Return whether `end_frame` is to be queued."""
        return self.end_frame is not no_op and frame.last == frame.substeps

    def _step_in_parallel(self, frame: FrameInput) -> None:
        """Queue the phases of all substeps as one sequence of launches."""
        iterations = 0 if self.info.is_explicit else frame.iterations
        last = self.finalize, *final_phases(self.features.penetration_free)
        substep = self.predict, *[self.iterate] * iterations, *last
        phases = [(phase, s) for s in range(frame.first, frame.last) for phase in substep]
        if self._has_half_step(frame):
            phases.append((self.predict, frame.substeps))
        if self._ends_frame(frame):
            phases.append((self.end_frame, frame.substeps))
        self.runner.run(phases, frame.shared_arguments)

    def _force_frequency(self, topology: Topology, stiffness: NDArray[np.float64]) -> float:
        """Return a bound of the angular frequency by explicit forces [rad/s]: here those of bending."""
        return max_frequency(topology, 0 * stiffness) if self.features.bending else 0.0

    def min_stable_substeps(self, damping_time: float) -> int:
        """Return the fewest substeps of a frame at which the solver is stable, for springs of that damping time [s]."""
        return min_force_substeps(self.frequency, FRAME_SECONDS)

    def damping_time(self, wanted: float) -> float:
        """Return the damping time of springs [s] that is used for a requested time `wanted`."""
        return wanted

    def velocities(self, h: float) -> NDArray[np.float64]:
        """Return the velocity of every particle [m/s], (N, 3), after substeps of h seconds."""
        return self.cloth.to_numpy(self.cloth.velocity).astype(np.float64)

    def set_velocities(self, velocities: NDArray[np.float64], h: float, of: object = slice(None)) -> None:
        """Set the velocity of all particles, or of some indices, [m/s], for substeps of h seconds.

        `velocities`: a row for each, or one for all. No bit of another particle changes.
        """
        all_velocities = self.cloth.to_numpy(self.cloth.velocity)
        all_velocities[of] = velocities
        fields.upload(self.cloth.velocity, all_velocities)

    def change_substep(self, old: float, new: float) -> None:
        """Keep all velocities when the length of a substep [s] changes."""

    def close(self) -> None:
        """Release fields that are not the cloth's own, and what the graph runner holds."""
        self.runner.close()
        if self.layout.is_simd:
            release_simd(self.layout)
        self.layout = self.cloth


class ExplicitSolver(Solver):
    """A solver whose substep is bounded by the highest frequency of the cloth's springs."""

    needs_coloring = False
    needs_previous_positions = False

    def _force_frequency(self, topology: Topology, stiffness: NDArray[np.float64]) -> float:
        return max_frequency(topology, stiffness, topology.membrane)

    def damping_time(self, wanted: float) -> float:
        """Return the damping time, reduced to what is stable with 1.5 times as many substeps as without damping.

        The damping rate of a vibration grows with the square of its frequency, so the damping of a measured fabric
        would take ten to forty times the substeps (64×64 denim: 11,246 instead of 280), for vibrations too fast to see.
        """
        return min(wanted, max_damping_time(self.frequency))
