"""Fields of deforming mesh colliders: their triangles in one frame, and the contact of each particle with them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..geometry.bounding_tree import build_triangle_tree
from ..geometry.closed_surface import Surface
from ..geometry.topology import Topology, adjacency
from . import field_pool as fields
from .field_pool import Pool, build, layout_index, layout_size

if TYPE_CHECKING:
    from .cloth_state import Layout

CANDIDATES = 24  # triangles that a particle may touch in a frame; of more, the nearest


class DeformingSurfaces(NamedTuple):
    """All deforming meshes of a scene as one: V vertices, T triangles sorted by leaf, with a bounding tree."""

    start: ti.MatrixField
    """Position of every vertex at the start of the frame, relative to the origin of the cloth [m]."""
    end: ti.MatrixField
    """At its end [m]."""
    triangles: ti.MatrixField
    """The three vertices of every triangle, counter-clockwise seen from outside."""
    neighbors: ti.MatrixField
    """The triangle across each of its edges, from corner k to the next."""
    mesh: ti.ScalarField
    """Number of the mesh of every triangle."""
    face_normal: ti.MatrixField
    """Unit normal of every triangle in the middle of the frame."""
    vertex_normal: ti.MatrixField
    """Sum of the normals of its triangles times their angles, of every vertex."""
    first_face: ti.ScalarField
    """First entry of `faces` of every vertex."""
    faces: ti.ScalarField
    """Triangles around the vertices."""
    margin_start: ti.ScalarField
    """Margin of every mesh at the start of the frame [m]."""
    margin_end: ti.ScalarField
    friction: ti.ScalarField
    """Friction coefficient of every mesh."""
    skip: ti.ScalarField
    """This and the following: the tree, as in `TreeFields`."""
    leaf: ti.ScalarField
    node: ti.ScalarField
    first_triangle: ti.ScalarField
    node_boxes: ti.MatrixField
    leaf_count: ti.ScalarField
    levels: ti.ScalarField
    vertex_count: ti.ScalarField
    triangle_count: ti.ScalarField
    reach: ti.ScalarField
    """Greatest distance from a surface at which particles are in contact with it [m], 0-D."""


class SurfaceContacts(NamedTuple):
    """The contact of each particle with deforming meshes, by layout index."""

    particle: ti.ScalarField
    """Layout index of every particle."""
    center: ti.MatrixField
    """Center of the ball in which the particle is expected to move, at the start of the frame [m]."""
    travel: ti.MatrixField
    """Motion of that center in a frame [m]."""
    radius: ti.ScalarField
    """Radius of the ball [m]."""
    until: ti.ScalarField
    """Fraction of the frame up to which the list is valid."""
    candidates: ti.ScalarField
    """`CANDIDATES` triangles for each particle."""
    distance: ti.ScalarField
    """Their distances when they were listed [m]."""
    count: ti.ScalarField
    normal: ti.MatrixField
    """Direction in which the nearest surface pushes; zero without contact."""
    level: ti.MatrixField
    """Place along `normal` of the margin at the start of the frame [m], its change in the frame [m], friction."""
    motion: ti.MatrixField
    """Motion of the nearest point of the surface in the frame [m]."""
    particle_count: ti.ScalarField


def _allocate(vertices: int, triangles: int, meshes: int) -> DeformingSurfaces:
    vector = fields.soa_vector_field
    return DeformingSurfaces(
        start=vector(3, vertices, ti.f32),
        end=vector(3, vertices, ti.f32),
        triangles=vector(3, triangles),
        neighbors=vector(3, triangles),
        mesh=fields.scalar_field(triangles, dtype=ti.i32),
        face_normal=vector(3, triangles, ti.f32),
        vertex_normal=vector(3, vertices, ti.f32),
        first_face=fields.scalar_field(vertices + 1, dtype=ti.i32),
        faces=fields.scalar_field(3 * triangles, dtype=ti.i32),
        margin_start=fields.scalar_field(meshes),
        margin_end=fields.scalar_field(meshes),
        friction=fields.scalar_field(meshes),
        skip=fields.scalar_field(2 * triangles, dtype=ti.i32),
        leaf=fields.scalar_field(2 * triangles, dtype=ti.i32),
        node=fields.scalar_field(triangles, dtype=ti.i32),
        first_triangle=fields.scalar_field(triangles + 1, dtype=ti.i32),
        node_boxes=vector(4, 2 * triangles, ti.i64),
        leaf_count=fields.count_field(),
        levels=fields.count_field(),
        vertex_count=fields.count_field(),
        triangle_count=fields.count_field(),
        reach=ti.field(ti.f32, ()),
    )


_pool = Pool(_allocate)


def acquire_surfaces(surfaces: Sequence[Surface]) -> DeformingSurfaces | None:
    """Return the deforming meshes of a scene as fields, or None if there are none."""
    if not surfaces:
        return None
    sizes = [len(surface.vertices) for surface in surfaces]
    first = np.cumsum([0, *sizes[:-1]])
    faces = np.concatenate([surface.faces + offset for surface, offset in zip(surfaces, first, strict=True)])
    mesh = np.repeat(np.arange(len(surfaces)), [len(surface.faces) for surface in surfaces])
    vertices = np.concatenate([surface.vertices for surface in surfaces])
    # Trees of several meshes share their upper nodes: apart from each other, each keeps leaves of its own.
    spread = np.cumsum([0.0, *(4.0 * surface.half.max() for surface in surfaces[:-1])])
    tree = build_triangle_tree(vertices[faces].mean(axis=1) + spread[mesh][:, None] * [1.0, 0.0, 0.0])
    faces, mesh = faces[tree.order], mesh[tree.order]
    around_first, around = adjacency(faces, len(vertices))
    found = _pool.acquire(len(vertices), len(faces), len(surfaces))
    fields.upload_all(
        (found.triangles, faces),
        (found.neighbors, _neighbors(faces)),
        (found.mesh, mesh),
        (found.first_face, around_first),
        (found.faces, around),
        (found.skip, tree.skip),
        (found.leaf, tree.leaf),
        (found.node, tree.node),
        (found.first_triangle, tree.first_triangle),
    )
    found.leaf_count[None], found.levels[None] = len(tree.node), tree.levels
    found.vertex_count[None], found.triangle_count[None] = len(vertices), len(faces)
    return found


def _neighbors(faces: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return the face across each edge of each face of a closed surface, (T, 3)."""
    start, end = faces.astype(np.int64).ravel(), np.roll(faces, -1, axis=1).astype(np.int64).ravel()
    count = int(faces.max()) + 1
    forward, backward = start * count + end, end * count + start
    order = np.argsort(forward)
    across: NDArray[np.int64] = (order[np.searchsorted(forward[order], backward)] // 3).reshape(-1, 3)
    return across


def release_surfaces(surfaces: DeformingSurfaces | None) -> None:
    """Make the fields available for the next scene."""
    if surfaces is not None:
        _pool.release(surfaces)


def attach_surface_contacts(layout: Layout, topology: Topology) -> None:
    """Set `layout.surface_contacts`."""
    if layout.surface_contacts is None:
        size = layout_size(layout)
        layout.surface_contacts = build(layout, lambda: _allocate_contacts(size))
    contacts = layout.surface_contacts
    fields.upload(contacts.particle, layout_index(layout, topology, np.arange(topology.particle_count)))
    contacts.particle_count[None] = topology.particle_count


def _allocate_contacts(size: int) -> SurfaceContacts:
    vector = fields.soa_vector_field
    return SurfaceContacts(
        particle=fields.scalar_field(size, dtype=ti.i32),
        center=vector(3, size, ti.f32),
        travel=vector(3, size, ti.f32),
        radius=fields.scalar_field(size),
        until=fields.scalar_field(size),
        candidates=fields.scalar_field(CANDIDATES * size, dtype=ti.i32),
        distance=fields.scalar_field(CANDIDATES * size),
        count=fields.scalar_field(size, dtype=ti.i32),
        normal=vector(3, size, ti.f32),
        level=vector(3, size, ti.f32),
        motion=vector(3, size, ti.f32),
        particle_count=fields.count_field(),
    )
