"""Fields of the conjugate gradients (`kernels/conjugate.py`)."""

from dataclasses import dataclass
from typing import Any

import taichi as ti

from .fields import like_places, numbers
from .pool import attached


@dataclass(eq=False)
class Search:
    """In the layout that is worked on."""

    way: Any  # [m] δ
    residual: Any  # [kg·m]
    scaled: Any  # [m] the residual over mass
    direction: Any
    product: Any  # of the matrix and the direction
    partial: Any  # sums over some of the particles
    squares: Any  # 0-D [kg·m²] residual · scaled
    before: Any  # 0-D the same before the last product
    slope: Any  # 0-D direction · product
    goal: Any  # 0-D squares at which the search is at its end


def search_of(work: Any, partial_sums: int) -> Search:
    """The search of a state."""

    def make() -> Search:
        way, residual, scaled, direction, product = (like_places(work) for _ in range(5))
        squares, before, slope, goal = (ti.field(ti.f32, ()) for _ in range(4))
        return Search(way, residual, scaled, direction, product, numbers(partial_sums), squares, before, slope, goal)

    return attached(work, "search", make)
