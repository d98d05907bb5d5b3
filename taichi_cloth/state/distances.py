"""Fields of the distances to meshes (`mesh/distances.py`)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti

from ..mesh.distances import DistanceGrid
from . import fields
from .pool import Pool


@dataclass(eq=False)
class Distances:
    """The grids of a scene's meshes, one after another."""

    values: Any  # [m] at all nodes
    first: Any  # (M,) where a mesh's begin
    nodes: Any  # ivec3 (M,) along each side
    spacing: Any  # [m] (M,)


def _allocate(nodes: int, meshes: int) -> Distances:
    return Distances(
        values=fields.numbers(nodes),
        first=fields.numbers(meshes, kind=ti.i32),
        nodes=fields.rows(3, meshes),
        spacing=fields.numbers(meshes),
    )


_pool = Pool(_allocate)


def take(grids: Sequence[DistanceGrid]) -> Distances | None:
    """The distances to a scene's meshes, filled; None for a scene without any."""
    if not grids:
        return None
    sizes = np.array([grid.values.size for grid in grids])
    found = _pool.take(int(sizes.sum()), len(grids))
    fields.put_all(
        (found.values, np.concatenate([grid.values.ravel() for grid in grids])),
        (found.first, np.cumsum(sizes) - sizes),
        (found.nodes, np.array([grid.values.shape for grid in grids])),
        (found.spacing, np.array([grid.spacing for grid in grids])),
    )
    return found


def give_back(distances: Distances | None) -> None:
    """Keeps the fields for the next scene with meshes."""
    if distances is not None:
        _pool.give_back(distances)
