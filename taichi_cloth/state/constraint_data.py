"""Fields of tethers, bending, membranes, weaves, max distances, attachments and grabs, and of conjugate gradients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..geometry import grid
from ..geometry.bending import BendingLinks
from ..geometry.membrane_model import ElasticTriangles
from ..geometry.simd_layout import LANES
from ..geometry.tethers import MAX_TETHERS, tethers_of
from ..geometry.topology import Topology, adjacency
from ..geometry.weave_model import ThreadBends
from ..kernels.membrane_constraints import CELL_MULTIPLIERS
from . import field_pool as fields
from .field_pool import build, by_packet, capacity, layout_index, layout_size, vector_field_like

if TYPE_CHECKING:
    from .cloth_state import Layout


@dataclass(eq=False)
class Tethers:
    """Tethers to the nearest pin of every particle, packet by packet, then those to the next pin, and so on."""

    pin: ti.ScalarField
    """Layout index of the pin."""
    flat_distance: ti.ScalarField
    """Distance to the pin on the flat sheet [m]."""
    pin_position: ti.MatrixField | None
    """Position of the pin [m]; only in the SIMD layout, which cannot gather."""
    count: ti.ScalarField
    """Tethers of a particle, 0-D."""


def attach_tethers(layout: Layout, topology: Topology) -> None:
    """Set `layout.tethers`."""
    if layout.tethers is None:
        layout.tethers = build(layout, lambda: _allocate_tethers(MAX_TETHERS * layout.x.shape[0], layout.is_simd))
    pins, flat_distance = tethers_of(topology)
    layout.tethers.count[None] = len(pins)
    pairs = (layout.tethers.pin, layout_index(layout, topology, pins)), (layout.tethers.flat_distance, flat_distance)
    fields.upload_all(*((field, by_packet(layout, topology, values)) for field, values in pairs))


def _allocate_tethers(count: int, simd: bool) -> Tethers:
    return Tethers(
        pin=fields.scalar_field(count, simd=simd, dtype=ti.i32),
        flat_distance=fields.scalar_field(count, simd=simd),
        pin_position=fields.vector_field(count, simd=True) if simd else None,
        count=fields.count_field(),
    )


@dataclass(eq=False)
class BendingLinkList:
    """Quadratic bending links (Bergou 2006).

    Fields that springs have too are named like those of springs: `springs.accumulate_pair_forces` sums over either.
    """

    ends: ti.MatrixField
    """The two particles of every link, ivec2 (P,)."""
    stiffness: ti.ScalarField
    """Constant of every link [N/m], negative where it repels, (P,)."""
    spring_count: ti.ScalarField
    spring_first: ti.ScalarField
    """First entry of every particle in `spring_rows`, (N + 1,)."""
    spring_rows: ti.ScalarField
    """Links of every particle, (2·P,)."""


@dataclass(eq=False)
class BendingLinkPackets:
    """Quadratic bending links of a grid in the SIMD layout."""

    stiffness: ti.ScalarField
    """Constant of every link [N/m], (6·packets,) by direction, then by the upper left particle of the link."""


def attach_bending_links(layout: Layout, topology: Topology) -> None:
    """Set `layout.bending_links`."""
    links, found = topology.bending_links, layout.bending_links
    if layout.is_simd:
        if not isinstance(found, BendingLinkPackets):
            count = layout.rest.shape[0]
            found = build(layout, lambda: BendingLinkPackets(fields.scalar_field(count, simd=True)))
        on_grid = grid.to_grid(topology.shape, links.direction, links.ends, links.stiffness)
        fields.upload(found.stiffness, by_packet(layout, topology, on_grid))
    else:
        particles = layout.x.shape[0]
        count = capacity(max(len(links.ends), len(grid.DIRECTIONS) * particles))  # grids of a size share the fields
        if not isinstance(found, BendingLinkList) or found.stiffness.shape[0] < count:
            found = build(layout, lambda: _allocate_bending_links(count, particles))
        _upload_bending_links(found, links, topology.particle_count)
    layout.bending_links = found


def _upload_bending_links(found: BendingLinkList, links: BendingLinks, particles: int) -> None:
    first, rows = adjacency(links.ends, particles)
    fields.upload_all(
        (found.ends, links.ends),
        (found.stiffness, links.stiffness),
        (found.spring_first, first),
        (found.spring_rows, rows),
    )
    found.spring_count[None] = len(links.ends)


def _allocate_bending_links(count: int, particles: int) -> BendingLinkList:
    return BendingLinkList(
        ends=ti.Vector.field(2, ti.i32, count),
        stiffness=fields.scalar_field(count),
        spring_count=fields.count_field(),
        spring_first=fields.scalar_field(particles + 1, dtype=ti.i32),
        spring_rows=fields.scalar_field(2 * count, dtype=ti.i32),
    )


@dataclass(eq=False)
class MembraneTriangles:
    """The triangles of a membrane (`geometry/membrane_model.py`)."""

    corners: ti.MatrixField
    """The three particles of every triangle, ivec3 (M,)."""
    inverse_shape: ti.MatrixField
    """B of every triangle [1/m], row by row, vec4 (M,)."""
    area: ti.ScalarField
    """Area that every triangle represents [m²], (M,)."""
    multiplier: ti.MatrixField
    """Lagrange multipliers of the strains of every triangle in `xpbd` [kg·m²], vec3 (M,)."""
    count: ti.ScalarField
    triangle_first: ti.ScalarField
    """First entry of every particle in `triangle_rows`, (N + 1,)."""
    triangle_rows: ti.ScalarField
    """Triangles of every particle, (3·M,)."""


@dataclass(eq=False)
class MembraneCells:
    """The multipliers of a membrane in the SIMD layout, which knows the shape of its cells."""

    multiplier: ti.ScalarField
    """Lagrange multipliers of the strains in `xpbd` [kg·m²], twelve for each cell, (12·packets,)."""
    count: ti.ScalarField


def attach_membrane(layout: Layout, membrane: ElasticTriangles, particles: int) -> None:
    """Set `layout.membrane`, of a cloth with so many particles."""
    count = capacity(len(membrane.area))
    if layout.is_simd:
        if layout.membrane is None:
            packets = CELL_MULTIPLIERS * layout.x.shape[0]
            layout.membrane = build(
                layout, lambda: MembraneCells(fields.scalar_field(packets, simd=True), fields.count_field())
            )
        layout.membrane.count[None] = CELL_MULTIPLIERS * layout.packet_count[None]
        return
    if not isinstance(layout.membrane, MembraneTriangles) or layout.membrane.area.shape[0] < count:
        layout.membrane = build(layout, lambda: _allocate_membrane(count, layout.x.shape[0]))
    found = layout.membrane
    first, rows = adjacency(membrane.corners, particles)
    fields.upload_all(
        (found.corners, membrane.corners),
        (found.inverse_shape, membrane.inverse_shape.reshape(-1, 4)),
        (found.area, membrane.area),
        (found.triangle_first, first),
        (found.triangle_rows, rows),
    )
    found.count[None] = len(membrane.area)


def _allocate_membrane(count: int, particles: int) -> MembraneTriangles:
    return MembraneTriangles(
        corners=ti.Vector.field(3, ti.i32, count),
        inverse_shape=ti.Vector.field(4, ti.f32, count),
        area=fields.scalar_field(count),
        multiplier=ti.Vector.field(3, ti.f32, count),
        count=fields.count_field(),
        triangle_first=fields.scalar_field(particles + 1, dtype=ti.i32),
        triangle_rows=fields.scalar_field(3 * count, dtype=ti.i32),
    )


@dataclass(eq=False)
class ThreadBendList:
    """Inner particles of the threads of a weave that resist bending (`geometry/weave_model.py`)."""

    corners: ti.MatrixField
    """The particle before it, the particle and the one after it, ivec3 (K,)."""
    width: ti.ScalarField
    """Width of the cloth that the thread represents [m], (K,)."""
    axis: ti.ScalarField
    """0 along the warp, 1 along the weft, (K,)."""
    count: ti.ScalarField
    bend_first: ti.ScalarField
    """First entry of every particle in `bend_rows`, (N + 1,)."""
    bend_rows: ti.ScalarField
    """Bends of every particle, (3·K,)."""


def attach_thread_bends(layout: Layout, bends: ThreadBends, particles: int) -> None:
    """Set `layout.thread_bends`, of a cloth with so many particles, in the serial or the parallel layout."""
    count = capacity(len(bends.width))
    if layout.thread_bends is None or layout.thread_bends.width.shape[0] < count:
        layout.thread_bends = build(layout, lambda: _allocate_thread_bends(count, layout.x.shape[0]))
    found = layout.thread_bends
    first, rows = adjacency(bends.corners, particles)
    fields.upload_all(
        (found.corners, bends.corners),
        (found.width, bends.width),
        (found.axis, bends.axis),
        (found.bend_first, first),
        (found.bend_rows, rows),
    )
    found.count[None] = len(bends.width)


def _allocate_thread_bends(count: int, particles: int) -> ThreadBendList:
    return ThreadBendList(
        corners=ti.Vector.field(3, ti.i32, count),
        width=fields.scalar_field(count),
        axis=fields.scalar_field(count, dtype=ti.i32),
        count=fields.count_field(),
        bend_first=fields.scalar_field(particles + 1, dtype=ti.i32),
        bend_rows=fields.scalar_field(3 * count, dtype=ti.i32),
    )


@dataclass(eq=False)
class MaxDistances:
    """Max distances: how far every particle may be from its start position."""

    center: ti.MatrixField
    """Start position relative to the cloth's origin [m]."""
    limit: ti.ScalarField
    """Largest distance from it [m]."""


