"""How fast a cloth's springs can vibrate, which bounds the step of an explicit method. NumPy only."""

from __future__ import annotations

from math import ceil, sqrt

import numpy as np
from numpy.typing import NDArray

from .topology import Topology

MARGIN = 1.03  # Lanczos stops from below: after 40 steps it was within 1 % on every grid tried
STEPS = 40


def highest_frequency(topology: Topology, stiffness: NDArray[np.float64]) -> float:
    """Bound of the angular frequencies [rad/s] of the cloth, whatever its shape; `stiffness` [N/m] of springs, (E,).

    A spring of stiffness k along the unit vector n resists by at most k·n·nᵀ, and n·nᵀ ≤ 1: so every vibration of
    every shape is slower than the fastest one of the network in which springs resist alike in all directions,
    ω² = max eigenvalue of M⁻¹·L with the weighted graph Laplacian L. Bonds are alike in all directions as they are.
    The Lanczos iteration finds it; pins stand still.
    """
    a, b = np.concatenate([topology.ends, topology.bonds.ends]).T
    constant = np.concatenate([stiffness, topology.bonds.constant])
    root = 1 / np.sqrt(topology.mass)
    root[topology.pinned] = 0
    count = topology.particle_count

    def apply(v: NDArray[np.float64]) -> NDArray[np.float64]:
        u = root * v
        pull = constant * (u[a] - u[b])
        total = np.bincount(a, pull, count) - np.bincount(b, pull, count)
        applied: NDArray[np.float64] = root * total
        return applied

    start = np.random.default_rng(0).standard_normal(count) * (root > 0)
    if not len(constant) or not start.any():
        return 0.0
    v: NDArray[np.float64] = start / np.linalg.norm(start)
    before = np.zeros(count)
    diagonal: list[float] = []
    beside = [0.0]
    for _ in range(min(STEPS, count)):
        w = apply(v) - beside[-1] * before
        diagonal.append(float(w @ v))
        w -= diagonal[-1] * v
        beside.append(float(np.linalg.norm(w)))
        if beside[-1] < 1e-9 * diagonal[0]:
            break
        before, v = v, w / beside[-1]
    off = beside[1 : len(diagonal)]
    largest = float(np.linalg.eigvalsh(np.diag(diagonal) + np.diag(off, 1) + np.diag(off, -1))[-1])
    return MARGIN * sqrt(max(largest, 0.0))


def stable_substeps(frequency: float, damping_time: float, seconds: float) -> int:
    """Substeps of `seconds` with which symplectic Verlet with dashpots of `damping_time` [s] is stable.

    For one mode of frequency ω, z² − (2 − hτω² − h²ω²)z + (1 − hτω²) = 0 has both roots inside the unit circle
    while h²ω² + 2hτω² < 4.
    """
    if frequency == 0:
        return 1
    longest = 4 / frequency**2 / (damping_time + sqrt(damping_time**2 + 4 / frequency**2))
    return ceil(seconds / longest)


def longest_dashpot(frequency: float) -> float:
    """The longest damping time [s] that an explicit method bears for half as many substeps again.

    With h·ω = 4/3, two thirds of what is stable without dashpots, h²ω² + 2hτω² = 4 gives τ = 5/(6·ω).
    """
    return 5 / (6 * frequency) if frequency else 1.0


# How far from 0 the numbers h·λ may lie (Hairer and Wanner 1996, *Solving Ordinary Differential Equations II*, section
# IV.2): where z is imaginary, |1 + z + z²/2 + z³/6 + z⁴/24| ≤ 1 up to 2√2, and with a negative real part up to 2.615
# at least. That is less than the 2.785 of the real axis: the region is dented at a damping ratio of 0.54.
RUNGE_KUTTA_UNDAMPED = sqrt(8)
RUNGE_KUTTA_DAMPED = 2.615


def stable_runge_kutta_substeps(frequency: float, damping_time: float, seconds: float) -> int:
    """Substeps of `seconds` with which the classical Runge–Kutta method is stable, with dashpots as above.

    A mode of frequency ω goes like exp(λt) with λ² + τω²λ + ω² = 0: |λ| is ω until it is overdamped.
    """
    half = damping_time * frequency**2 / 2
    fastest = half + sqrt(half**2 - frequency**2) if half > frequency else frequency
    ceiling = RUNGE_KUTTA_DAMPED if damping_time > 0 else RUNGE_KUTTA_UNDAMPED
    return max(1, ceil(seconds * fastest / ceiling))
