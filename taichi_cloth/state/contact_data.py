"""Fields of contact: the broad phase of self-collision, friction anchors, colored triangles, signed distance grids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import taichi as ti

from ..geometry.grid import NO_GRID
from ..geometry.signed_distance import DistanceGrid
from ..geometry.topology import Topology
from . import field_pool as fields
from .field_pool import Pool, build, capacity, layout_index, layout_size, vector_field_like

if TYPE_CHECKING:
    from .cloth_state import ClothState, Layout

BLOCK = 256  # buckets of the spatial hash that one thread sums


@dataclass(eq=False)
class HashBuckets:
    """Items sorted into the buckets of a spatial hash (`collision/self_broadphase.py`)."""

    first: ti.ScalarField
    """First entry of every bucket, (buckets + 1,)."""
    members: ti.ScalarField
    center: ti.MatrixField
    """Center of every member's bounding box when it was sorted [m]."""
    half_size: ti.MatrixField
    """Half the sides of that box [m]."""
    sums: ti.ScalarField
    """Number of items in each block of buckets."""


@dataclass(eq=False)
class CandidateList:
    """Candidate pairs of the broad phase (`collision/self_broadphase.py`)."""

    pairs: ti.MatrixField
    """Two numbers each, ivec2."""
    touching: ti.ScalarField
    """1 for pairs that are in contact."""
    count: ti.ScalarField
    """Pairs found, 0-D. Greater than the capacity of `pairs` when the list has overflowed."""


@dataclass(eq=False)
class SelfContactData:
    """What self-collision needs beside the state. Particles go by their layout index."""

    particle: ti.ScalarField
    """Layout index of every particle, (N,)."""
    flat_position: ti.MatrixField
    """Position on the flat sheet [m], by layout index."""
    edges: ti.MatrixField
    """Edges of the triangles, each once, ivec2 (3·T,)."""
    triangles: ti.MatrixField
    """ivec3 (T,)."""
    depth_sum: ti.ScalarField
    """Sum of the depths of all contacts of a particle, in integer units."""
    max_depth: ti.ScalarField
    """Largest of those depths."""
    correction: ti.MatrixField
    """Sum of the corrections of a particle, in integer units: independent of the order of the sum."""
    is_intersecting: ti.ScalarField
    """1 where the cloth intersects itself (`collision/self_collision.py`), else 0."""
    particle_hash: HashBuckets
    edge_hash: HashBuckets
    """The edges by their midpoints."""
    vertex_vertex: CandidateList
    vertex_triangle: CandidateList
    """Triangle and particle."""
    edge_edge: CandidateList
    list_position: ti.MatrixField
    """Position of every particle when the lists were built [m]."""
    list_thickness: ti.ScalarField
    """Thickness then [m], 0-D; 0 before the first time."""
    expired: ti.ScalarField
    """1 when the lists must be rebuilt, 0-D."""
    list_distance: ti.ScalarField
    """Distance up to which pairs are listed [m], 0-D."""
    cell_size: ti.ScalarField
    """Side of a cell of the hash [m], 0-D."""
    intersection_count: ti.ScalarField
    """Edges that intersect a triangle, when last counted, 0-D."""
    longest_edge: ti.ScalarField
    """Length of the longest edge at rest [m], 0-D."""
    particle_count: ti.ScalarField
    edge_count: ti.ScalarField
    triangle_count: ti.ScalarField


