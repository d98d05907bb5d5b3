"""The state of one cloth as Taichi fields, and the groups of fields that features add to it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar
from weakref import WeakKeyDictionary

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..geometry.grid import MAX_COLORS
from ..geometry.topology import Topology
from ..kernels.layout import copy_vectors
from ..system.taichi_compat import RepeatedLaunch
from . import field_pool as fields
from .constraint_data import (
    Attachments,
    BendingLinkList,
    BendingLinkPackets,
    CGState,
    GrabbedParticles,
    MaxDistances,
    MembraneCells,
    MembraneTriangles,
    Tethers,
    ThreadBendList,
    allocate_grabbed,
)
from .contact_data import ColoredTriangles, FrictionAnchors, FrictionSums, SelfContactData
from .field_pool import Pool, capacity
from .pair_data import PairData
from .solver_data import LineList, LinePackets, StageStart, StageSums, StateSnapshot
from .surface_data import SurfaceContacts


@dataclass(eq=False, kw_only=True)
class Layout:
    """Fields that every layout has. The element of a field is a packet: one particle, or eight in the SIMD layout.

    Capacities are powers of two and the counts in use are 0-D fields, so two cloths of one capacity share every
    compiled kernel. The optional groups are allocated when a feature first needs them and then stay with the layout.
    """

    is_simd: ClassVar[bool] = False
    is_parallel: ClassVar[bool] = False

    x: ti.MatrixField
    """Position relative to the cloth's origin [m]."""
    x_prev: ti.MatrixField
    """Position at the start of the substep [m]."""
    velocity: ti.MatrixField
    """Velocity [m/s], for solvers that store it: (x − x_prev)/h would lose small steps in float32."""
    force: ti.MatrixField
    """Force accumulated in a substep [N], without gravity."""
    inverse_mass: ti.ScalarField
    """Inverse mass [1/kg]; 0 for pinned and grabbed particles."""
    rest: ti.ScalarField
    """Rest length of every spring [m]."""
    stiffness: ti.ScalarField
    """Stiffness of every spring, in the unit of the solver."""
    multiplier: ti.ScalarField
    """Lagrange multiplier λ of every spring, accumulated over the iterations of a substep [kg·m]."""
    grabbed: GrabbedParticles
    packet_count: ti.ScalarField
    spring_count: ti.ScalarField

    tethers: Tethers | None = None
    max_distances: MaxDistances | None = None
    attachments: Attachments | None = None
    bending_links: BendingLinkList | BendingLinkPackets | None = None
    membrane: MembraneTriangles | MembraneCells | None = None
    thread_bends: ThreadBendList | None = None
    lines: LineList | LinePackets | None = None
    cg: CGState | None = None
    self_contact: SelfContactData | None = None
    friction_anchors: FrictionAnchors | None = None
    friction_sums: FrictionSums | None = None
    pair_data: PairData | None = None
    surface_contacts: SurfaceContacts | None = None
    colored_triangles: ColoredTriangles | None = None
    stage_sums: StageSums | None = None
    stage_start: StageStart | None = None
    correction: ti.MatrixField | None = None
    """Displacement accumulated in a substep of `implicit` [m]."""


