"""What of a cloth never moves: masses, pins, springs in coloured order, triangles. NumPy only."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..scene.model import CORNERS
from . import grid
from .bending import Bonds, bonds

ORIGINS = 8.0  # [m] apart
CONSTANTS = ("weft", "warp", "shear", "bend")  # [N/m] of a fabric, of which a spring has a share
NO_GRID = (0, 0)


@dataclass(frozen=True)
class Batch:
    """A run of springs `first … first + count` of one family and colour: no two share a particle."""

    family: str
    first: int
    count: int
    direction: int = -1  # index in `grid.DIRECTIONS`; −1 in a mesh that is no grid


@dataclass(frozen=True, eq=False)
class Topology:
    """The constant description of one cloth; N particles, E springs, T triangles."""

    origin: NDArray[np.float64]  # [m] (3,) kernels keep places from here, where float32 does not round them as afar
    start: NDArray[np.float64]  # [m] (N, 3) where every particle is before the first frame
    flat: NDArray[np.float64]  # [m] (N, 3) where it is on the sheet as it was cut; other sheets lie far from it
    mass: NDArray[np.float64]  # [kg] (N,) a third of every triangle around it, and what is sewn on
    pinned: NDArray[np.bool_]  # (N,)
    ends: NDArray[np.int32]  # (E, 2) the two particles of a spring
    rest: NDArray[np.float64]  # [m] (E,) its rest length
    shares: NDArray[np.float64]  # (4, E) how much of each of `CONSTANTS` a spring has: half as much along an edge
    batches: tuple[Batch, ...]
    bonds: Bonds  # that resist bending
    triangles: NDArray[np.int32]  # (T, 3)
    cells: NDArray[np.int32]  # (T, 2) row and column of the triangle in the weave; in a mesh its ring, and 0
    shape: tuple[int, int] = NO_GRID  # rows and columns of the grid
    sheets: int = 1  # how many there are, the rows of one after those of another (`pile.py`)
    leash: NDArray[np.float64] | None = None  # [m] (N,) how far a particle may go from its start; None: anywhere

    @property
    def direction(self) -> NDArray[np.int64]:
        """Index in `grid.DIRECTIONS` of every spring, shape (E,)."""
        return np.repeat([b.direction for b in self.batches], [b.count for b in self.batches]).astype(np.int64)

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
    def one_sheet(self) -> NDArray[np.float64]:
        """[m] (N / sheets, 3) the first sheet, as it was cut."""
        return self.flat[: self.particle_count // self.sheets]

    @property
    def side(self) -> float:
        """[m] The longer side of a sheet as it was cut; of a mesh file the longest side of its box."""
        return float(np.ptp(self.one_sheet, axis=0).max())

    @property
    def edges(self) -> NDArray[np.int32]:
        """The sides of the triangles, each once, shape (sides, 2)."""
        sides = np.sort(self.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        once: NDArray[np.int32] = np.unique(sides, axis=0)
        return once

    def family(self, name: str) -> NDArray[np.int64]:
        """Indices of the springs of one family, `structural`, `shear` or `bend`."""
        return np.flatnonzero(self.by_family({name: 1.0}))

    def by_family(self, numbers: dict[str, float]) -> NDArray[np.float64]:
        """The number of its family for every spring, 0 for one that is not named, shape (E,)."""
        found = [numbers.get(b.family, 0.0) for b in self.batches]
        return np.repeat(found, [b.count for b in self.batches])

    def by_place(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Numbers of the springs, (E,), as (6, rows, columns): by direction and the upper left of the spring's place.

        Zero where there is no spring.
        """
        return grid.by_place(self.shape, self.direction, self.ends, values)

    @property
    def family_counts(self) -> dict[str, int]:
        """Number of springs of each family the cloth has."""
        counts: dict[str, int] = {}
        for batch in self.batches:
            counts[batch.family] = counts.get(batch.family, 0) + batch.count
        return counts


