"""Fields of penetration-free self-contact: safe positions, balls, the bounding tree and the list of near pairs."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import taichi as ti

from ..geometry.bounding_tree import build_tree
from ..geometry.topology import Topology
from . import field_pool as fields
from .field_pool import build, layout_index, layout_size

if TYPE_CHECKING:
    from .cloth_state import Layout

MAX_REACH = 1e6  # [m] of a ball
PAIRS_PER_TRIANGLE = 32  # capacity of the list: ten layers pressed together have 15


class TreeFields(NamedTuple):
    """`geometry/bounding_tree.py` as fields. Particles go by their layout index."""

    skip: ti.ScalarField
    leaf: ti.ScalarField
    node: ti.ScalarField
    """Node of each leaf."""
    node_boxes: ti.MatrixField
    """Packed moving box of each node (`collision/pair_geometry.py`)."""
    triangle_boxes: ti.MatrixField
    edge_boxes: ti.MatrixField
    particle_boxes: ti.MatrixField
    triangles: ti.MatrixField
    edges: ti.MatrixField
    particles: ti.ScalarField
    first_triangle: ti.ScalarField
    first_edge: ti.ScalarField
    first_particle: ti.ScalarField
    leaves_of_particle: ti.ScalarField
    first_leaf_of_particle: ti.ScalarField
    """By particle number, not layout index."""
    marked: ti.ScalarField
    """1 for leaves whose pairs are to be listed anew."""
    queue: ti.ScalarField
    """Those leaves."""
    queue_count: ti.ScalarField
    leaf_count: ti.ScalarField
    levels: ti.ScalarField


class PairLimits(NamedTuple):
    """How far the corners of each pair may move before it has to be looked at again."""

    paths: ti.ScalarField
    """Sum of `PairData.path` of the corners up to which it need not be [µm]."""
    longest_path: ti.ScalarField
    """Value of `PairData.longest_path` up to which it need not be [µm]."""


class PairList(NamedTuple):
    """Pairs of a particle and a triangle, or of two edges. Part A is the particle or the first edge, B the other."""

    corners: ti.MatrixField
    """Layout indices, ivec4: particle and triangle, or the ends of both edges."""
    kind: ti.ScalarField
    """`VERTEX_TRIANGLE` or `EDGE_EDGE`."""
    leaves: ti.MatrixField
    """Leaves of the two parts, ivec2."""
    normal: ti.MatrixField
    """The last separating direction that was found, from B to A."""
    weights: ti.MatrixField
    """Weights of the corners in the gap between the nearest points, vec4; of active pairs."""
    near: PairLimits
    """Up to when the parts are farther apart than the thickness."""
    close: PairLimits
    """Up to when they are farther apart than the floor of `collision/truncation.py`."""
    gap: ti.ScalarField
    """Gap along `normal` at the safe positions [m]; of active pairs."""
    thickness: ti.ScalarField
    """Gap at which the parts touch [m]; of active pairs."""
    inverse_mass: ti.ScalarField
    """Inverse mass of the gap [1/kg]; of active pairs."""
    active: ti.ScalarField
    """Numbers of the active pairs, which may touch in this substep."""
    candidates: ti.MatrixField
    """Pairs whose boxes meet: kind, elements and leaves, ivec4: see `collision/pair_list.py`."""
    candidate_count: ti.ScalarField
    length: ti.ScalarField
    active_length: ti.ScalarField
    overflowed: ti.ScalarField
    """1 if the list is full: nothing moves then."""


class PairData(NamedTuple):
    """What penetration-free contact needs beside the state. Vectors and scalars of particles go by layout index."""

    particle: ti.ScalarField
    """Layout index of every particle, (N,)."""
    flat_position: ti.MatrixField
    """Position on the flat sheet [m]."""
    x_safe: ti.MatrixField
    """Positions at the end of the last substep, in which nothing intersects [m]."""
    x_target: ti.MatrixField
    """Positions that the substep asks for [m]."""
    path: ti.ScalarField
    """Length of the path of each target [µm]. It may overflow: only differences are used."""
    longest_path: ti.ScalarField
    """Sum of the longest pieces of all paths [µm], 0-D: no path has grown more."""
    center: ti.MatrixField
    """Center of each particle's ball at the start of the period [m]: pairs are listed for all positions in balls."""
    mean_move: ti.MatrixField
    """Motion of each particle in a substep, smoothed over the last ones [m]."""
    travel: ti.MatrixField
    """Motion of the ball in a substep [m]."""
    radius: ti.ScalarField
    """Radius of the ball [m]; negative before the first."""
    reach: ti.ScalarField
    """How far balls may reach [m], 0-D: it is reduced when the list is full, and grows again."""
    farthest: ti.ScalarField
    """The farthest that a ball reaches [m], 0-D."""
    shortest_edge: ti.ScalarField
    """Length of the shortest edge at rest [m], 0-D."""
    age: ti.ScalarField
    """Substeps since the start of the period, 0-D."""
    fraction: ti.ScalarField
    """Fraction 0…1 of its motion that a particle may carry out."""
    next_fraction: ti.ScalarField
    released: ti.ScalarField
    """1 for particles of parts that intersect, which nothing holds apart."""
    depth_sum: ti.ScalarField
    max_depth: ti.ScalarField
    correction: ti.MatrixField
    """Sum of the corrections of a particle, in integer units: independent of the order of the sum."""
    tree: TreeFields
    pairs: PairList
    rounding: ti.ScalarField
    """Rounding error of a position [m], 0-D."""
    offenders: ti.ScalarField
    """Pairs that were cut in the present pass, 0-D."""
    particle_count: ti.ScalarField


