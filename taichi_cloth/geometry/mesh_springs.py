"""Springs, bending links and masses of a mesh of triangles and quads. NumPy only.

Springs
    structural: every edge. An edge of a quad is a yarn that represents half of the area of the quads on both sides:
        its stiffness is warp or weft times width/length, as in a grid. An edge of triangles follows no yarn: it has
        k = E·A/length² for each adjacent triangle of area A (van Gelder 1998, *Approximate simulation of elastic
        membranes by triangulated spring meshes*), with E = (warp + weft + 4·shear)/3 [N/m]. For any triangles, the
        C11 + C22 + 2·C12 of the membrane is then that of a grid of these springs (C11 = warp + shear,
        C22 = weft + shear, C12 = C66 = shear), but the membrane is isotropic, with a Poisson's ratio of 1/3. So is a
        grid in which warp = weft = 2·shear.
    shear: the diagonals of quads, both or only the one that cuts them. Triangles resist shear by their edges. So that a
        fabric is the same on all rectangular quads, the edges of long ones have a part of the shear, as in a grid.
    bend: the ends of two quad edges that continue each other straight through a vertex, and the two vertices opposite
        an edge between triangles. As in a grid, this bending is not linear.

Yarn directions of quads: `weft` is along the x axis of the file, `warp` is across it. In between, the stiffness is
interpolated by the squared cosine.

Bending links as in `bending.py`: along the yarns and over the cells of quads, and at the vertices of triangles. The
cloth is flat at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .bending import Bending, BendingLinks, QuadraticForms, Surface, links_of_forms, triangle_bending
from .cloth_mesh import ClothMesh
from .topology import (
    STIFFNESS_KEYS,
    ColorBatch,
    Topology,
    adjacency,
    float32_lengths,
    greedy_coloring,
    local_origin,
    lumped_mass,
    place_sheet,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
WEFT, WARP, SHEAR, BEND = range(len(STIFFNESS_KEYS))


@dataclass(frozen=True, eq=False)
class Springs:
    """Springs of one family."""

    ends: Ints
    """The two vertices of every spring, (E, 2)."""
    stiffness_factors: Floats
    """Factors of `STIFFNESS_KEYS` that add up to the stiffness of every spring, (4, E)."""


def build_mesh(
    file: ClothMesh,
    *,
    scale: float,
    center: tuple[float, float, float],
    rotation: tuple[float, float, float],
    area_density: float,
    families: set[str],
    diagonals: int = 2,
    bending: Bending = 0.0,
) -> Topology:
    """Return the cloth of a mesh file, without pins, with springs of these families.

    `scale`: length of one unit of the file [m]. `center` of the bounding box [m]. `rotation` about x, then y, then z
    [degrees]. `area_density` [kg/m²]. `diagonals`: 1 or 2 shear springs per quad. `bending`: bending stiffness [N·m].
    """
    flat = file.vertices * scale
    origin = local_origin(center)
    positions = place_sheet(flat, np.subtract(center, origin), rotation)
    structural, yarns = _structural_springs(file, flat, diagonals), _yarns(file)
    springs_of = {
        "structural": structural,
        "shear": _shear_springs(file, flat, diagonals),
        "bend": _bend_springs(file, structural, yarns),
    }
    batches: list[ColorBatch] = []
    ends: list[NDArray[np.int32]] = [np.zeros((0, 2), np.int32)]
    factors: list[Floats] = [np.zeros((len(STIFFNESS_KEYS), 0))]
    first = 0
    for family, springs in springs_of.items():
        if family not in families:
            continue
        color = greedy_coloring(springs.ends.astype(np.int32), len(flat))
        order = np.argsort(color, kind="stable")
        for count in np.bincount(color).tolist():
            batches.append(ColorBatch(family, first, count))
            first += count
        ends.append(springs.ends[order].astype(np.int32))
        factors.append(springs.stiffness_factors[:, order])
    all_ends = np.concatenate(ends)
    return Topology(
        origin=origin,
        start=positions + origin,
        flat=flat,
        mass=lumped_mass(flat, file.triangles, area_density),
        pinned=np.zeros(len(flat), bool),
        ends=all_ends,
        rest=float32_lengths(positions, all_ends),
        stiffness_factors=np.concatenate(factors, axis=1),
        batches=tuple(batches),
        bending_links=_bending_links(file, flat, yarns, bending),
        triangles=file.triangles,
        cells=_cells(file),
    )


def _area_vectors(file: ClothMesh, flat: Floats) -> Floats:
    """Return the area of every face [m²] times its normal, (F, 3): of a quad half the product of its diagonals."""
    a, b, c, d = (flat[file.faces[:, k]] for k in range(4))
    vectors: Floats = np.where(file.is_quad[:, None], np.cross(c - a, d - b), np.cross(b - a, c - a)) / 2
    return vectors


def _adjacent_areas(file: ClothMesh, flat: Floats) -> tuple[Floats, Floats]:
    """Return the adjacent areas of every edge [m²], (E,): half of its quads, and all of its triangles."""
    owner, (edges, edge_of) = file.sides[1], file.edges
    area, quad = np.linalg.norm(_area_vectors(file, flat), axis=1)[owner], file.is_quad[owner]
    half_quads: Floats = np.bincount(edge_of, area / 2 * quad, len(edges)).astype(float)
    full_triangles: Floats = np.bincount(edge_of, area * ~quad, len(edges)).astype(float)
    return half_quads, full_triangles


def _aspects(file: ClothMesh, flat: Floats) -> Floats:
    """Return the aspect of every quad, (Q,): the mean length of its first and third side over that of the others."""
    a, b, c, d = (flat[file.faces[file.is_quad, k]] for k in range(4))
    first, second, third, fourth = (np.linalg.norm(side, axis=1) for side in (b - a, c - b, d - c, a - d))
    aspects: Floats = (first + third) / (second + fourth)
    return aspects


def _shear_of_edges(file: ClothMesh, flat: Floats) -> Floats:
    """Return what the edges of quads take up of C11 and C22 beside two diagonals, as a factor of shear, (E,).

    Of a side that is r times as long as the quad is wide it is (1/r − r)/2, for half of the quad.
    """
    owner, (edges, edge_of) = file.sides[1], file.edges
    quad = file.is_quad[owner]
    ratio = np.ones(len(owner))
    ratio[quad] = np.stack([(r := _aspects(file, flat)), 1 / r, r, 1 / r], axis=1).reshape(-1)
    factors: Floats = np.bincount(edge_of, (1 / ratio - ratio) / 2, len(edges)).astype(float)
    return factors


def _structural_springs(file: ClothMesh, flat: Floats, diagonals: int) -> Springs:
    """Return a spring for every edge."""
    ends = file.edges[0]
    edge = flat[ends[:, 1]] - flat[ends[:, 0]]
    squared = (edge**2).sum(axis=1)
    weft = edge[:, 0] ** 2 / squared
    quads, triangles = (area / squared for area in _adjacent_areas(file, flat))
    factors = np.zeros((len(STIFFNESS_KEYS), len(ends)))
    factors[WEFT] = weft * quads + triangles / 3
    factors[WARP] = (1 - weft) * quads + triangles / 3
    # As in a grid with one or two diagonals per cell.
    factors[SHEAR] = diagonals * (2 / 3 * triangles + _shear_of_edges(file, flat) / 2)
    return Springs(ends, factors)


def _shear_springs(file: ClothMesh, flat: Floats, diagonals: int) -> Springs:
    """Return one or two springs along the diagonals of every quad, with the factor (a + 1/a)/2 for an aspect a."""
    quads = file.triangles[len(file.faces) - int(file.is_quad.sum()) :].reshape(-1, 6)  # the two halves of each quad
    a, b, c, d = quads[:, 0], quads[:, 1], quads[:, 2], quads[:, 5]
    ends = [np.stack([a, c], axis=-1)] + [np.stack([b, d], axis=-1)] * (diagonals == 2)
    aspect = _aspects(file, flat)
    factor = (aspect + 1 / aspect) / 2
    return _uniform_springs(np.concatenate(ends).astype(np.int64), SHEAR, np.tile(factor, diagonals))


def _bend_springs(file: ClothMesh, edges: Springs, yarns: Ints) -> Springs:
    """Return the bend springs of quads and of triangles.

    They connect vertices two edges apart along a yarn, and the two vertices opposite an edge between triangles.
    """
    point, before, after = yarns.T
    ends = file.edges[0]
    yarn_ends = np.stack([ends[before].sum(axis=1) - point, ends[after].sum(axis=1) - point], axis=-1)
    width = edges.stiffness_factors[[WEFT, WARP]].sum(axis=0)  # of a yarn, divided by its length
    hinges = _hinges(file)
    all_ends = np.concatenate([yarn_ends, hinges[:, 2:]])
    return _uniform_springs(all_ends, BEND, np.concatenate([(width[before] + width[after]) / 2, np.ones(len(hinges))]))


def _uniform_springs(ends: Ints, constant: int, factor: Floats) -> Springs:
    """Return springs that use one of `STIFFNESS_KEYS`, with its factor for each, (E,)."""
    factors = np.zeros((len(STIFFNESS_KEYS), len(ends)))
    factors[constant] = factor
    return Springs(ends, factors)


def _yarns(file: ClothMesh) -> Ints:
    """Return all pairs of quad edges that continue each other straight through a vertex: vertex and both edges, (K, 3).

    Two edges continue each other if they have no face in common and neither has another candidate. The vertex has only
    quads and at most four edges.
    """
    edges, edge_of = file.edges
    sides, owner = file.sides
    count = len(file.vertices)
    first, rows = adjacency(edges.astype(np.int32), count)
    valence = np.diff(first)
    slot = np.arange(4)
    exists = slot < valence[:, None]
    edges_at = np.where(exists, rows[np.minimum(first[:-1, None] + slot, len(rows) - 1)], -1)  # (N, 4)
    opposite = exists[:, :, None] & exists[:, None, :] & ~np.eye(4, dtype=bool)
    # The next side of the same face starts where this one ends.
    starts = np.flatnonzero(np.diff(owner, prepend=-1))
    next_side = np.arange(1, len(sides) + 1)
    next_side[np.append(starts[1:], len(sides)) - 1] = starts
    point, incoming, outgoing = sides[:, 1], edge_of, edge_of[next_side]
    k, m = (edges_at[point] == incoming[:, None]).argmax(axis=1), (edges_at[point] == outgoing[:, None]).argmax(axis=1)
    opposite[point, k, m] = opposite[point, m, k] = False
    usable = valence <= 4
    usable[file.faces[~file.is_quad, :3]] = False
    unique = opposite.sum(axis=2) == 1
    pairs = opposite & unique[:, :, None] & unique[:, None, :] & usable[:, None, None]
    point, k, m = np.nonzero(np.triu(pairs))
    return np.stack([point, edges_at[point, k], edges_at[point, m]], axis=-1).astype(np.int64)


def _hinges(file: ClothMesh) -> Ints:
    """Return the edges between two triangles, (H, 4).

    The columns are the two ends of the edge and the opposite vertices of the triangles on its two sides.
    """
    edges, edge_of = file.edges
    sides, owner = file.sides
    order = np.argsort(edge_of, kind="stable")
    pair = order[np.flatnonzero(np.diff(edge_of[order], append=-1) == 0)[:, None] + [0, 1]]  # both sides of an edge
    quads = file.is_quad[owner[pair]].sum(axis=1)
    pair = pair[quads == 0]
    opposite = np.stack([_opposite(file, sides[pair[:, k]]) for k in (0, 1)], axis=-1)
    corners: Ints = np.concatenate([edges[edge_of[pair[:, 0]]], opposite], axis=1)
    return corners


def _opposite(file: ClothMesh, sides: Ints) -> Ints:
    """Return the third vertex of the triangle that contains each directed side, (M, 2); (M,)."""
    triangles, count = file.triangles.astype(np.int64), len(file.vertices)
    keys = (triangles * count + np.roll(triangles, -1, axis=1)).reshape(-1)
    order = np.argsort(keys)
    match = order[np.searchsorted(keys[order], sides[:, 0] * count + sides[:, 1])]
    third: Ints = triangles[match // 3, (match % 3 + 2) % 3]
    return third


def _bending_links(file: ClothMesh, flat: Floats, yarns: Ints, bending: Bending) -> BendingLinks:
    """Return the bending links of a cloth of bending stiffness `bending` [N·m]; none for 0."""
    warp, weft = np.broadcast_to(bending, 2)
    if warp == weft == 0:
        return links_of_forms([])
    edges, edge_of = file.edges
    edge_lengths = np.linalg.norm(flat[edges[:, 1]] - flat[edges[:, 0]], axis=1)
    quad_areas, _ = _adjacent_areas(file, flat)

    point, before, after = yarns.T
    ends = np.stack([edges[before].sum(axis=1) - point, point, edges[after].sum(axis=1) - point], axis=-1)
    a, b = edge_lengths[before], edge_lengths[after]
    across = flat[ends[:, 2], 0] - flat[ends[:, 0], 0]  # along the x axis, of the weft
    weft_share = (across / (a + b)) ** 2
    stiffness = warp + (weft - warp) * weft_share
    constant = stiffness * (quad_areas[before] + quad_areas[after]) * 2 / (a + b) ** 2
    along = QuadraticForms(ends, np.stack([1 / a, -1 / a - 1 / b, 1 / b], axis=-1), constant)

    quads, vectors = file.faces[file.is_quad], _area_vectors(file, flat)
    signs = np.tile([1.0, -1.0, 1.0, -1.0], (len(quads), 1))
    areas = np.linalg.norm(vectors[file.is_quad], axis=1)
    twist = QuadraticForms(quads, signs, 2 * np.sqrt(warp * weft) / areas)
    surface = Surface(flat, file.faces, vectors, edges[np.bincount(edge_of) == 1])
    return links_of_forms([along, twist, *triangle_bending(surface, warp, weft)])


def _cells(file: ClothMesh) -> NDArray[np.int32]:
    """Return the ring of each triangle, and 0, (T, 2): they stand for the row and column of a cell in a grid.

    The ring is the graph distance [edges] of the triangle, or of the quad that it was cut from, from the first vertex
    of its component.
    """
    distances = np.append(
        file.graph_distance[0], len(file.vertices)
    )  # the last is for −1, the fourth vertex of triangles
    nearest = distances[file.faces].min(axis=1)
    rings = np.concatenate([nearest[~file.is_quad], nearest[file.is_quad].repeat(2)])
    return np.stack([rings, np.zeros_like(rings)], axis=-1).astype(np.int32)
