"""Fields of the bonds that resist bending (`mesh/bending.py`)."""

from dataclasses import dataclass
from typing import Any

import taichi as ti

from ..mesh import grid, strips
from ..mesh.grid import DIRECTIONS
from ..mesh.incidence import incidence
from ..mesh.topology import Topology
from . import fields
from .pool import attached, capacity


@dataclass(eq=False)
class BondList:
    """Names as those of a cloth's springs and of what `GatherState` adds: a sum over them is the same."""

    ends: Any  # ivec2 (P,)
    stiffness: Any  # [N/m] (P,) constant of each; negative where it pushes
    spring_count: Any  # 0-D
    spring_first: Any  # (N + 1,)
    spring_rows: Any  # (2·P,)


@dataclass(eq=False)
class BondStrips:
    """The same for a grid in strips."""

    stiffness: Any  # [N/m] row of eight (6·S,) by direction, then by the upper left of the bond's place


def bond(work: Any, topology: Topology) -> None:
    """Gives a cloth or its strips their `bonds`, filled."""
    bonds, particles = topology.bonds, work.x.shape[0]
    if work.in_lanes:
        strip = attached(work, "bonds", lambda: BondStrips(fields.numbers(work.rest.shape[0], lanes=True)))
        by_place = grid.by_place(topology.shape, bonds.direction, bonds.ends, bonds.constant)
        fields.put(strip.stiffness, strips.pack(by_place, work.pitch[None]).reshape(-1, strips.STRIPS))
        return
    found = attached(work, "bonds", lambda: _allocate(particles, capacity(len(DIRECTIONS) * particles)))
    first, rows = incidence(bonds.ends, topology.particle_count)
    fields.put_all(
        (found.ends, bonds.ends),
        (found.stiffness, bonds.constant),
        (found.spring_first, first),
        (found.spring_rows, rows),
    )
    found.spring_count[None] = len(bonds.ends)


def _allocate(particles: int, bonds: int) -> BondList:
    return BondList(
        ends=ti.Vector.field(2, ti.i32, bonds),
        stiffness=fields.numbers(bonds),
        spring_count=fields.number(),
        spring_first=fields.numbers(particles + 1, kind=ti.i32),
        spring_rows=fields.numbers(2 * bonds, kind=ti.i32),
    )