def sheet(
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
    lumping: str = "area",
    weight: float = 0.0,
    weight_at: str = "corners",
    bending: float = 0.0,
) -> Topology:
    """A rectangular sheet; lengths in m, angles in degrees, area density in kg/m², bending stiffness in N·m.

    `directions` tells which of `grid.DIRECTIONS` have springs, and `diagonals` whether a cell has both or only
    the one along which its triangles meet. With `lumping` "area" a particle weighs a third of its triangles and a
    spring along an edge stands for half a cell; with "equal" all are like those inside. Each corner carries a `weight`
    [kg] besides, or only the one that `weight_at` names.

    Raises ValueError for a pin that is no edge, corner or particle.
    """
    flat = grid.flat_positions(rows, columns, width, height)
    triangles, cells = grid.triangles(rows, columns)
    batches: list[Batch] = []
    pairs: list[NDArray[np.int32]] = []
    first = 0
    for direction, (family, down, along) in enumerate(grid.DIRECTIONS):
        if not directions[direction]:
            continue
        for batch in grid.springs(rows, columns, down, along, alternate=family == "shear" and diagonals == 1):
            if len(batch):
                batches.append(Batch(family, first, len(batch), direction))
                pairs.append(batch)
                first += len(batch)
    ends = np.concatenate(pairs) if pairs else np.zeros((0, 2), np.int32)
    origin = origin_near(center)
    places = laid(flat, np.subtract(center, origin), rotation)
    mass = lumped_mass(flat, triangles, area_density)
    along_edge = grid.along_edge(rows, columns, ends)
    if lumping == "equal":
        mass = np.full(len(flat), area_density * width * height / ((rows - 1) * (columns - 1)))
        along_edge[:] = False
    heavy = CORNERS if weight_at == "corners" else (weight_at,)
    mass[grid.pinned(rows, columns, heavy)] += weight
    return Topology(
        origin=origin,
        start=places + origin,
        flat=flat,
        mass=mass,
        pinned=grid.pinned(rows, columns, pins),
        ends=ends,
        rest=lengths(places, ends),
        shares=_shares(batches, (height / (rows - 1)) / (width / (columns - 1))) * np.where(along_edge, 0.5, 1.0),
        batches=tuple(batches),
        bonds=bonds(rows, columns, width, height, bending, halved=lumping == "area"),
        triangles=triangles,
        cells=cells,
        shape=(rows, columns),
    )


def _shares(batches: list[Batch], slim: float) -> NDArray[np.float64]:
    """Of `CONSTANTS`, of springs of a whole cell's width, (4, E); `slim` is a cell's height over its width."""
    one = np.zeros((len(CONSTANTS), len(grid.DIRECTIONS)))
    one[[0, 1, 2, 2, 3, 3], range(6)] = slim, 1 / slim, 1, 1, slim, 1 / slim
    return np.repeat(one[:, np.array([b.direction for b in batches], int)], [b.count for b in batches], axis=1)


def origin_near(center: tuple[float, float, float]) -> NDArray[np.float64]:
    """The nearest of points that are `ORIGINS` apart [m], (3,): the origin itself for all that is near it."""
    return ORIGINS * np.round(np.asarray(center) / ORIGINS)


def laid(
    flat: NDArray[np.float64], center: NDArray[np.float64], rotation: tuple[float, float, float]
) -> NDArray[np.float32]:
    """A flat sheet (N, 3) [m] turned about x, then y, then z [degrees], and its middle brought to a place [m]."""
    places: NDArray[np.float32] = (flat @ grid.rotation_matrix(rotation).T + center).astype(np.float32)
    return places


def lengths(places: NDArray[np.float32], ends: NDArray[np.int32]) -> NDArray[np.float64]:
    """Length of every spring [m], (E,), bit for bit as the kernels find it: with float32, and squares added x, y, z.

    A sheet at its start is then at rest to the last bit. With lengths that are more exact, or those of the ideal
    grid, its springs would push for ever, and a free sheet that is turned would drift (66 mm in 10,000 substeps of
    `verlet`).
    """
    x, y, z = (places[ends[:, 1]] - places[ends[:, 0]]).T
    found: NDArray[np.float64] = np.sqrt(x * x + y * y + z * z).astype(np.float64)
    return found


def lumped_mass(
    positions: NDArray[np.float64], triangles: NDArray[np.int32], area_density: float
) -> NDArray[np.float64]:
    """Mass of each particle [kg]: every triangle gives a third of its own to each corner."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    mass: NDArray[np.float64] = np.zeros(len(positions))
    np.add.at(mass, triangles, (area * area_density / 3)[:, None])
    return mass
