"""Air on the triangles of a cloth, in float64.

For a triangle of area A with unit normal n, whose middle the air passes at the relative velocity u:

    drag = ½ρ·C_D·A·(n·u)²·u/|u|
    lift = ½ρ·C_L·A·(n·u)·(|u|·n − (n·u)·u/|u|)

Each corner carries a third. The mean wind blows along x and z; a gust adds three plane waves, one for each component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene.model import Scene
from .springs import Floats, Ints, SpringModel

# Of the waves of x, y and z: height as a share of the gust, turns a second, turns a meter along x, y and z.
HEIGHTS = np.array([0.6, 0.3, 1.0])
RATES = np.array([0.43, 0.77, 0.32])
WAVES = np.array([[0.31, 0.17, 0.11], [0.13, 0.37, 0.19], [0.23, -0.11, 0.29]])


def parabolic_wave(turns: Floats) -> Floats:
    """A wave of period 1 between −1 and 1, made of two parabolas: 0 at 0, −1 at a quarter, 1 at three quarters."""
    fraction = turns - np.floor(turns)
    return np.where(fraction < 0.5, -16 * fraction * (0.5 - fraction), 16 * (fraction - 0.5) * (1 - fraction))


@dataclass(frozen=True, eq=False)
class Air:
    """The air of a scene and the triangles that it passes."""

    corners: Ints  # (3, T)
    mean: Floats  # [m/s] (3, 1)
    gust: float  # [m/s]
    phases: Floats  # (3,) [turns]
    density: float  # [kg/m³]
    drag: float
    lift: float

    def velocity(self, x: Floats, seconds: float) -> Floats:
        """Of the air at places (3, M) [m/s], (3, M)."""
        turns = WAVES @ x - (self.phases + RATES * seconds)[:, None]
        return self.mean + self.gust * HEIGHTS[:, None] * parabolic_wave(turns)

    def force(self, x: Floats, v: Floats, seconds: float) -> Floats:
        """On every particle [N], (3, N)."""
        a, b, c = (x.take(corner, axis=1) for corner in self.corners)
        slow = sum(v.take(corner, axis=1) for corner in self.corners) / 3
        u = self.velocity((a + b + c) / 3, seconds) - slow
        p, q = b - a, c - a
        area = 0.5 * np.stack([p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]])
        size = np.sqrt((area * area).sum(axis=0))
        speed = np.sqrt((u * u).sum(axis=0))
        normal = area / np.where(size > 0, size, 1.0)
        way = u / np.where(speed > 0, speed, 1.0)
        through = (normal * u).sum(axis=0)
        half = 0.5 * self.density * size * through
        force = half * (self.drag * through * way + self.lift * (speed * normal - through * way))
        corners, count = self.corners.reshape(-1), x.shape[1]
        return np.stack([np.bincount(corners, np.tile(part, 3), count) for part in force / 3])


def air_of(scene: Scene, model: SpringModel) -> Air | None:
    """The air of a scene with `[wind]`."""
    wind = scene.wind
    if wind is None:
        return None
    return Air(
        corners=np.ascontiguousarray(model.topology.triangles.T, dtype=np.int64),
        mean=np.array([[wind.x], [0.0], [wind.z]]),
        gust=wind.turbulence * float(np.hypot(wind.x, wind.z)),
        phases=np.random.default_rng(scene.seed).random(3),
        density=wind.air_density,
        drag=wind.drag,
        lift=wind.lift,
    )
