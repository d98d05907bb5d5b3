"""The static rest state of a hanging cloth in float64: a minimum of elastic and gravitational energy.

Newton's method with the regularization of an implicit time step: each round solves (M/h² + K)·u = F, and h grows while
the energy falls. With a small h that is overdamped motion, which brings a sheet from any start down to where it hangs;
with a large one it is Newton's method, which then converges in few rounds (pseudo-transient continuation: Kelley and
Keyes 1998).
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from ..scene.model import Camera, Look, Scene
from .blocks import BlockSystem
from .springs import Floats, SpringModel, spring_model

SHAKE = 1e-3  # of a spring's length: the sheet does not start exactly flat, which can be an unstable equilibrium
RESIDUAL = 0.02  # of a particle's weight: largest force left on any particle; strains are then right to about 2 %
FIRST_STEP, STEPS = 0.02, (1e-6, 1e6)  # [s] h at first, and its bounds
MOST_ROUNDS = 1000
# [weights of the whole cloth per side] largest stiffness that is solved. Strains of stiffer cloth are in inverse
# proportion, to one part in a thousand; solved as it is, it would take minutes to come down from a level start.
STIFFEST = 5000.0


def rest_strain(scene: Scene) -> float:
    """Largest structural strain of a scene's cloth where it hangs at rest from its pins under its gravity.

    From the constants of `[fabric]` alone, without colliders, wind, limits or ties, whatever its solver. 0 for a cloth
    without pins, which has no such state. Raises ArithmeticError where none is found.
    """
    return _rest_strain(replace(scene, title="", name="", camera=Camera(), look=Look()))


@lru_cache(maxsize=256)
def _rest_strain(scene: Scene) -> float:
    model = spring_model(scene)
    if model.free.all() or not model.free.any() or not model.gravity:
        return 0.0
    threads = model.topology.family("structural")
    most = STIFFEST * float(model.mass.sum()) * abs(model.gravity) / model.topology.side
    excess = max(1.0, float(model.stiffness.max(initial=0.0)) / most)
    softer = replace(model, stiffness=model.stiffness / excess)
    return float(softer.strains(rest_positions(softer))[threads].max(initial=0.0)) / excess


def rest_positions(model: SpringModel) -> Floats:
    """Where the particles are at rest [m], (3, N). Raises ArithmeticError where no minimum is found."""
    system = BlockSystem(model)
    shake = SHAKE * float(np.median(model.rest)) * np.random.default_rng(0).standard_normal(model.start.shape)
    x = model.start + shake * model.free
    weight = float(model.mass.mean()) * abs(model.gravity)
    energy, h = model.energy(x), FIRST_STEP
    for _ in range(MOST_ROUNDS):
        force = (model.elastic(x) + model.weight()) * model.free
        if float(np.sqrt((force**2).sum(axis=0)).max()) < RESIDUAL * weight:
            return x
        moved = x + _step(model, system, x, force, h)
        after = model.energy(moved)
        if after < energy:
            x, energy, h = moved, after, min(2 * h, STEPS[1])
        elif h > STEPS[0]:
            h /= 4
        else:
            break
    raise ArithmeticError("the cloth comes to no rest")


def _step(model: SpringModel, system: BlockSystem, x: Floats, force: Floats, h: float) -> Floats:
    """One round, with the exact stiffness where that is positive definite."""
    inertia = model.mass / h**2
    try:
        return system.solve(inertia, model.stiffness_blocks(x), force)
    except np.linalg.LinAlgError:
        return system.solve(inertia, model.stiffness_blocks(x, definite=True), force)
