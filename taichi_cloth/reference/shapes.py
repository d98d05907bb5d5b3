"""Signed distance to a collider and its gradient, along the collider's own axes, in float64; negative inside."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..scene.model import Box, Capsule, Collider, Ground, Sphere
from .springs import Floats

# Takes places (3, M) [m]; gives the distance [m] (M,) and the outward unit normal (3, M).
Distance = Callable[[Floats], tuple[Floats, Floats]]


def distance_of(collider: Collider | Ground) -> Distance:
    """The distance to a ball, capsule, box, plane or the ground."""
    match collider:
        case Sphere():
            radius = collider.radius
            return lambda x: _from_core(x, radius)
        case Capsule():
            half, thick = collider.length / 2, collider.radius
            return lambda x: _from_core(x - _on_axis(x, half), thick)
        case Box():
            sides = np.array(collider.size)[:, None] / 2
            return lambda x: _box(x, sides)
        case _:
            return _half_space


def _from_core(away: Floats, radius: float) -> tuple[Floats, Floats]:
    long = np.sqrt((away * away).sum(axis=0))
    normal = away / np.where(long > 0, long, 1.0)
    normal[1, long == 0] = 1.0
    return long - radius, normal


def _on_axis(x: Floats, half: float) -> Floats:
    core = np.zeros_like(x)
    core[1] = np.clip(x[1], -half, half)
    return core


def _box(x: Floats, sides: Floats) -> tuple[Floats, Floats]:
    beyond = np.abs(x) - sides
    outside = np.maximum(beyond, 0.0)
    distance, normal = _from_core(outside, 0.0)
    within = distance == 0
    face = beyond[:, within].argmax(axis=0)
    normal[:, within] = np.eye(3)[:, face]
    distance[within] = beyond[:, within].max(axis=0)
    return distance, normal * np.where(x < 0, -1.0, 1.0)


def _half_space(x: Floats) -> tuple[Floats, Floats]:
    normal = np.zeros_like(x)
    normal[1] = 1.0
    return x[1].copy(), normal
