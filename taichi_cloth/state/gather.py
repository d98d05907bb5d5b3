"""The same cloth for machines that run a thread for each particle: what meets at every particle, beside its fields."""

import dataclasses
from typing import Any, ClassVar

import taichi as ti

from ..mesh.incidence import incidence
from ..mesh.topology import Topology
from . import fields
from .cloth import ClothState
from .pool import attached


class GatherState:
    """A cloth's own fields by the same names, and the springs and triangles of each particle.

    Those of particle i are `spring_rows[spring_first[i]]` up to `spring_rows[spring_first[i + 1]]`, and likewise
    for triangles. Nothing is copied for a frame.
    """

    in_lanes: ClassVar[bool] = False
    gathers: ClassVar[bool] = True

    def __init__(self, cloth: ClothState) -> None:
        for field in dataclasses.fields(cloth):
            setattr(self, field.name, getattr(cloth, field.name))
        particles, springs, triangles = (f.shape[0] for f in (cloth.x, cloth.rest, cloth.triangles))
        self.spring_first = fields.numbers(particles + 1, kind=ti.i32)
        self.spring_rows = fields.numbers(2 * springs, kind=ti.i32)
        self.triangle_first = fields.numbers(particles + 1, kind=ti.i32)
        self.triangle_rows = fields.numbers(3 * triangles, kind=ti.i32)

    def upload(self, topology: Topology) -> None:
        """Fills what a cloth does not have already."""
        spring_first, spring_rows = incidence(topology.ends, topology.particle_count)
        triangle_first, triangle_rows = incidence(topology.triangles, topology.particle_count)
        fields.put_all(
            (self.spring_first, spring_first),
            (self.spring_rows, spring_rows),
            (self.triangle_first, triangle_first),
            (self.triangle_rows, triangle_rows),
        )


def gathering(cloth: ClothState, topology: Topology) -> Any:
    """The form of a cloth for a thread each, filled. It stays with the cloth's fields."""
    work = attached(cloth, "gathering", lambda: GatherState(cloth))
    work.upload(topology)
    return work
