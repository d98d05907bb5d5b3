"""Colliders as rows of numbers: where every one is at a time, and the tables a frame's kernel reads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..kernels import controls as c
from ..scene.model import Box, Ground, Sphere

Floats32 = NDArray[np.float32]


def sphere_center(sphere: Sphere, seconds: float) -> NDArray[np.float64]:
    """Where a swaying sphere's middle is [m] at a time: center + sway·sin(2π·t/period + phase)."""
    angle = 2 * np.pi * seconds / np.asarray(sphere.period) + np.radians(sphere.phase)
    place: NDArray[np.float64] = np.asarray(sphere.center) + np.asarray(sphere.sway) * np.sin(angle)
    return place


def sphere_table(spheres: Sequence[Sphere], radii: Sequence[float], start: float, end: float) -> Floats32:
    """A row for each sphere: its middle at both ends of the frame [m], radius + margin [m], friction."""
    table = np.zeros((len(spheres), c.SPHERE_COLUMNS), np.float32)
    for row, sphere, radius in zip(table, spheres, radii, strict=True):
        row[c.SPHERE_FROM : c.SPHERE_FROM + 3] = sphere_center(sphere, start)
        row[c.SPHERE_TO : c.SPHERE_TO + 3] = sphere_center(sphere, end)
        row[c.SPHERE_REACH] = radius + sphere.margin
        row[c.SPHERE_FRICTION] = sphere.friction
    return table


def box_table(boxes: Sequence[Box]) -> Floats32:
    """A row for each box: middle, half sides, margin [m], friction."""
    rows = [(*box.center, *(side / 2 for side in box.size), box.margin, box.friction) for box in boxes]
    return np.array(rows, np.float32).reshape(len(boxes), c.BOX_COLUMNS)


def ground_table(ground: Ground | None) -> Floats32:
    """One row, height the cloth is kept above [m] and friction; none without a ground."""
    rows = [] if ground is None else [(ground.height + ground.margin, ground.friction)]
    return np.array(rows, np.float32).reshape(len(rows), c.GROUND_COLUMNS)