def attach_self_contact(layout: Layout, topology: Topology) -> None:
    """Set `layout.self_contact`."""
    if layout.self_contact is None:
        size = layout_size(layout)
        triangles = layout.triangles.shape[0] if hasattr(layout, "triangles") else 2 * size
        layout.self_contact = build(layout, lambda: _allocate_self_contact(size, triangles))
    data = layout.self_contact
    index = layout_index(layout, topology, np.arange(topology.particle_count))
    flat = np.zeros((data.flat_position.shape[0], 3))
    flat[index] = topology.flat
    edges = topology.edges
    fields.upload_all(
        (data.particle, index),
        (data.flat_position, flat),
        (data.edges, index[edges]),
        (data.triangles, index[topology.triangles]),
        (data.is_intersecting, np.zeros(0)),
    )
    data.longest_edge[None] = float(np.linalg.norm(np.diff(topology.flat[edges], axis=1), axis=2).max(initial=0.0))
    data.list_thickness[None] = 0.0
    data.particle_count[None], data.edge_count[None] = len(index), len(edges)
    data.triangle_count[None] = topology.triangle_count


def _allocate_self_contact(size: int, triangles: int) -> SelfContactData:
    return SelfContactData(
        particle=fields.scalar_field(size, dtype=ti.i32),
        flat_position=fields.soa_vector_field(3, size, ti.f32),
        edges=fields.soa_vector_field(2, 3 * triangles),
        triangles=fields.soa_vector_field(3, triangles),
        depth_sum=fields.scalar_field(size, dtype=ti.i32),
        max_depth=fields.scalar_field(size, dtype=ti.i32),
        correction=fields.soa_vector_field(3, size),
        is_intersecting=fields.scalar_field(size, dtype=ti.i32),
        particle_hash=_allocate_buckets(size),
        edge_hash=_allocate_buckets(3 * triangles),
        vertex_vertex=_allocate_candidates(16 * size),
        vertex_triangle=_allocate_candidates(8 * triangles),
        edge_edge=_allocate_candidates(16 * triangles),
        list_position=fields.soa_vector_field(3, size, ti.f32),
        list_thickness=ti.field(ti.f32, ()),
        expired=fields.count_field(),
        list_distance=ti.field(ti.f32, ()),
        cell_size=ti.field(ti.f32, ()),
        intersection_count=fields.count_field(),
        longest_edge=ti.field(ti.f32, ()),
        particle_count=fields.count_field(),
        edge_count=fields.count_field(),
        triangle_count=fields.count_field(),
    )


def _allocate_candidates(count: int) -> CandidateList:
    return CandidateList(
        pairs=fields.soa_vector_field(2, count),
        touching=fields.scalar_field(count, dtype=ti.i32),
        count=fields.count_field(),
    )


