"""What of a cloth never moves: masses, pins, springs in coloured order, triangles. NumPy only."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import grid


@dataclass(frozen=True)
class Batch:
    """A run of springs `first … first + count` of one family that share no particle (one colour)."""

    family: str
    first: int
    count: int


@dataclass(frozen=True, eq=False)
class Topology:
    """The constant description of one cloth; N particles, E springs, T triangles."""

    start: NDArray[np.float64]  # [m] (N, 3) where every particle is before the first frame
    mass: NDArray[np.float64]  # [kg] (N,) a third of the area of every triangle around it
    pinned: NDArray[np.bool_]  # (N,)
    ends: NDArray[np.int32]  # (E, 2) the two particles of a spring
    rest: NDArray[np.float64]  # [m] (E,) its rest length
    batches: tuple[Batch, ...]
    triangles: NDArray[np.int32]  # (T, 3)
    cells: NDArray[np.int32]  # (T, 2) row and column of the triangle in the weave

    @property
    def particle_count(self) -> int:
        return len(self.start)

    @property
    def spring_count(self) -> int:
        return len(self.ends)

    @property
    def triangle_count(self) -> int:
        return len(self.triangles)

    def family(self, name: str) -> NDArray[np.int64]:
        """Indices of the springs of one family, `structural`, `shear` or `bend`."""
        runs = [np.arange(b.first, b.first + b.count) for b in self.batches if b.family == name]
        return np.concatenate([np.zeros(0, np.int64), *runs])

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
    families: Mapping[str, float],
) -> Topology:
    """A rectangular sheet; lengths in m, angles in degrees, area density in kg/m².

    `families` gives each family's stiffness; one at 0 is left out. Raises ValueError for a pin that
    is no edge, corner or particle.
    """
    flat = grid.flat_positions(rows, columns, width, height)
    triangles, cells = grid.triangles(rows, columns)
    batches: list[Batch] = []
    pairs: list[NDArray[np.int32]] = []
    first = 0
    for family, down, along in grid.DIRECTIONS:
        if families[family] == 0:
            continue
        for batch in grid.springs(rows, columns, down, along):
            if len(batch):
                batches.append(Batch(family, first, len(batch)))
                pairs.append(batch)
                first += len(batch)
    ends = np.concatenate(pairs) if pairs else np.zeros((0, 2), np.int32)
    # Positions are float32 in the kernels. Springs measured between the rounded places are at rest to the
    # last bit; measured on the ideal grid they would push for ever, and a free sheet would drift.
    start = (flat @ grid.rotation_matrix(rotation).T + np.asarray(center)).astype(np.float32).astype(np.float64)
    return Topology(
        start=start,
        mass=lumped_mass(flat, triangles, area_density),
        pinned=grid.pinned(rows, columns, pins),
        ends=ends,
        rest=np.linalg.norm(start[ends[:, 0]] - start[ends[:, 1]], axis=1),
        batches=tuple(batches),
        triangles=triangles,
        cells=cells,
    )


def lumped_mass(
    positions: NDArray[np.float64], triangles: NDArray[np.int32], area_density: float
) -> NDArray[np.float64]:
    """Mass of each particle [kg]: every triangle gives a third of its own to each corner."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    mass: NDArray[np.float64] = np.zeros(len(positions))
    np.add.at(mass, triangles, (area * area_density / 3)[:, None])
    return mass
