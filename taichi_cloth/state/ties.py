"""Fields of the tethers of a cloth (`mesh/tethers.py`)."""

from dataclasses import dataclass
from typing import Any

import taichi as ti
from numpy.typing import NDArray

from ..mesh import strips
from ..mesh.tethers import MOST, tethers
from ..mesh.topology import Topology
from . import fields
from .places import place_in
from .pool import attached


@dataclass(eq=False)
class Ties:
    """The tethers of one layout: first those to the nearest pins, slot by slot, then to the next."""

    pin: Any  # particle at the end; in strips slot·8 + lane
    reach: Any  # [m] distance on the flat sheet
    place: Any  # [m] where that particle is; in strips only
    count: Any  # 0-D tethers of a particle


def _allocate(room: int, lanes: bool) -> Ties:
    return Ties(
        pin=fields.numbers(room, lanes=lanes, kind=ti.i32),
        reach=fields.numbers(room, lanes=lanes),
        place=fields.places(room, lanes=True) if lanes else None,
        count=fields.number(),
    )


def tie(work: Any, topology: Topology) -> None:
    """Gives a cloth or its strips their `ties`, filled."""
    lanes = work.in_lanes
    ties = attached(work, "ties", lambda: _allocate(MOST * work.x.shape[0], lanes))
    pins, reach = tethers(topology)
    ties.count[None] = len(pins)

    def laid_out(values: NDArray[Any]) -> NDArray[Any]:
        if not lanes:
            return values.reshape(-1)
        return strips.pack(values.reshape(-1, *topology.shape), work.pitch[None]).reshape(-1, strips.STRIPS)

    fields.put_all((ties.pin, laid_out(place_in(work, topology, pins))), (ties.reach, laid_out(reach)))
