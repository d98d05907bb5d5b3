"""A cloth of triangles and quads as springs, bonds and masses. NumPy only.

Springs
    structural: every edge. An edge of a quad is a thread that stands for half of the area on both its sides: its
        constant is warp or weft times width/length, as in a grid. An edge of triangles follows no thread: it has
        k = E·A/length² for each triangle of area A at it (van Gelder 1998, *Approximate simulation of elastic membranes
        by triangulated spring meshes*), with E = (warp + weft + 4·shear)/3 [N/m]. So C11 + C22 + 2·C12 of the membrane
        is that of a grid of these springs (C11 = warp + shear, C22 = weft + shear, C12 = C66 = shear) whatever the
        triangles are, but alike in all directions, with a Poisson's ratio of 1/3. A grid is like this, too, where
        warp = weft = 2·shear.
    shear: the diagonals of quads, both or the one that cuts them. Triangles have that from their edges.
    bend: the two ends of threads that go straight on through a point of quads; the two points across an edge between
        triangles. As in a grid, no linear bending.

Threads of quads: `weft` along the x axis of the file, `warp` across it, between them by the square of the cosine.

Bending as in `bending.py`, by stencils: along the threads and over the cells of quads, and hinges between triangles.
Those (Bergou et al. 2006, *A quadratic bending model for inextensible surfaces*, section 3.1) have the energy
½·c·(|e|·θ)² of an edge e bent by θ. With c = B/(A₀ + A₁) equilateral triangles resist like a plate of B (Seung and
Nelson 1988, *Defects in flexible membranes with crystalline order*); with the paper's 3·B/(A₀ + A₁) they would be three
times too stiff. Sheets are flat at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .bending import Bonds
from .cloth_file import ClothFile
from .colouring import coloured
from .incidence import incidence
from .stencils import Stencils, bonds_of
from .topology import CONSTANTS, Batch, Topology, laid, lengths, lumped_mass, origin_near

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]
WEFT, WARP, SHEAR, BEND = range(len(CONSTANTS))


@dataclass(frozen=True, eq=False)
class Springs:
    """Pairs of points, and how much of each of `CONSTANTS` a spring between them has."""

    ends: Whole  # (E, 2)
    shares: Floats  # (4, E)


def imported(
    file: ClothFile,
    *,
    scale: float,
    center: tuple[float, float, float],
    rotation: tuple[float, float, float],
    area_density: float,
    families: set[str],
    diagonals: int = 2,
    bending: float = 0.0,
) -> Topology:
    """The cloth of a file, `scale` [m] to its unit, with springs of these families; else as `sheet`. No pins."""
    flat = file.points * scale
    origin = origin_near(center)
    places = laid(flat, np.subtract(center, origin), rotation)
    edges, threads = _edges(file, flat, diagonals), _threads(file)
    made = {"structural": edges, "shear": _diagonals(file, diagonals), "bend": _over(file, edges, threads)}
    batches: list[Batch] = []
    ends: list[NDArray[np.int32]] = [np.zeros((0, 2), np.int32)]
    shares: list[Floats] = [np.zeros((len(CONSTANTS), 0))]
    first = 0
    for family, springs in made.items():
        if family not in families:
            continue
        colour = coloured(springs.ends.astype(np.int32), len(flat))
        order = np.argsort(colour, kind="stable")
        for count in np.bincount(colour).tolist():
            batches.append(Batch(family, first, count))
            first += count
        ends.append(springs.ends[order].astype(np.int32))
        shares.append(springs.shares[:, order])
    all_ends = np.concatenate(ends)
    return Topology(
        origin=origin,
        start=places + origin,
        flat=flat,
        mass=lumped_mass(flat, file.triangles, area_density),
        pinned=np.zeros(len(flat), bool),
        ends=all_ends,
        rest=lengths(places, all_ends),
        shares=np.concatenate(shares, axis=1),
        batches=tuple(batches),
        bonds=_bonds(file, flat, threads, bending),
        triangles=file.triangles,
        cells=_cells(file),
    )


def _areas(file: ClothFile, flat: Floats) -> Floats:
    """[m²] of every face, (F,): of a quad half the cross product of its diagonals."""
    a, b, c, d = (flat[file.faces[:, k]] for k in range(4))
    twice = np.where(file.is_quad[:, None], np.cross(c - a, d - b), np.cross(b - a, c - a))
    areas: Floats = np.linalg.norm(twice, axis=1) / 2
    return areas


def _strips(file: ClothFile, flat: Floats) -> tuple[Floats, Floats]:
    """[m²] beside each edge, (E,): half of the quads there, and all of the triangles."""
    owner, (edges, which) = file.sides[1], file.edges
    area, quad = _areas(file, flat)[owner], file.is_quad[owner]
    halves: Floats = np.bincount(which, area / 2 * quad, len(edges)).astype(float)
    whole: Floats = np.bincount(which, area * ~quad, len(edges)).astype(float)
    return halves, whole


def _edges(file: ClothFile, flat: Floats, diagonals: int) -> Springs:
    ends = file.edges[0]
    way = flat[ends[:, 1]] - flat[ends[:, 0]]
    squared = (way**2).sum(axis=1)
    weft = way[:, 0] ** 2 / squared
    quads, triangles = (area / squared for area in _strips(file, flat))
    shares = np.zeros((len(CONSTANTS), len(ends)))
    shares[WEFT] = weft * quads + triangles / 3
    shares[WARP] = (1 - weft) * quads + triangles / 3
    shares[SHEAR] = 2 / 3 * diagonals * triangles  # as a grid has it from one diagonal a cell, or two
    return Springs(ends, shares)


def _diagonals(file: ClothFile, diagonals: int) -> Springs:
    quads = file.triangles[len(file.faces) - int(file.is_quad.sum()) :].reshape(-1, 6)  # each quad's two halves
    a, b, c, d = quads[:, 0], quads[:, 1], quads[:, 2], quads[:, 5]
    ends = [np.stack([a, c], axis=-1)] + [np.stack([b, d], axis=-1)] * (diagonals == 2)
    return _alike(np.concatenate(ends).astype(np.int64), SHEAR, np.ones(len(quads) * diagonals))


def _over(file: ClothFile, edges: Springs, threads: Whole) -> Springs:
    """From point to point over the one between them, or over an edge."""
    point, before, after = threads.T
    ends = file.edges[0]
    ways = np.stack([ends[before].sum(axis=1) - point, ends[after].sum(axis=1) - point], axis=-1)
    width = edges.shares[[WEFT, WARP]].sum(axis=0)  # of a thread, over its length
    across = _hinges(file, both=True)
    both = np.concatenate([ways, across[:, 2:]])
    return _alike(both, BEND, np.concatenate([(width[before] + width[after]) / 2, np.ones(len(across))]))


def _alike(ends: Whole, constant: int, share: Floats) -> Springs:
    shares = np.zeros((len(CONSTANTS), len(ends)))
    shares[constant] = share
    return Springs(ends, shares)


def _threads(file: ClothFile) -> Whole:
    """Where one edge goes straight on as another, among quads only: the point and both edges, (K, 3).

    At a point of four edges at most, two edges without a common face, of which neither has another such partner.
    """
    edges, which = file.edges
    sides, owner = file.sides
    count = len(file.points)
    first, rows = incidence(edges.astype(np.int32), count)
    valence = np.diff(first)
    slots = np.arange(4)
    there = slots < valence[:, None]
    around = np.where(there, rows[np.minimum(first[:-1, None] + slots, len(rows) - 1)], -1)  # (N, 4) edges
    apart = there[:, :, None] & there[:, None, :] & ~np.eye(4, dtype=bool)
    # The side after another of the same face begins where that one ends.
    begins = np.flatnonzero(np.diff(owner, prepend=-1))
    onwards = np.arange(1, len(sides) + 1)
    onwards[np.append(begins[1:], len(sides)) - 1] = begins
    point, one, two = sides[:, 1], which, which[onwards]
    k, m = (around[point] == one[:, None]).argmax(axis=1), (around[point] == two[:, None]).argmax(axis=1)
    apart[point, k, m] = apart[point, m, k] = False
    usable = valence <= 4
    usable[file.faces[~file.is_quad, :3]] = False
    single = apart.sum(axis=2) == 1
    pairs = apart & single[:, :, None] & single[:, None, :] & usable[:, None, None]
    point, k, m = np.nonzero(np.triu(pairs))
    return np.stack([point, around[point, k], around[point, m]], axis=-1).astype(np.int64)


def _hinges(file: ClothFile, *, both: bool = False) -> Whole:
    """Edges between two faces of which one at least is a triangle, or both are: their two points, and the one across
    them in each of the two triangles, (H, 4).
    """
    edges, which = file.edges
    sides, owner = file.sides
    order = np.argsort(which, kind="stable")
    pair = order[np.flatnonzero(np.diff(which[order], append=-1) == 0)[:, None] + [0, 1]]  # two sides that are one edge
    quads = file.is_quad[owner[pair]].sum(axis=1)
    pair = pair[quads == 0 if both else quads < 2]
    across = np.stack([_opposite(file, sides[pair[:, k]]) for k in (0, 1)], axis=-1)
    corners: Whole = np.concatenate([edges[which[pair[:, 0]]], across], axis=1)
    return corners


def _opposite(file: ClothFile, sides: Whole) -> Whole:
    """The third point of the triangle that has each side, (M, 2), in this direction; (M,)."""
    triangles, count = file.triangles.astype(np.int64), len(file.points)
    keys = (triangles * count + np.roll(triangles, -1, axis=1)).reshape(-1)
    order = np.argsort(keys)
    found = order[np.searchsorted(keys[order], sides[:, 0] * count + sides[:, 1])]
    third: Whole = triangles[found // 3, (found % 3 + 2) % 3]
    return third


def _bonds(file: ClothFile, flat: Floats, threads: Whole, bending: float) -> Bonds:
    """Those of a sheet of bending stiffness `bending` [N·m]."""
    if bending == 0:
        return bonds_of([])
    edges = file.edges[0]
    lengths = np.linalg.norm(flat[edges[:, 1]] - flat[edges[:, 0]], axis=1)
    halves, _ = _strips(file, flat)

    point, before, after = threads.T
    ends = np.stack([edges[before].sum(axis=1) - point, point, edges[after].sum(axis=1) - point], axis=-1)
    a, b = lengths[before], lengths[after]
    constant = bending * (halves[before] + halves[after]) * 2 / (a + b) ** 2
    along = Stencils(ends, np.stack([1 / a, -1 / a - 1 / b, 1 / b], axis=-1), constant)

    quads = file.faces[file.is_quad]
    signs = np.tile([1.0, -1.0, 1.0, -1.0], (len(quads), 1))
    twist = Stencils(quads, signs, 2 * bending / _areas(file, flat)[file.is_quad])

    corners = _hinges(file)
    x = flat[corners]
    area = sum(np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, k] - x[:, 0]), axis=1) / 2 for k in (2, 3))
    at = {(i, k): _cotangent(x[:, i], x[:, 1 - i], x[:, k]) for i in (0, 1) for k in (2, 3)}
    factors = [at[1, 2] + at[1, 3], at[0, 2] + at[0, 3], -at[0, 2] - at[1, 2], -at[0, 3] - at[1, 3]]
    hinge = Stencils(corners, np.stack(factors, axis=-1), bending / area)
    return bonds_of([along, twist, hinge])


def _cotangent(corner: Floats, a: Floats, b: Floats) -> Floats:
    """Of the angle at each corner between the ways to a and to b; all (M, 3)."""
    u, v = a - corner, b - corner
    found: Floats = (u * v).sum(axis=1) / np.linalg.norm(np.cross(u, v), axis=1)
    return found


def _cells(file: ClothFile) -> NDArray[np.int32]:
    """How many edges each triangle, or the quad that it is half of, is from the first point of its piece; and 0."""
    steps = np.append(file.steps[0], len(file.points))  # what stands for the fourth point of a triangle is far
    nearest = steps[file.faces].min(axis=1)
    rings = np.concatenate([nearest[~file.is_quad], nearest[file.is_quad].repeat(2)])
    return np.stack([rings, np.zeros_like(rings)], axis=-1).astype(np.int32)
