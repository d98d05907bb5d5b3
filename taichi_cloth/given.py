"""Numbers that a caller hands in: of the right shape, finite, and not too far away, or refused in a line."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .scene.errors import shown

Floats = NDArray[np.float64]

FARTHEST = 1e6  # [m], [m/s] ten times as far as a scene reaches; its square has room in float32


def places(values: ArrayLike, name: str, *shapes: tuple[int, ...]) -> Floats:
    """An array of one of these shapes, of numbers up to `FARTHEST`. Raises ValueError."""
    array = numbers(values)
    if array.shape not in shapes:
        raise ValueError(f"{name} are {shapes[0][0]} times three numbers")
    bad = ~(np.abs(array) <= FARTHEST)
    if bad.any():
        reason = f"beyond ±{FARTHEST:g}" if np.isfinite(array[bad]).all() else "not finite"
        where = f", at particle {np.argwhere(bad)[0, 0]}" if array.ndim == 2 else ""
        raise ValueError(f"{name} hold a number that is {reason}{where}")
    return array


def target_point(target: ArrayLike) -> Floats:
    """Three numbers up to `FARTHEST` [m]. Raises ValueError."""
    point = numbers(target)
    if point.shape != (3,) or not (np.abs(point) <= FARTHEST).all():
        raise ValueError(f"a target is three finite numbers [m], up to ±{FARTHEST:g}, not {shown(target)}")
    return point


def radius_of(radius: float) -> float:
    """A number from 0 up to `FARTHEST` [m]. Raises ValueError."""
    number = numbers(radius)
    if number.shape != () or not 0 <= number <= FARTHEST:
        raise ValueError(f"a radius is a number from 0 up to {FARTHEST:g} [m], not {shown(radius)}")
    return float(number)


def numbers(values: ArrayLike) -> Floats:
    """As an array of their own; an empty one for what is no numbers."""
    try:
        array = np.array(values)
    except (TypeError, ValueError):  # rows of different lengths
        return np.zeros(0)
    return array.astype(np.float64) if array.dtype.kind in "iuf" else np.zeros(0)
