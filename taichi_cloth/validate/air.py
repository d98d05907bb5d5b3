"""A6: air."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..scene.model import Wind
from ..simulation import Simulation
from .exact import fall_in_air, terminal_speed
from .row import Row, relative
from .setups import advance, base, center

STILL = Wind(turbulence=0.0)
DENSITIES = (0.1, 0.15, 0.2, 0.5)  # [kg/m²]
TIMES = (0.2, 1.0)  # [s]


def falling(solver: str) -> Iterator[Row]:
    """A level sheet in still air: its speed at the end, and on the way there."""
    for density in DENSITIES:
        scene = replace(base(solver, rotation=(-90.0, 0.0, 0.0), area_density=density), wind=STILL)
        terminal = terminal_speed(density, STILL.air_density, STILL.drag)
        with Simulation(scene) as simulation:
            done, start = 0.0, center(simulation)[1]
            for seconds in TIMES if density == 0.2 else ():
                advance(simulation, seconds - done)
                done = seconds
                speed, way = fall_in_air(seconds, terminal)
                yield relative(
                    f"speed after {seconds:g} s of falling flat [m/s]", speed, mean_speed(simulation), 1e-2, 1e-3
                )
                yield relative(f"way after {seconds:g} s [m]", way, start - center(simulation)[1], 1e-2, 1e-3)
            advance(simulation, 3.0 - done)
            yield relative(f"terminal speed of {density:g} kg/m² [m/s]", terminal, mean_speed(simulation), 1e-2, 1e-3)


def mean_speed(simulation: Simulation) -> float:
    """Downwards [m/s]."""
    return -float(np.average(simulation.velocities()[:, 1], weights=simulation.topology.mass))