def attach_pair_data(layout: Layout, topology: Topology) -> None:
    """Set `layout.pair_data`, with the start of the topology as safe positions."""
    if layout.pair_data is None:
        size = layout_size(layout)
        triangles = layout.triangles.shape[0] if hasattr(layout, "triangles") else 2 * size
        layout.pair_data = build(layout, lambda: _allocate(size, max(triangles, 16)))
    data = layout.pair_data
    found = build_tree(topology)
    index = layout_index(layout, topology, np.arange(topology.particle_count))
    rows = np.zeros((data.x_safe.shape[0], 3))
    flat, start = rows.copy(), rows.copy()
    flat[index], start[index] = topology.flat, topology.start - topology.origin
    tree = data.tree
    fields.upload_all(
        (data.particle, index),
        (data.flat_position, flat),
        (data.x_safe, start),
        (data.x_target, start),
        (data.radius, np.full(data.radius.shape[0], -1.0)),
        (tree.skip, found.skip),
        (tree.leaf, found.leaf),
        (tree.node, found.node),
        (tree.triangles, index[found.triangles]),
        (tree.edges, index[found.edges]),
        (tree.particles, index[found.particles]),
        (tree.first_triangle, found.first_triangle),
        (tree.first_edge, found.first_edge),
        (tree.first_particle, found.first_particle),
        (tree.leaves_of_particle, found.leaves_of_particle),
        (tree.first_leaf_of_particle, found.first_leaf_of_particle),
        (tree.marked, np.zeros(0)),
        (data.released, np.zeros(0)),
        (data.mean_move, np.zeros((0, 3))),
    )
    tree.queue_count[None] = 0
    tree.leaf_count[None], tree.levels[None] = len(found.node), found.levels
    data.pairs.length[None] = data.pairs.active_length[None] = data.pairs.overflowed[None] = 0
    data.age[None] = 0
    data.reach[None] = MAX_REACH
    lengths = np.linalg.norm(np.diff(topology.flat[topology.edges], axis=1), axis=2)
    data.shortest_edge[None] = float(lengths.min(initial=np.inf))
    data.particle_count[None] = topology.particle_count