def _allocate_buckets(count: int) -> HashBuckets:
    buckets = 2 * capacity(count)
    return HashBuckets(
        first=fields.scalar_field(buckets + 1, dtype=ti.i32),
        members=fields.scalar_field(buckets, dtype=ti.i32),
        center=fields.soa_vector_field(3, buckets, ti.f32),
        half_size=fields.soa_vector_field(3, buckets, ti.f32),
        sums=fields.scalar_field(buckets // BLOCK + 1, dtype=ti.i32),
    )


@dataclass(eq=False)
class FrictionAnchors:
    """Static friction of the pairs of `SelfContactData.vertex_vertex`, entry by entry."""

    gap: ti.MatrixField
    """Vector from the second particle to the first when contact began [m]."""
    normal_correction: ti.ScalarField
    """How far the iterations of a substep have pushed the pair apart [m]."""
    last_contact: ti.ScalarField
    """The last substep in which the pair was in contact."""


def attach_friction_anchors(layout: Layout) -> None:
    """Allocate `layout.friction_anchors` of a layout that has `self_contact`."""
    assert layout.self_contact is not None
    if layout.friction_anchors is None:
        count = layout.self_contact.vertex_vertex.pairs.shape[0]
        layout.friction_anchors = build(layout, lambda: _allocate_anchors(count))


def _allocate_anchors(count: int) -> FrictionAnchors:
    return FrictionAnchors(
        gap=fields.soa_vector_field(3, count, ti.f32),
        normal_correction=fields.scalar_field(count),
        last_contact=fields.scalar_field(count, dtype=ti.i32),
    )


@dataclass(eq=False)
class FrictionSums:
    """Corrections by contact with colliders, summed over the iterations of a substep."""

    push: ti.MatrixField
    """Normal corrections of every particle [m]."""
    friction: ti.MatrixField
    """Friction corrections of every particle [m]."""
    triangle_push: ti.MatrixField
    """Normal corrections at the contact point of every colored triangle [m]."""
    triangle_friction: ti.MatrixField
    """Friction corrections there [m]."""


def attach_friction_sums(layout: Layout) -> None:
    """Allocate `layout.friction_sums`."""
    if layout.friction_sums is None:
        triangles = layout.triangles.shape[0] if hasattr(layout, "triangles") else 1  # grids in SIMD have none
        layout.friction_sums = build(
            layout,
            lambda: FrictionSums(
                vector_field_like(layout),
                vector_field_like(layout),
                fields.vector_field(triangles),
                fields.vector_field(triangles),
            ),
        )


TRIANGLE_COLORS = 8  # of a grid: cells of even and odd row and column, two triangles in each


@dataclass(eq=False)
class ColoredTriangles:
    """Triangles by color. Those of one color share no particle."""

    corners: ti.MatrixField
    """ivec3 (T,)."""
    first: ti.ScalarField
    """First triangle of every color, and the number of all, (TRIANGLE_COLORS + 1,)."""


def attach_colored_triangles(layout: ClothState, topology: Topology) -> None:
    """Set `layout.colored_triangles`. A mesh has a single color: it cannot be worked on in parallel."""
    if layout.colored_triangles is None:
        count = layout.triangles.shape[0]
        layout.colored_triangles = ColoredTriangles(
            ti.Vector.field(3, ti.i32, count), fields.scalar_field(TRIANGLE_COLORS + 1, dtype=ti.i32)
        )
    cells = topology.cells
    if topology.shape == NO_GRID:
        color = np.zeros(len(cells), np.int64)
    else:
        row, column = cells.T % 2
        second = np.zeros(len(cells), int)  # the second triangle of its cell
        second[1:] = (cells[1:] == cells[:-1]).all(axis=1)
        color = 4 * row + 2 * column + second
    order = np.argsort(color, kind="stable")
    first = np.searchsorted(color[order], np.arange(TRIANGLE_COLORS + 1))
    fields.upload_all(
        (layout.colored_triangles.corners, topology.triangles[order]), (layout.colored_triangles.first, first)
    )


@dataclass(eq=False)
class SdfGrids:
    """The signed distance grids of a scene's mesh colliders, one after another."""

    values: ti.ScalarField
    """Signed distance at every node [m]."""
    first: ti.ScalarField
    """First node of every mesh, (M,)."""
    nodes: ti.MatrixField
    """Nodes along each side, ivec3 (M,)."""
    spacing: ti.ScalarField
    """Distance between nodes [m], (M,)."""


def _allocate_sdf(nodes: int, meshes: int) -> SdfGrids:
    return SdfGrids(
        values=fields.scalar_field(nodes),
        first=fields.scalar_field(meshes, dtype=ti.i32),
        nodes=fields.soa_vector_field(3, meshes),
        spacing=fields.scalar_field(meshes),
    )


_pool = Pool(_allocate_sdf)


def acquire_sdf(grids: Sequence[DistanceGrid]) -> SdfGrids | None:
    """Return the distance grids of a scene as fields, or None for a scene without mesh colliders."""
    if not grids:
        return None
    sizes = np.array([grid.values.size for grid in grids])
    found = _pool.acquire(int(sizes.sum()), len(grids))
    fields.upload_all(
        (found.values, np.concatenate([grid.values.ravel() for grid in grids])),
        (found.first, np.cumsum(sizes) - sizes),
        (found.nodes, np.array([grid.values.shape for grid in grids])),
        (found.spacing, np.array([grid.spacing for grid in grids])),
    )
    return found


def release_sdf(sdf: SdfGrids | None) -> None:
    """Make the fields available for the next scene with mesh colliders."""
    if sdf is not None:
        _pool.release(sdf)
