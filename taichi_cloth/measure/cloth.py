"""Numbers read off a cloth's positions and velocities. NumPy in float64; nothing here changes a cloth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..mesh.topology import Topology

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Measures:
    """The state of a cloth in seven numbers."""

    max_strain: float  # largest length/rest − 1 over the structural springs (all springs if it has none)
    mean_strain: float  # mean of |length/rest − 1| over the same springs
    kinetic_energy: float  # [J]
    potential_energy: float  # [J] of gravity, zero at y = 0
    penetration: float  # [m] how deep the deepest particle lies under a collider's surface, 0 for none
    finite: bool  # False once a position is NaN or infinite
    crossings: int | None  # edges that go through a triangle; None in a scene without self-collision


def spring_strains(topology: Topology, positions: Floats) -> Floats:
    """length/rest − 1 of every spring, shape (E,)."""
    a, b = (positions[topology.ends[:, k]] for k in (0, 1))
    strains: Floats = np.linalg.norm(b - a, axis=1) / topology.rest - 1
    return strains


def energies(topology: Topology, positions: Floats, velocities: Floats, gravity: float) -> tuple[float, float]:
    """Kinetic energy and potential energy of gravity [J]; pinned particles have no kinetic energy."""
    moving = np.where(topology.pinned, 0, topology.mass)
    kinetic = 0.5 * float(np.sum(moving * np.sum(velocities**2, axis=1)))
    return kinetic, float(np.sum(topology.mass * gravity * positions[:, 1]))
