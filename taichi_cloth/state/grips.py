"""Fields of the pins that move (`scene.model.Grip`)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..mesh.topology import Topology
from . import fields
from .places import place_count, place_in
from .pool import attached


@dataclass(eq=False)
class Grips:
    """Every pin that a body leads."""

    place: Any  # of the particle in the layout
    local: Any  # [m] vec3 where it is from the body's middle, along its axes at the start
    body: Any  # which of the grips
    count: Any  # 0-D


def grip(work: Any, topology: Topology, holder: NDArray[np.int64], centers: NDArray[np.float64]) -> None:
    """Gives a cloth or its strips their `grips`, filled.

    `holder`: number of the grip of each particle, (N,), −1 for none; `centers`: where their bodies begin [m], (G, 3).
    """
    grips = attached(work, "grips", lambda: _allocate(place_count(work)))
    held = np.flatnonzero(holder >= 0)
    fields.put_all(
        (grips.place, place_in(work, topology, held)),
        (grips.local, topology.start[held] - centers[holder[held]]),
        (grips.body, holder[held]),
    )
    grips.count[None] = len(held)


def _allocate(room: int) -> Grips:
    return Grips(
        place=fields.numbers(room, kind=ti.i32),
        local=fields.rows(3, room, ti.f32),
        body=fields.numbers(room, kind=ti.i32),
        count=fields.number(),
    )
