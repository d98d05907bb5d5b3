"""Implicit steps of a chain, solved to the end: what the iterations of a solver are held against. NumPy, float64."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .exact import GRAVITY, Floats

GAMMA = 1 - sqrt(0.5)  # share of a substep that each of the two stages of `lines` solves (Alexander 1977)
MOST_ROUNDS = 50  # of Newton's method; it takes three to eight
CLOSE = 1e-12  # [m] what the last round may still move


@dataclass(frozen=True, eq=False)
class Chain:
    """N particles in a plane, (forward, up), joined by E springs; the first one is held."""

    mass: Floats  # [kg] (N,)
    ends: NDArray[np.int64]  # (E, 2)
    rest: Floats  # [m] (E,)
    constant: Floats  # [N/m] (E,)
    gravity: float = GRAVITY  # [m/s²]

    def gaps(self, x: Floats) -> tuple[Floats, Floats]:
        """(unit vectors (E, 2), lengths [m] (E,)) of the springs."""
        gap = x[self.ends[:, 1]] - x[self.ends[:, 0]]
        long = np.hypot(*gap.T)
        return gap / long[:, None], long

    def strains(self, x: Floats) -> Floats:
        """Length over rest − 1 of every spring, (E,)."""
        strains: Floats = self.gaps(x)[1] / self.rest - 1
        return strains


class Step(NamedTuple):
    """Where an implicit step ends."""

    x: Floats  # [m] (N, 2)
    v: Floats  # [m/s] (N, 2)
    tension: Floats  # [N] (E,)


def without_springs(chain: Chain, x: Floats, v: Floats, h: float) -> Floats:
    """y = x + h·v + h²·g [m], (N, 2); the held one stays."""
    y = x + h * v
    y[:, 1] -= h * h * chain.gravity
    y[0] = x[0]
    return y


def residual(chain: Chain, y: Floats, x: Floats, h: float) -> Floats:
    """|∇(½|x − y|²_M/h² + E(x))| [N] of every free particle, (N − 1,): zero where a step of length h is solved."""
    unit, long = chain.gaps(x)
    pull = (chain.constant * (long - chain.rest))[:, None] * unit
    gradient = chain.mass[:, None] * (x - y) / h**2
    np.add.at(gradient, chain.ends[:, 1], pull)
    np.add.at(gradient, chain.ends[:, 0], -pull)
    found: Floats = np.hypot(*gradient[1:].T)
    return found


def euler(chain: Chain, x: Floats, v: Floats, h: float) -> Step:
    """A backward Euler step, by Newton's method on places and multipliers, which stiff springs do not slow down:

        M·(x − y) = Jᵀλ,    C + λ/(k·h²) = 0

    with the length errors C and their gradients J (Macklin 2016, eq. 8–9). Raises ArithmeticError where it does not
    converge: a chain that is pushed together may fold in many ways.
    """
    y = without_springs(chain, x, v, h)
    found, multiplier = y.copy(), np.zeros(len(chain.rest))
    give = 1 / (chain.constant * h * h)
    for _ in range(MOST_ROUNDS):
        unit, long = chain.gaps(found)
        jacobian = _jacobian(chain, unit)
        pulls = jacobian.T @ multiplier
        wrong = np.concatenate(
            [(chain.mass[:, None] * (found - y)).ravel() - pulls, long - chain.rest + give * multiplier]
        )
        matrix = np.block([[_turning(chain, unit, -multiplier / long), -jacobian.T], [jacobian, np.diag(give)]])
        change = np.linalg.solve(matrix[2:, 2:], -wrong[2:])  # the held one has no equation
        found[1:] += change[: 2 * len(x) - 2].reshape(-1, 2)
        multiplier += change[2 * len(x) - 2 :]
        if np.abs(change[: 2 * len(x) - 2]).max() < CLOSE:
            return Step(found, (found - x) / h, -multiplier / h**2)
    raise ArithmeticError("Newton's method does not converge")


def _jacobian(chain: Chain, unit: Floats) -> Floats:
    """∂C/∂x, (E, 2N)."""
    each = np.arange(len(unit))
    jacobian = np.zeros((len(unit), len(chain.mass), 2))
    jacobian[each, chain.ends[:, 0]] = -unit
    jacobian[each, chain.ends[:, 1]] = unit
    return jacobian.reshape(len(unit), -1)


def _turning(chain: Chain, unit: Floats, weight: Floats) -> Floats:
    """M + Σ weight·(1 − n·nᵀ) over the springs, (2N, 2N): their pull turns with them."""
    count = len(chain.mass)
    across = weight[:, None, None] * (np.eye(2) - unit[:, :, None] * unit[:, None, :])
    blocks = np.zeros((count, count, 2, 2))
    blocks[np.arange(count), np.arange(count)] = chain.mass[:, None, None] * np.eye(2)
    a, b = chain.ends.T
    for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
        np.add.at(blocks, (i, j), sign * across)
    return blocks.transpose(0, 2, 1, 3).reshape(2 * count, 2 * count)


def two_stages(chain: Chain, x: Floats, v: Floats, h: float) -> Step:
    """A substep as that of `lines` (`solvers/lines.py`): two backward Euler steps of γh and a jump between them."""
    first = euler(chain, x, v, GAMMA * h)
    return euler(chain, x + (1 - GAMMA) * h * first.v, v + (first.v - v) * (1 - GAMMA) / GAMMA, GAMMA * h)