@dataclass(eq=False, kw_only=True)
class ClothState(Layout):
    """The serial layout, one particle after another. Other layouts work on it, or on a copy of it."""

    origin: ti.MatrixField
    """World position that positions are relative to [m], 0-D: float32 rounds coarsely far from zero."""
    ends: ti.MatrixField
    """The two particles of every spring, ivec2 (E,)."""
    color_first: ti.ScalarField
    """First spring of every color, and the number of all springs, (colors + 1,)."""
    triangles: ti.MatrixField
    """The three particles of every triangle, ivec3 (T,)."""
    color_count: ti.ScalarField
    triangle_count: ti.ScalarField
    parallel: Layout | None = None
    """The parallel layout of this cloth, once it was used."""
    snapshots: tuple[StateSnapshot, StateSnapshot] | None = None
    particle_count: int = 0
    copies: WeakKeyDictionary[ti.MatrixField, RepeatedLaunch] = field(default_factory=WeakKeyDictionary)
    """Launches that copy fields of vectors, by field."""

    def upload(self, topology: Topology, stiffness: NDArray[np.float64]) -> None:
        """Set every field for this cloth at its start, at rest. `stiffness` of every spring, (E,)."""
        self.upload_topology(topology, stiffness)
        self.packet_count[None] = self.particle_count = topology.particle_count
        self.velocity.fill(0.0)
        start = topology.start - topology.origin
        self.origin[None] = topology.origin
        self.upload_positions(start, start, inverse_mass(topology))

    def upload_topology(self, topology: Topology, stiffness: NDArray[np.float64]) -> None:
        """Set springs, with their `stiffness` (E,), and triangles."""
        first = np.full(self.color_first.shape[0], topology.spring_count)  # unused colors are empty
        first[: len(topology.batches)] = [batch.first for batch in topology.batches]
        fields.upload_all(
            (self.ends, topology.ends),
            (self.rest, topology.rest),
            (self.stiffness, stiffness),
            (self.triangles, topology.triangles),
            (self.color_first, first),
        )
        self.spring_count[None] = topology.spring_count
        self.color_count[None] = len(topology.batches)
        self.triangle_count[None] = topology.triangle_count

    def upload_positions(
        self, x: NDArray[np.generic], x_prev: NDArray[np.generic], inverse_mass: NDArray[np.generic]
    ) -> None:
        """Set positions relative to the origin, two (N, 3) arrays [m], and inverse masses, (N,) [1/kg]."""
        fields.upload_all((self.x, x), (self.x_prev, x_prev), (self.inverse_mass, inverse_mass))

    def to_numpy(self, field: ti.MatrixField) -> NDArray[np.float32]:
        """Return a field of vectors as an array with a row for each particle in use, (N, 3)."""
        rows = np.empty((self.particle_count, 3), np.float32)
        if field not in self.copies:
            self.copies[field] = RepeatedLaunch(copy_vectors)
        self.copies[field](field, rows)
        return rows


def inverse_mass(topology: Topology) -> NDArray[np.float32]:
    """Return 1/mass of every particle [1/kg], 0 where it is pinned, (N,)."""
    return np.where(topology.pinned, 0, 1 / topology.mass).astype(np.float32)


def _allocate(particles: int, springs: int, triangles: int, colors: int) -> ClothState:
    return ClothState(
        origin=ti.Vector.field(3, ti.f32, ()),
        x=fields.vector_field(particles),
        x_prev=fields.vector_field(particles),
        velocity=fields.vector_field(particles),
        force=fields.vector_field(particles),
        inverse_mass=fields.scalar_field(particles),
        ends=ti.Vector.field(2, ti.i32, springs),
        rest=fields.scalar_field(springs),
        stiffness=fields.scalar_field(springs),
        multiplier=fields.scalar_field(springs),
        color_first=fields.scalar_field(colors - SPARE_COLORS + 1, dtype=ti.i32),
        triangles=ti.Vector.field(3, ti.i32, triangles),
        grabbed=allocate_grabbed(particles),
        packet_count=fields.count_field(),
        spring_count=fields.count_field(),
        color_count=fields.count_field(),
        triangle_count=fields.count_field(),
    )


_pool = Pool(_allocate)
# Added before rounding up to a capacity and subtracted after it, so that a grid has room for `MAX_COLORS` colors and no
# more: each color is a launch, also if it has no springs.
SPARE_COLORS = capacity(MAX_COLORS) - MAX_COLORS


def acquire_state(topology: Topology) -> ClothState:
    """Return a state with room for this cloth; `ClothState.upload` sets its fields."""
    colors = len(topology.batches) + SPARE_COLORS
    return _pool.acquire(topology.particle_count, topology.spring_count, topology.triangle_count, colors)


def release_state(state: ClothState) -> None:
    """Make a state's fields available for the next cloth of its size."""
    _pool.release(state)
