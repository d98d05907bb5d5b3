"""The row of numbers that steers a frame of one scene (`kernels/controls.py` names its columns)."""

from __future__ import annotations

from collections.abc import Mapping
from math import exp

import numpy as np
from numpy.typing import NDArray

from .hand import Hand
from .kernels import controls as c
from .scene import Scene

Floats = NDArray[np.float64]


class ControlsRow:
    """What of the row a scene says, once; what changes from frame to frame is handed in."""

    def __init__(self, scene: Scene, origin: Floats, damping_time: float) -> None:
        """`origin` [m]: where kernels keep places from; `damping_time` [s]: that of the springs' dashpots."""
        self._scene = scene
        self._origin = origin
        self._gust_phase = np.random.default_rng(scene.seed).random(3)  # [turns]
        self._fixed = np.zeros(c.COUNT, np.float32)
        self._fixed[c.AREA_DENSITY] = scene.cloth.area_density
        self._fixed[c.DAMPING_TIME] = damping_time
        self._fixed[c.COMPRESSION] = scene.fabric.compression
        if scene.self_collision is not None:
            self._fixed[c.SELF_FRICTION] = scene.self_collision.friction
        if scene.wind is not None:
            self._fixed[c.DRAG], self._fixed[c.LIFT] = scene.wind.drag, scene.wind.lift
            self._fixed[c.HALF_AIR_DENSITY] = scene.wind.air_density / 2

    def at(
        self, live: Mapping[str, float], *, blowing: bool, hands: Mapping[int, Hand], seconds: float, h: float
    ) -> NDArray[np.float32]:
        """The row for the frame that begins at `seconds` [s], in substeps of `h` [s], (controls.COUNT,).

        `live`: the live parameters by name. Where it is not `blowing` the air stands still; it still slows the cloth.
        """
        row = self._fixed.copy()
        row[c.GRAVITY] = live["gravity"]
        row[c.KEPT] = exp(-live["damping"] * h)
        row[c.STIFFNESS] = live["stiffness"]
        row[c.MOST_STRAIN] = live.get("limit_strain", 0.0)
        row[c.TETHER_SLACK] = live.get("tethers_slack", 1.0)
        row[c.THICKNESS] = live.get("self_collision_thickness", 0.0)
        wind = self._scene.wind
        if wind is not None:
            x, z = (live["wind_x"], live["wind_z"]) if blowing else (0.0, 0.0)
            row[c.WIND_X], row[c.WIND_Z] = x, z
            row[c.GUST] = wind.turbulence * np.hypot(x, z)
            # Kept within a turn in float64: float32 would lose the phase in a long run.
            turns = self._gust_phase + np.asarray(c.GUST_RATES) * seconds
            turns -= np.asarray(c.GUST_WAVES) @ self._origin
            row[c.GUST_TURNS : c.GUST_TURNS + 3] = turns % 1
        for number, hand in hands.items():
            first = c.HANDS + 6 * number
            row[first : first + 6] = *(hand.start - hand.taken[0]), *(hand.target - hand.taken[0])
        return row
