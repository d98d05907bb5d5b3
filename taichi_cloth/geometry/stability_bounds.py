"""Bounds of the vibration frequencies of a cloth, and the substeps that explicit methods need. NumPy only."""

from __future__ import annotations

from collections.abc import Iterable
from math import ceil, sqrt

import numpy as np
from numpy.typing import NDArray

from ..scene.collider_schema import REPULSION, RESPONSES, ContactProperties
from .membrane_model import ElasticTriangles as Triangles
from .topology import Topology

MARGIN = 1.03  # Lanczos converges from below: after 40 steps it was within 1 % on every grid tested
STEPS = 40  # of the Lanczos iteration


def max_frequency(topology: Topology, stiffness: NDArray[np.float64], membrane: Triangles | None = None) -> float:
    """Return an upper bound of the angular frequencies of the cloth [rad/s], for any shape of the cloth.

    `stiffness` of every spring [N/m], (E,). A spring of stiffness k along the unit vector n resists by at most k·n·nᵀ,
    and n·nᵀ ≤ 1. So no vibration of any shape is faster than the fastest one of the network in which springs resist
    equally in all directions: ω² = max eigenvalue of M⁻¹·L, with the weighted graph Laplacian L. Bending links resist
    equally in all directions anyway, and `scalar_elements` bound a membrane or a weave in the same way. The eigenvalue
    is found by Lanczos iteration. Pinned particles do not move.
    """
    a, b = np.concatenate([topology.ends, topology.bending_links.ends]).T
    constant = np.concatenate([stiffness, topology.bending_links.stiffness])
    root_inverse_mass = 1 / np.sqrt(topology.mass)
    root_inverse_mass[topology.pinned] = 0
    count = topology.particle_count
    nothing = np.zeros((0, 3), np.int32), np.zeros((0, 3, 3))
    corners, elements = nothing if membrane is None else membrane.scalar_elements()

    def apply(v: NDArray[np.float64]) -> NDArray[np.float64]:
        u = root_inverse_mass * v
        pull = constant * (u[a] - u[b])
        total = np.bincount(a, pull, count) - np.bincount(b, pull, count)
        if membrane is not None:
            on_corners = np.einsum("mij,mj->mi", elements, u[corners])
            total += np.bincount(corners.reshape(-1), on_corners.reshape(-1), count)
        applied: NDArray[np.float64] = root_inverse_mass * total
        return applied

    start = np.random.default_rng(0).standard_normal(count) * (root_inverse_mass > 0)
    if not (len(constant) or len(elements)) or not start.any():
        return 0.0
    v: NDArray[np.float64] = start / np.linalg.norm(start)
    previous = np.zeros(count)
    diagonal: list[float] = []
    coupling = [0.0]
    for _ in range(min(STEPS, count)):
        w = apply(v) - coupling[-1] * previous
        diagonal.append(float(w @ v))
        w -= diagonal[-1] * v
        coupling.append(float(np.linalg.norm(w)))
        if coupling[-1] < 1e-9 * diagonal[0]:
            break
        previous, v = v, w / coupling[-1]
    off_diagonal = coupling[1 : len(diagonal)]
    largest = float(np.linalg.eigvalsh(np.diag(diagonal) + np.diag(off_diagonal, 1) + np.diag(off_diagonal, -1))[-1])
    return MARGIN * sqrt(max(largest, 0.0))


# Largest h·ω of symplectic Verlet for springs that change their direction. From there to 2, the limit of springs that
# do not, a vibration has about three steps a period and gains energy from every force that is not linear (third-order
# resonance: Schlick, Mandziuk, Skeel and Srinivas 1998, *Nonlinear resonance artifacts in molecular dynamics
# simulations*). A cloth released from a strain of several hundred percent would move faster and faster.
MAX_PHASE = sqrt(3)


def min_symplectic_substeps(frequency: float, damping_time: float, seconds: float) -> int:
    """Return the fewest substeps in `seconds` with which damped symplectic Verlet is stable.

    `damping_time` of the spring dampers [s]. For one mode of frequency ω, z² − (2 − hτω² − h²ω²)z + (1 − hτω²) = 0 has
    both roots inside the unit circle while h²ω² + 2hτω² < 4. Modes of large amplitude also require `MAX_PHASE`.
    """
    if frequency == 0:
        return 1
    longest = 4 / frequency**2 / (damping_time + sqrt(damping_time**2 + 4 / frequency**2))
    return ceil(seconds / min(longest, MAX_PHASE / frequency))