def attach_max_distances(layout: Layout, topology: Topology) -> None:
    """Set `layout.max_distances` of a cloth whose topology has them."""
    assert topology.max_distance is not None
    packets, simd = layout.x.shape[0], layout.is_simd
    if layout.max_distances is None:
        layout.max_distances = build(
            layout,
            lambda: MaxDistances(fields.vector_field(packets, simd=simd), fields.scalar_field(packets, simd=simd)),
        )
    index = layout_index(layout, topology, np.arange(topology.particle_count))
    pairs = (
        (layout.max_distances.center, topology.start - topology.origin),
        (layout.max_distances.limit, topology.max_distance),
    )
    fields.upload_all(*((field, _to_packets(values, index, packets) if simd else values) for field, values in pairs))


def _to_packets(values: NDArray[np.float64], index: NDArray[np.integer], packets: int) -> NDArray[np.float64]:
    """Arrange per-particle values, (N,) or (N, 3), as packets (P, 8) or (P, 3, 8); zero where there is no particle."""
    flat = np.zeros((packets * LANES, *values.shape[1:]))
    flat[index] = values
    rows = flat.reshape(packets, LANES, *values.shape[1:])
    return rows if values.ndim == 1 else rows.transpose(0, 2, 1)


@dataclass(eq=False)
class Attachments:
    """Particles that attachments move, each as a rigid body (`scene.collider_schema.Attachment`)."""

    index: ti.ScalarField
    """Layout index of the particle."""
    local: ti.MatrixField
    """Position relative to the center of the attachment, in its axes [m]; it never changes."""
    attachment: ti.ScalarField
    """Number of the attachment."""
    count: ti.ScalarField


