"""What iterations that end too early do to a chain, and what rounding does to an order: laws that rows fall short by.

A substep of Gauss-Seidel (Müller et al. 2007; Macklin et al. 2016, Algorithm 1) seeks multipliers λ with A·λ = −C,
A = J·M⁻¹·Jᵀ + α/h². It begins at λ = 0, and i sweeps with the iteration matrix G reach (1 − Gⁱ)·λ∞. Where the motion is
slow against a substep, what they reach must be what carries the cloth, λ = h²·T with the tension T. So what they leave
of the length errors is A·Gⁱ·(1 − Gⁱ)⁻¹·λ beside the elastic α·T. Where T changes little from link to link, red-black
sweeps have G = ρ and this is the elastic strain times the share of `measure/convergence.py`. It is as if springs were
softer: k/(1 + share). Where lengths are fixed and not forces, it is the tension that is smaller by 1 + share.

Without compliance (`verlet`, α = 0) k·share becomes m·i/h² from above, the constant of springs that stretch by
½·N²·g·h²/i in a hanging sheet. The steps are those of backward Euler: y = x + h·v + h²·g and v = (x' − x)/h.
"""

from __future__ import annotations

from functools import cache
from math import ceil, log2, sqrt

import numpy as np

from ..accuracy.truth import Curtain
from ..measure.convergence import unfinished_share
from ..scene.model import FRAME_SECONDS
from . import newton
from .exact import GRAVITY, Floats, drum_sag
from .newton import Chain

SOFTER = (
    "iterations end too early, as if springs were softer: m·i/h² (½·N²·g·h²/i), or k over 1 + their unfinished share"
)
SOFTER_EULER = f"{SOFTER}; in backward Euler steps of h"
ROUNDED = "rounding to float32, added up at random over n steps: ½u·√(n/3)·(|x| + |v|·t/√3), u = 2⁻²³"
CONVERGED = 0.5  # [radians] of the fastest vibration in a step of velocity Verlet, which is stable up to 2
SINGLE = 2.0**-23  # from 1 to the next number of float32


def softened(solver: str, constant: float, mass: float, h: float, iterations: int) -> float:
    """Constant [N/m] that springs of particles of such a mass [kg] seem to have; `verlet` does not use `constant`."""
    if solver == "verlet":
        return mass * iterations / h**2
    return constant / (1 + unfinished_share(constant, mass, h, iterations))


def unfinished_sag(cells: int, tension: float, constant: float, mass: float, h: float, iterations: int) -> float:
    """How much lower than it should a taut square hangs, as a share: its lengths are fixed, so its tension is less."""
    less = tension / (1 + unfinished_share(constant, mass, h, iterations))
    return drum_sag(cells, less, mass) / drum_sag(cells, tension, mass) - 1


def chain(links: int, squared: float, last: float = 1.0) -> Chain:
    """A metre of equal masses and springs of k/m = `squared` [1/s²]; the last mass is `last` of the others."""
    mass = np.ones(links + 1)
    mass[-1] = last
    ends = np.stack([np.arange(links), np.arange(1, links + 1)], axis=-1)
    return Chain(mass, ends, np.full(links, 1 / links), np.full(links, squared))


def euler_run(links: int, squared: float, start: Floats, h: float, frames: int) -> Floats:
    """Places after each frame, (frames, links + 1, 2), in backward Euler steps solved to the end."""
    body, x, v = chain(links, squared), start, np.zeros_like(start)
    seen = []
    for _ in range(frames):
        for _ in range(round(FRAME_SECONDS / h)):
            x, v, _ = newton.euler(body, x, v, h)
        seen.append(x)
    return np.array(seen)


@cache
def euler_curtain(cells: int, squared: float, h: float, frames: int = 60) -> Floats:
    """The swinging curtain in such steps."""
    return euler_run(cells, squared, Curtain(cells).start, h, frames)


@cache
def bottom_of_area(cells: int, squared: float, frames: int = 60) -> Floats:
    """Where its bottom row is, (2,), with masses by area: the last one is half. By velocity Verlet with short steps.

    That steps of h are of first order is left out: it is nearly the same with twice as many cells.
    """
    body, start = chain(cells, squared, last=0.5), Curtain(cells).start
    steps = ceil(2 * sqrt(squared) * FRAME_SECONDS / CONVERGED)
    h, x, v = FRAME_SECONDS / steps, start, np.zeros_like(start)

    def acceleration(x: Floats) -> Floats:
        unit, long = body.gaps(x)
        pull = (body.constant * (long - body.rest))[:, None] * unit
        found = np.zeros_like(x)
        found[1:] -= pull
        found[1:-1] += pull[1:]
        found /= body.mass[:, None]
        found[1:, 1] -= GRAVITY
        return found

    a = acceleration(x)
    for _ in range(frames * steps):
        v = v + h / 2 * a
        x = x + h * v
        a = acceleration(x)
        v = v + h / 2 * a
    bottom: Floats = x[-1]
    return bottom


def rounding(steps: int, seconds: float, place: float, speed: float) -> float:
    """How far [m] float32 leads off in so many steps, from places [m] and speeds [m/s] up to these.

    A sum of size |x| is rounded by up to ½u|x|, evenly spread: ½u|x|/√3 root mean square, and n of them that are
    independent add up to √n as much (Henrici 1962, ch. 5). At a constant speed they are not independent, and add up to
    more. What a speed loses on the way goes on for the time that is left, on average t/√3 root mean square.
    """
    return SINGLE / 2 * sqrt(steps / 3) * (place + speed * seconds / sqrt(3))


def order_lost(order: float, coarse: float, floor: float) -> float:
    """By how much a halving of the step seems to be of lower order, where rounding adds `floor` to the smaller error.

    log₂(e/(e/2^p + δ)) is p − log₂(1 + 2^p·δ/e).
    """
    return log2(1 + 2**order * floor / coarse)
