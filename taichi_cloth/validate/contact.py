"""A7: contact and friction, on level ground."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..scene.model import Ground
from ..simulation import Simulation
from .exact import GRAVITY
from .row import Row, at_most, relative
from .setups import advance, base, center

FRICTIONS = (0.1, 0.3, 0.5)
SPEED = 1.0  # [m/s]
LEVEL = (-90.0, 0.0, 0.0)


def stopping(solver: str) -> Iterator[Row]:
    """A sheet slides over the ground until friction has used its energy up: v²/(2μg)."""
    for friction in FRICTIONS:
        ground = Ground(height=0.0, margin=0.0, friction=friction)
        with Simulation(replace(base(solver, rotation=LEVEL), ground=ground)) as simulation:
            advance(simulation, 0.2)
            x = simulation.positions()
            simulation.place(x, (SPEED, 0.0, 0.0))
            start = center(simulation)[0]
            advance(simulation, SPEED / (friction * GRAVITY) + 0.5)
            exact = SPEED**2 / (2 * friction * GRAVITY)
            yield relative(
                f"way to a stop from 1 m/s, μ = {friction:g} [m]", exact, center(simulation)[0] - start, 0.05, 0.01
            )


def resting(solver: str) -> Iterator[Row]:
    """Dropped from 5 cm on the ground: five seconds later it lies still, on it and not in it."""
    scene = replace(base(solver, rotation=LEVEL, center=(0.0, 0.05, 0.0)), ground=Ground(height=0.0, margin=0.0))
    with Simulation(scene) as simulation:
        advance(simulation, 5.0)
        energy = 0.5 * float((simulation.velocities() ** 2).sum(axis=1).max())
        yield at_most("kinetic energy of the fastest particle after 5 s [J/kg]", energy, 1e-6, 1e-10)
        yield at_most("depth in the ground [m]", simulation.measure().penetration, 1e-4, 1e-9)
        drift = float(np.linalg.norm(center(simulation)[[0, 2]]))
        yield at_most("creep over the ground [m]", drift, 1e-3, 1e-5)
