"""Fields of the leashes of a cloth: how far each particle may go from where it was at the start."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..mesh.strips import STRIPS
from ..mesh.topology import Topology
from . import fields
from .places import place_in
from .pool import attached


@dataclass(eq=False)
class Leashes:
    """Slot by slot, as the places of the layout."""

    place: Any  # [m] from the cloth's origin
    reach: Any  # [m]


def leash(work: Any, topology: Topology) -> None:
    """Gives a cloth that has a `leash`, or its strips, their `leashes`, filled."""
    assert topology.leash is not None
    slots, lanes = work.x.shape[0], work.in_lanes
    found = attached(
        work, "leashes", lambda: Leashes(fields.places(slots, lanes=lanes), fields.numbers(slots, lanes=lanes))
    )
    at = place_in(work, topology, np.arange(topology.particle_count))
    pairs = (found.place, topology.start - topology.origin), (found.reach, topology.leash)
    fields.put_all(*((field, _in_lanes(values, at, slots) if lanes else values) for field, values in pairs))


def _in_lanes(values: Any, at: Any, slots: int) -> Any:
    """Values of the particles, (N,) or (N, 3), as rows of eight or three of them; zero where there is no particle."""
    room = np.zeros((slots * STRIPS, *values.shape[1:]))
    room[at] = values
    rows = room.reshape(slots, STRIPS, *values.shape[1:])
    return rows if values.ndim == 1 else rows.transpose(0, 2, 1)
