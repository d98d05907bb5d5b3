"""Fields of the particles that hands hold (`hand.py`)."""

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
    hand: Any  # which of the hands holds it


def room_to_hold(places: int) -> Held:
    """Room for as many particles as a layout has places."""
    place, hand = (fields.numbers(places, kind=ti.i32) for _ in range(2))
    return Held(place, fields.rows(3, places, ti.f32), hand)


def hold(
    work: Any, topology: Topology, particles: NDArray[np.int64], taken: NDArray[np.float64], hand: NDArray[np.int64]
) -> None:
    """Tells a cloth or its strips what is held, (M,), where it was taken [m], (M, 3), and by which hand, (M,)."""
    fields.put_all(
        (work.held.place, place_in(work, topology, particles)),
        (work.held.taken, taken - topology.origin),
        (work.held.hand, hand),
    )
