"""The same cloth for machines that run a thread for each particle: what meets at every particle, beside its fields."""

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import taichi as ti

from ..mesh.incidence import incidence
from ..mesh.topology import Topology
from . import fields
from .cloth import ClothState
from .pool import Pool


@dataclass(eq=False)
class Incidence:
    """Springs and triangles of each particle; those of particle i are `rows[first[i]]` up to `first[i + 1]`."""

    spring_first: Any  # (N + 1,)
    spring_rows: Any  # (2·E,)
    triangle_first: Any  # (N + 1,)
    triangle_rows: Any  # (3·T,)


class GatherState:
    """The cloth's own fields by the same names, and its incidence. Nothing is copied for a frame."""

    in_lanes: ClassVar[bool] = False
    gathers: ClassVar[bool] = True

    def __init__(self, cloth: ClothState, topology: Topology) -> None:
        ends, triangles, count = topology.ends, topology.triangles, topology.particle_count
        self.incidence = _pool.take(count + 1, 2 * len(ends), 3 * len(triangles))
        for part in (cloth, self.incidence):
            for field in dataclasses.fields(part):
                setattr(self, field.name, getattr(part, field.name))
        if hasattr(cloth, "ties"):
            self.ties = cloth.ties
        for name, rows in (("spring", ends), ("triangle", triangles)):
            for kind, values in zip(("first", "rows"), incidence(rows, count), strict=True):
                fields.put(getattr(self.incidence, f"{name}_{kind}"), values)

    def close(self) -> None:
        """Keeps the incidence's fields for the next cloth of its size."""
        _pool.give_back(self.incidence)


def _allocate(particles: int, springs: int, triangles: int) -> Incidence:
    return Incidence(
        spring_first=fields.numbers(particles, kind=ti.i32),
        spring_rows=fields.numbers(springs, kind=ti.i32),
        triangle_first=fields.numbers(particles, kind=ti.i32),
        triangle_rows=fields.numbers(triangles, kind=ti.i32),
    )


_pool = Pool(_allocate)
