"""Where a particle stands in a layout."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..mesh.strips import STRIPS
from ..mesh.topology import Topology


def place_in(work: Any, topology: Topology, particles: NDArray[Any]) -> NDArray[Any]:
    """Of each particle: in strips slot·8 + lane, else its own number."""
    if not work.in_lanes:
        return particles
    row, column = np.divmod(particles, topology.shape[1])
    pitch = work.pitch[None]
    places: NDArray[Any] = (row * pitch + column % pitch) * STRIPS + column // pitch
    return places


def place_count(work: Any) -> int:
    """How many places the layout has."""
    return int(work.x.shape[0]) * (STRIPS if work.in_lanes else 1)