def _allocate(size: int, triangles: int) -> PairData:
    return PairData(
        particle=fields.scalar_field(size, dtype=ti.i32),
        flat_position=fields.soa_vector_field(3, size, ti.f32),
        x_safe=fields.soa_vector_field(3, size, ti.f32),
        x_target=fields.soa_vector_field(3, size, ti.f32),
        center=fields.soa_vector_field(3, size, ti.f32),
        path=fields.scalar_field(size, dtype=ti.i32),
        longest_path=fields.count_field(),
        mean_move=fields.soa_vector_field(3, size, ti.f32),
        travel=fields.soa_vector_field(3, size, ti.f32),
        reach=ti.field(ti.f32, ()),
        farthest=ti.field(ti.f32, ()),
        shortest_edge=ti.field(ti.f32, ()),
        age=fields.count_field(),
        radius=fields.scalar_field(size),
        fraction=fields.scalar_field(size),
        next_fraction=fields.scalar_field(size),
        released=fields.scalar_field(size, dtype=ti.i32),
        depth_sum=fields.scalar_field(size, dtype=ti.i32),
        max_depth=fields.scalar_field(size, dtype=ti.i32),
        correction=fields.soa_vector_field(3, size),
        tree=_allocate_tree(size, triangles + size),
        pairs=_allocate_pairs(PAIRS_PER_TRIANGLE * triangles),
        rounding=ti.field(ti.f32, ()),
        offenders=fields.count_field(),
        particle_count=fields.count_field(),
    )


def _allocate_tree(size: int, triangles: int) -> TreeFields:
    """`triangles` includes those of lone particles."""
    return TreeFields(
        skip=fields.scalar_field(2 * triangles, dtype=ti.i32),
        leaf=fields.scalar_field(2 * triangles, dtype=ti.i32),
        node=fields.scalar_field(triangles, dtype=ti.i32),
        node_boxes=fields.soa_vector_field(4, 2 * triangles, ti.i64),
        triangle_boxes=fields.soa_vector_field(4, triangles, ti.i64),
        particle_boxes=fields.soa_vector_field(4, size, ti.i64),
        edge_boxes=fields.soa_vector_field(4, 3 * triangles, ti.i64),
        triangles=fields.soa_vector_field(3, triangles),
        edges=fields.soa_vector_field(2, 3 * triangles),
        particles=fields.scalar_field(size, dtype=ti.i32),
        first_triangle=fields.scalar_field(triangles + 1, dtype=ti.i32),
        first_edge=fields.scalar_field(triangles + 1, dtype=ti.i32),
        first_particle=fields.scalar_field(triangles + 1, dtype=ti.i32),
        leaves_of_particle=fields.scalar_field(3 * triangles, dtype=ti.i32),
        first_leaf_of_particle=fields.scalar_field(size + 1, dtype=ti.i32),
        marked=fields.scalar_field(triangles, dtype=ti.i32),
        queue=fields.scalar_field(triangles, dtype=ti.i32),
        queue_count=fields.count_field(),
        leaf_count=fields.count_field(),
        levels=fields.count_field(),
    )


def _allocate_pairs(count: int) -> PairList:
    return PairList(
        corners=fields.soa_vector_field(4, count),
        kind=fields.scalar_field(count, dtype=ti.i32),
        leaves=fields.soa_vector_field(2, count),
        normal=fields.soa_vector_field(3, count, ti.f32),
        weights=fields.soa_vector_field(4, count, ti.f32),
        near=PairLimits(fields.scalar_field(count, dtype=ti.i32), fields.scalar_field(count, dtype=ti.i32)),
        close=PairLimits(fields.scalar_field(count, dtype=ti.i32), fields.scalar_field(count, dtype=ti.i32)),
        gap=fields.scalar_field(count),
        thickness=fields.scalar_field(count),
        inverse_mass=fields.scalar_field(count),
        active=fields.scalar_field(count, dtype=ti.i32),
        candidates=fields.soa_vector_field(4, 2 * count),
        candidate_count=fields.count_field(),
        length=fields.count_field(),
        active_length=fields.count_field(),
        overflowed=fields.count_field(),
    )
