"""The constant description of a cloth: masses, pins, springs in color order, and triangles. NumPy only.

Also graph coloring, the adjacency of particles with springs and triangles, and metrics of a cloth (strains, energies)
from its positions and velocities, in float64.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from ..scene.keys import CORNERS, check_value, keys_of, types_of
from ..scene.schema import Cloth
from . import grid
from .bending import Bending, BendingLinks, grid_bending_links
from .grid import NO_GRID
from .membrane_model import ElasticTriangles

ORIGINS = 0.5  # [m] spacing of the local origins
FAR = 2.0  # [m] from the origin, where positions in float32 have steps of a quarter of a micrometer
STIFFNESS_KEYS = ("weft", "warp", "shear", "bend_spring")  # [N/m] in section `fabric`; a spring has a factor of each
MIN_SHARE = 0.1  # of the constant of a yarn that its springs keep beside the diagonals of long cells


@dataclass(frozen=True)
class ColorBatch:
    """Consecutive springs of one family and color: no two of them share a particle."""

    family: str
    """`structural`, `shear` or `bend`."""
    first: int
    """Index of the first spring."""
    count: int
    """Number of springs."""
    direction: int = -1
    """Index in `grid.DIRECTIONS`; −1 in a mesh that is not a grid."""


@dataclass(frozen=True, eq=False, repr=False)
class Topology:
    """The constant description of one cloth: N particles, E springs, T triangles."""

    origin: NDArray[np.float64]
    """Local origin of the cloth at its start [m], (3,). Kernel positions are relative to a local origin: float32 rounds
    coarsely far from 0."""
    start: NDArray[np.float64]
    """World position of every particle before the first frame [m], (N, 3)."""
    flat: NDArray[np.float64]
    """Position of every particle in the flat sheet [m], (N, 3). Layers are far apart from each other."""
    mass: NDArray[np.float64]
    """Mass of every particle [kg], (N,): a third of every triangle around it, and corner masses."""
    pinned: NDArray[np.bool_]
    """Whether each particle is pinned, (N,)."""
    ends: NDArray[np.int32]
    """The two particles of every spring, (E, 2)."""
    rest: NDArray[np.float64]
    """Rest length of every spring [m], (E,)."""
    stiffness_factors: NDArray[np.float64]
    """Factors of the fabric's weft, warp, shear and bend_spring (`STIFFNESS_KEYS`) for every spring, (4, E). Its
    stiffness [N/m] is the sum of their products (`stiffness_of`). Those of shear may be negative.

    A spring along an edge of a sheet has half the factors if it represents half a cell.
    """
    batches: tuple[ColorBatch, ...]
    """The springs in order, by family and color."""
    bending_links: BendingLinks
    """Pairs of particles that resist bending."""
    triangles: NDArray[np.int32]
    """The three particles of every triangle, (T, 3)."""
    cells: NDArray[np.int32]
    """Row and column of every triangle's cell, (T, 2); in a mesh file its ring (`mesh_springs.py`), and 0."""
    shape: tuple[int, int] = NO_GRID
    """Rows and columns of the grid. Rows of several layers follow each other."""
    layers: int = 1
    """Number of layers (`layers.py`). Particles are numbered layer by layer."""
    membrane: ElasticTriangles | None = None
    """Triangles of an elastic continuum or of a weave, instead of springs with stiffness."""
    max_distance: NDArray[np.float64] | None = None
    """Max distance of every particle from its start [m], (N,); None if there is no limit."""

    def __post_init__(self) -> None:
        """Make the arrays read-only: the fields of a simulation are copies, which writing here would not change."""
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                view = value.view()
                view.flags.writeable = False
                object.__setattr__(self, field.name, view)

    @property
    def direction(self) -> NDArray[np.int64]:
        """Index in `grid.DIRECTIONS` of every spring, (E,)."""
        return np.repeat([b.direction for b in self.batches], [b.count for b in self.batches]).astype(np.int64)

    def __repr__(self) -> str:
        counts = f"{self.particle_count} particles, {self.spring_count} springs, {len(self.triangles)} triangles"
        return f"<Topology: {counts}>"

    @property
    def particle_count(self) -> int:
        return len(self.start)

    @property
    def spring_count(self) -> int:
        return len(self.ends)

    @property
    def triangle_count(self) -> int:
        return len(self.triangles)

    @property
    def first_layer(self) -> NDArray[np.float64]:
        """Flat positions of the first layer [m], (N / layers, 3)."""
        return self.flat[: self.particle_count // self.layers]

    @property
    def longest_side(self) -> float:
        """The longer side of the flat sheet, or the longest side of the bounding box of a mesh file [m]."""
        return float(np.ptp(self.first_layer, axis=0).max())

    @property
    def extent(self) -> float:
        """The longest side of the bounding box of the cloth at its start [m]."""
        return float(np.ptp(self.start, axis=0).max())

    @property
    def edges(self) -> NDArray[np.int32]:
        """The sides of the triangles, each once, (sides, 2)."""
        sides = np.sort(self.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        unique_sides: NDArray[np.int32] = np.unique(sides, axis=0)
        return unique_sides

    def family(self, name: str) -> NDArray[np.int64]:
        """Return the indices of the springs of one family: `structural`, `shear` or `bend`."""
        return np.flatnonzero(self.by_family({name: 1.0}))

    def by_family(self, numbers: dict[str, float]) -> NDArray[np.float64]:
        """Return the value of its family for every spring, (E,); 0 for families that are not in `numbers`."""
        values = [numbers.get(b.family, 0.0) for b in self.batches]
        return np.repeat(values, [b.count for b in self.batches])

    def as_grid(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Arrange values of springs, (E,), by direction and position, (6, rows, columns).

        The position is the upper left corner of the box around both ends. Entries without a spring are zero.
        """
        return grid.to_grid(self.shape, self.direction, self.ends, values)

    @property
    def family_counts(self) -> dict[str, int]:
        """Number of springs of each family that the cloth has."""
        counts: dict[str, int] = {}
        for batch in self.batches:
            counts[batch.family] = counts.get(batch.family, 0) + batch.count
        return counts


# -- construction of a sheet -------------------------------------------------------------------------------------------


def build_sheet(
    *,
    rows: int,
    columns: int,
    width: float,
    height: float,
    center: tuple[float, float, float],
    rotation: tuple[float, float, float],
    area_density: float,
    pins: Iterable[str | int],
    directions: Sequence[bool],
    diagonals: int = 2,
    mass_lumping: str = "area",
    corner_mass: float = 0.0,
    corner_mass_at: str = "corners",
    bending: Bending = 0.0,
) -> Topology:
    """Return a rectangular sheet.

    Lengths are in [m], angles in [degrees], `area_density` in [kg/m²] and the bending stiffness `bending` in [N·m].
    `directions`: which of `grid.DIRECTIONS` have springs. `diagonals`: shear springs per cell, both (2) or only the
    one that cuts the cell into triangles (1). `mass_lumping`: "area" gives a particle a third of the mass of its
    triangles, and springs along an edge of the sheet represent half a cell; with "uniform" all are like those inside.
    `corner_mass`: additional mass [kg] of the corner `corner_mass_at`, or of each corner if that is "corners".

    Raises ValueError for a pin that is not an edge, a corner or a particle, and for a `mass_lumping`, `corner_mass` or
    `corner_mass_at` that a scene does not allow.
    """
    checked = {"mass_lumping": mass_lumping, "corner_mass": corner_mass, "corner_mass_at": corner_mass_at}
    for name, value in checked.items():
        check_value(value, types_of(Cloth)[name], keys_of(Cloth)[name], "", name)
    flat = grid.flat_positions(rows, columns, width, height)
    triangles, cells = grid.triangles(rows, columns)
    batches: list[ColorBatch] = []
    springs: list[NDArray[np.int32]] = []
    first = 0
    for direction, (family, down, along) in enumerate(grid.DIRECTIONS):
        if not directions[direction]:
            continue
        for batch in grid.springs(rows, columns, down, along, alternate=family == "shear" and diagonals == 1):
            if len(batch):
                batches.append(ColorBatch(family, first, len(batch), direction))
                springs.append(batch)
                first += len(batch)
    ends = np.concatenate(springs) if springs else np.zeros((0, 2), np.int32)
    origin = local_origin(center)
    positions = place_sheet(flat, np.subtract(center, origin), rotation)
    mass = lumped_mass(flat, triangles, area_density)
    halves = np.tile(np.where(grid.on_boundary(rows, columns, ends), 0.5, 1.0), (len(STIFFNESS_KEYS), 1))
    if mass_lumping == "uniform":
        mass = np.full(len(flat), area_density * width * height / ((rows - 1) * (columns - 1)))
        halves[[key != "shear" for key in STIFFNESS_KEYS]] = 1.0  # diagonals have half a cell there anyway
    weighted_corners = CORNERS if corner_mass_at == "corners" else (corner_mass_at,)
    mass[grid.pinned_mask(rows, columns, weighted_corners)] += corner_mass
    return Topology(
        origin=origin,
        start=positions + origin,
        flat=flat,
        mass=mass,
        pinned=grid.pinned_mask(rows, columns, pins),
        ends=ends,
        rest=float32_lengths(positions, ends),
        stiffness_factors=_stiffness_factors(batches, grid.cell_aspect(rows, columns, width, height), diagonals)
        * halves,
        batches=tuple(batches),
        bending_links=grid_bending_links(rows, columns, width, height, bending, halved=mass_lumping == "area"),
        triangles=triangles,
        cells=cells,
        shape=(rows, columns),
    )


def stiffness_of(constants: Sequence[float], factors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the stiffness of every spring [N/m], (E,), from the values of `STIFFNESS_KEYS` and their factors, (4, E).

    On long cells the diagonals may be stiffer than the fabric. The springs along the cells then keep a share of their
    own constant: without them, particles of even and odd row + column would slide along each other without resistance.
    """
    own = np.array(constants) * [key != "shear" for key in STIFFNESS_KEYS]
    stiffness: NDArray[np.float64] = np.maximum(constants @ factors, MIN_SHARE * (own @ factors))
    return np.maximum(stiffness, 0.0)


def _stiffness_factors(batches: list[ColorBatch], aspect: float, diagonals: int) -> NDArray[np.float64]:
    """Return the factors of `STIFFNESS_KEYS` for springs that represent a full cell, (4, E).

    `aspect`: height of a cell divided by its width, a. `diagonals` of a cell: 1 or 2.

    Two diagonals of stiffness k add 2k/(a + 1/a) to C12 and C66 of the cell, a⁻² times this to C along the rows, and a²
    times to C along the columns (Hooke's law of three strains). So that a fabric is the same on all cells, diagonals
    get the factor (a + 1/a)/2, and the springs along rows and columns take up the rest.
    """
    diagonal, rest = (aspect + 1 / aspect) / 2, (aspect - 1 / aspect) * diagonals / 2
    by_direction = np.zeros((len(STIFFNESS_KEYS), len(grid.DIRECTIONS)))
    by_direction[[0, 1, 3, 3], [0, 1, 4, 5]] = aspect, 1 / aspect, aspect, 1 / aspect
    by_direction[2, :4] = rest, -rest, diagonal, diagonal
    return np.repeat(by_direction[:, np.array([b.direction for b in batches], int)], [b.count for b in batches], axis=1)


def local_origin(center: tuple[float, float, float]) -> NDArray[np.float64]:
    """Return the nearest of the local origins, which are `ORIGINS` apart [m], (3,).

    Positions near a local origin are small, and float32 rounds them finely. It is a point of a lattice and not the
    center itself: colliders at such points, such as a ground at height 0, are then at exact distances from it.
    """
    return ORIGINS * np.round(np.asarray(center) / ORIGINS)


def origin_shift(positions: NDArray[np.generic]) -> NDArray[np.float64]:
    """Return how far the local origin should move to follow the cloth [m], (3,); zero while the cloth is near.

    `positions`: relative to the present origin [m], (N, 3). The origin moves along each axis as far as all particles
    are away from it, so every coordinate becomes smaller: its difference to the shift is exact in float32.
    """
    nearest = np.maximum(positions.min(axis=0), 0.0) + np.minimum(positions.max(axis=0), 0.0)
    if not FAR <= np.abs(nearest).max() < np.inf:
        return np.zeros(3)
    shift: NDArray[np.float64] = ORIGINS * np.trunc(nearest.astype(np.float64) / ORIGINS)
    return shift


def place_sheet(
    flat: NDArray[np.float64], center: NDArray[np.float64], rotation: tuple[float, float, float]
) -> NDArray[np.float32]:
    """Return the positions [m], (N, 3), of a flat sheet that is rotated and then moved to `center` [m].

    `flat`: positions around the origin [m], (N, 3). `rotation`: about x, then y, then z [degrees].
    """
    positions: NDArray[np.float32] = (flat @ grid.rotation_matrix(rotation).T + center).astype(np.float32)
    return positions


def float32_lengths(positions: NDArray[np.float32], ends: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return the length of every spring [m], (E,), bit for bit as the kernels compute it.

    That is in float32, with squares summed in the order x, y, z. A sheet at its start is then at rest to the last bit.
    With more accurate lengths, or those of the ideal grid, its springs would push forever, and a free, rotated sheet
    would drift (66 mm in 10,000 substeps of `verlet`).
    """
    x, y, z = (positions[ends[:, 1]] - positions[ends[:, 0]]).T
    lengths: NDArray[np.float64] = np.sqrt(x * x + y * y + z * z).astype(np.float64)
    return lengths


def lumped_mass(
    positions: NDArray[np.float64], triangles: NDArray[np.int32], area_density: float
) -> NDArray[np.float64]:
    """Return the mass of every particle [kg], (N,): a third of the mass of each of its triangles."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    mass: NDArray[np.float64] = np.zeros(len(positions))
    np.add.at(mass, triangles, (area * area_density / 3)[:, None])
    return mass


# -- coloring and adjacency --------------------------------------------------------------------------------------------


def greedy_coloring(rows: NDArray[np.int32], count: int) -> NDArray[np.int64]:
    """Return a color for each row of particle indices, (R,).

    Rows of one color share no particle, so none waits for the result of another. Each row in turn gets the lowest color
    that none of its particles has yet. `count`: number of particles.
    """
    used = [0] * count  # bit mask of the colors at each particle
    colors = np.zeros(len(rows), np.int64)
    for k, row in enumerate(rows.tolist()):
        unavailable = 0
        for particle in row:
            unavailable |= used[particle]
        free = ~unavailable & (unavailable + 1)
        for particle in row:
            used[particle] |= free
        colors[k] = free.bit_length() - 1
    return colors


def adjacency(corners: NDArray[np.int32], count: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return which rows of `corners`, (R, 2 or 3), contain each of `count` particles, in ascending order.

    The rows of particle i are `rows[first[i]:first[i + 1]]`. Returns `first`, (count + 1,), and `rows`.
    """
    particles = corners.reshape(-1)
    order = np.argsort(particles, kind="stable")
    first = np.searchsorted(particles[order], np.arange(count + 1))
    return first.astype(np.int32), (order // corners.shape[1]).astype(np.int32)


Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ClothMetrics:
    """The state of a cloth in eight numbers."""

    max_strain: float  # largest length/rest − 1 of the structural springs (of all springs if there are none)
    mean_strain: float  # mean |length/rest − 1| of these springs
    kinetic_energy: float  # [J] of all particles that are neither pinned nor attached
    potential_energy: float  # [J] of gravity, zero at y = 0
    penetration: float  # [m] largest depth of a particle below a collider's surface, 0 if there is none
    finite: bool  # whether all positions are finite
    intersections: int | None  # times that an edge passes through a triangle; None without self-collision
    frame_error: float | None = None  # [m] error of the last frame (docs/frame_error.md); None if it was not measured


def spring_strains(topology: Topology, positions: Floats, springs: NDArray[np.int64] | slice = slice(None)) -> Floats:
    """Return length/rest − 1 of every spring, (E,), or of some."""
    ends = topology.ends[springs]
    a, b = positions[ends[:, 0]], positions[ends[:, 1]]
    strains: Floats = np.linalg.norm(b - a, axis=1) / topology.rest[springs] - 1
    return strains


def energies(topology: Topology, positions: Floats, velocities: Floats, gravity: float) -> tuple[float, float]:
    """Return the kinetic energy and the potential energy of gravity [J]. Pinned particles have no kinetic energy."""
    moving = np.where(topology.pinned, 0, topology.mass)
    squares = velocities * velocities
    kinetic = 0.5 * float(np.sum(moving * (squares[:, 0] + squares[:, 1] + squares[:, 2])))  # `sum(axis=1)` is slower
    return kinetic, float(np.sum(topology.mass * gravity * positions[:, 1]))