def max_damping_time(frequency: float) -> float:
    """Return the longest damping time [s] with which symplectic Verlet is stable at h·ω = 4/3.

    h²ω² + 2hτω² = 4 then gives τ = 5/(6·ω).
    """
    return 5 / (6 * frequency) if frequency else 1.0


# Largest stable |h·λ| of the classical Runge–Kutta method (Hairer and Wanner 1996, *Solving Ordinary Differential
# Equations II*, section IV.2). |1 + z + z²/2 + z³/6 + z⁴/24| ≤ 1 holds up to 2√2 for imaginary z, and up to at least
# 2.615 for z with a negative real part. That is less than the 2.785 of the real axis: the stability region has a dent
# at a damping ratio of 0.54.
RUNGE_KUTTA_UNDAMPED = sqrt(8)
RUNGE_KUTTA_DAMPED = 2.615


def min_rk4_substeps(frequency: float, damping_time: float, seconds: float) -> int:
    """Return the fewest substeps in `seconds` with which the classical Runge–Kutta method is stable.

    `damping_time` of the spring dampers [s]. A mode of frequency ω follows exp(λt) with λ² + τω²λ + ω² = 0. |λ| is ω
    until the mode is overdamped.
    """
    half = damping_time * frequency**2 / 2
    fastest = half + sqrt(half**2 - frequency**2) if half > frequency else frequency
    ceiling = RUNGE_KUTTA_DAMPED if damping_time > 0 else RUNGE_KUTTA_UNDAMPED
    return max(1, ceil(seconds * fastest / ceiling))


# Largest h·ω of a vibration by explicit forces. Symplectic Euler alone is stable up to 2; with constraints and
# forces a compressed strip is at rest at 0.7, shakes forever with one iteration of `xpbd` at 0.9, and with all other
# settings at 1.2.
MAX_FORCE_PHASE = 0.7


def min_force_substeps(frequency: float, seconds: float) -> int:
    """Return the fewest substeps in `seconds` at which implicit springs with explicit forces are stable.

    `frequency`: bound of the vibrations by explicit forces, bending and repulsion [rad/s].
    """
    return max(1, ceil(seconds * frequency / MAX_FORCE_PHASE))


MAX_SUBSTEPS = 200_000  # substeps of a frame: seconds for a thousand particles


def too_many_substeps(solver: str, substeps: int) -> str:
    """Return why a solver that needs that many substeps in a frame is refused, or ""."""
    if substeps <= MAX_SUBSTEPS:
        return ""
    return (
        f"{solver} needs {substeps:,} substeps a frame, more than {MAX_SUBSTEPS:,}: springs or bending are too stiff"
        " for the particles' masses, or cells are too narrow"
    )


def repulsion_frequency(colliders: Iterable[ContactProperties], area_density: float) -> float:
    """Return the angular frequency [rad/s] of cloth of that density [kg/m²] which all colliders repel at once."""
    total = sum(collider.stiffness for collider in colliders if collider.response == RESPONSES[REPULSION])
    return sqrt(total / area_density)


GRAVITY = 9.81  # [m/s²]
# `lines` linearizes lines at their positions, without the effect of tension across them: a substep may not be longer
# than a wave of speed √(g·L) takes through this number of cells. (Swinging curtain: 1.33 is stable, 1.67 is not.)
MAX_COURANT = 1.4


def min_line_substeps(topology: Topology, side: float, seconds: float) -> int:
    """Return the fewest substeps in `seconds` in which no transverse wave passes more than `MAX_COURANT` cells.

    `side`: longest extent of the cloth at its start [m].
    """
    cell_sides = topology.rest[topology.family("structural")]
    if not len(cell_sides):
        return 1
    return ceil(seconds * sqrt(GRAVITY * side) / float(cell_sides.min()) / MAX_COURANT)
