"""Fields of the particles that the hand holds (`hand.py`)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..mesh.topology import Topology
from . import fields
from .places import place_in


@dataclass(eq=False)
class Held:
    """How many there are goes to kernels with each frame."""

    place: Any  # of the particle in the layout
    taken: Any  # [m] vec3 where it was when it was taken


def room_to_hold(places: int) -> Held:
    """Room for as many particles as a layout has places."""
    return Held(fields.numbers(places, kind=ti.i32), fields.places(places))


def hold(work: Any, topology: Topology, particles: NDArray[np.int64], taken: NDArray[np.float64]) -> None:
    """Tells a cloth or its strips which particles the hand holds, (M,), and where it took them [m], (M, 3)."""
    fields.put_all((work.held.place, place_in(work, topology, particles)), (work.held.taken, taken - topology.origin))