def attach_attachments(
    layout: Layout, topology: Topology, attachment: NDArray[np.int64], local: NDArray[np.float64]
) -> None:
    """Set `layout.attachments`.

    `attachment`: number of the attachment of every particle, −1 for none, (N,). `local`: position of every particle in
    the first pose of its attachment, (N, 3) [m].
    """
    if layout.attachments is None:
        layout.attachments = build(layout, lambda: _allocate_attachments(layout_size(layout)))
    driven = np.flatnonzero(attachment >= 0)
    fields.upload_all(
        (layout.attachments.index, layout_index(layout, topology, driven)),
        (layout.attachments.local, local[driven]),
        (layout.attachments.attachment, attachment[driven]),
    )
    layout.attachments.count[None] = len(driven)


def _allocate_attachments(size: int) -> Attachments:
    return Attachments(
        index=fields.scalar_field(size, dtype=ti.i32),
        local=fields.soa_vector_field(3, size, ti.f32),
        attachment=fields.scalar_field(size, dtype=ti.i32),
        count=fields.count_field(),
    )


@dataclass(eq=False)
class GrabbedParticles:
    """Particles that grabs move. Their number is an argument of each frame (`FrameInput.grabbed_count`)."""

    index: ti.ScalarField
    """Layout index of the particle."""
    rest_position: ti.MatrixField
    """Its position when it was grabbed [m]."""
    grab: ti.ScalarField
    """Number of the grab."""


def allocate_grabbed(size: int) -> GrabbedParticles:
    """Return room for as many particles as a layout has."""
    index, grab = (fields.scalar_field(size, dtype=ti.i32) for _ in range(2))
    return GrabbedParticles(index, fields.soa_vector_field(3, size, ti.f32), grab)


def upload_grabbed(
    layout: Layout,
    topology: Topology,
    particles: NDArray[np.int64],
    rest_positions: NDArray[np.float64],
    grabs: NDArray[np.int64],
) -> None:
    """Set the grabbed particles, (M,), and the number of the grab of each, (M,).

    `rest_positions`: where each was grabbed, relative to the origin [m], (M, 3).
    """
    fields.upload_all(
        (layout.grabbed.index, layout_index(layout, topology, particles)),
        (layout.grabbed.rest_position, rest_positions),
        (layout.grabbed.grab, grabs),
    )


@dataclass(eq=False)
class CGState:
    """Vectors and scalars of the conjugate gradient method (`kernels/conjugate_gradient.py`)."""

    solution: ti.MatrixField
    """δ [m]."""
    residual: ti.MatrixField
    """[kg·m]."""
    scaled: ti.MatrixField
    """Residual over mass, the preconditioned residual [m]."""
    direction: ti.MatrixField
    """Search direction [m]."""
    product: ti.MatrixField
    """Matrix times direction [kg·m]."""
    partial: ti.ScalarField
    """Partial sums of a parallel inner product."""
    squares: ti.ScalarField
    """residual · scaled [kg·m²], 0-D."""
    previous_squares: ti.ScalarField
    """Value of `squares` before the last product, 0-D."""
    curvature: ti.ScalarField
    """direction · product, 0-D."""
    goal: ti.ScalarField
    """Value of `squares` at which the search stops, 0-D."""
    largest_move: ti.ScalarField
    """Largest squared length in `solution` [m²], 0-D, in the parallel layout."""
    linear_range: ti.ScalarField
    """Squared displacement [m²] up to which forces are taken to be linear, 0-D."""


def attach_cg_state(layout: Layout, partial_sums: int) -> None:
    """Allocate `layout.cg`."""

    def make() -> CGState:
        solution, residual, scaled, direction, product = (vector_field_like(layout) for _ in range(5))
        scalars = [ti.field(ti.f32, ()) for _ in range(6)]
        return CGState(solution, residual, scaled, direction, product, fields.scalar_field(partial_sums), *scalars)

    if layout.cg is None:
        layout.cg = build(layout, make)
