"""The reference solution of a scene: its motion in float64 as long as it is one motion, and how well it is known.

Three runs: one with steps that are short against the fastest vibration, one of the same from a start that is a hair
off, and one with half the step. The first two tell the horizon, behind which a small disturbance has become another
motion; the first and the third how far the steps still matter.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, inf

import numpy as np
from numpy.typing import NDArray

from ..mesh.from_scene import particles_of
from ..scene.model import COLLIDERS, FRAME_SECONDS, Scene
from .dynamics import Motion
from .springs import Floats, SpringModel, spring_model

NUDGE = 1e-9  # of the longer side: a start this far off …
GROWN = 100.0  # … that has grown so much says nothing any more about one motion rather than another
PHASE = 0.9  # [radians] largest turn of the fastest vibration in a step of the coarser run; 2 is the stability limit


@dataclass(frozen=True, eq=False)
class Solution:
    """Places of the particles after each frame up to the horizon [m], (frames, N, 3): with steps h/2, and with h."""

    places: Floats
    coarser: Floats
    side: float  # [m] the longer one of the sheet

    @property
    def horizon(self) -> int:
        """[frames]"""
        return len(self.places)

    @property
    def uncertainty(self) -> tuple[float, float]:
        """How far the two are apart, root mean square and largest, as shares of the side.

        At least the error of `places` wherever halving the step halves the error or does better.
        """
        apart = distances(self.places, self.coarser) / self.side
        return float(np.sqrt((apart**2).mean())), float(apart.max())


def distances(a: Floats, b: Floats) -> Floats:
    """Of every particle in every frame [m], (frames, N)."""
    found: Floats = np.linalg.norm(a - b, axis=2)
    return found


def without_solution(scene: Scene) -> str:
    """Why a scene has no reference solution; nothing where it has one."""
    if scene.self_collision is not None:
        return "self-collision is not in the reference"
    return ""


def fastest(model: SpringModel) -> float:
    """Upper bound of the angular frequencies of springs and bending links [rad/s] (Gershgorin)."""
    each = np.concatenate([model.stiffness, np.abs(model.bending)])
    around = np.bincount(model.ends.reshape(-1), np.tile(each, 2), len(model.mass))
    return float(np.sqrt((2 * around / model.mass)[model.free].max(initial=0.0)))


def steps_of(scene: Scene) -> int:
    """Steps a frame of the coarser run."""
    repelling = sum(one.stiffness for name in COLLIDERS for one in getattr(scene, name) if one.response == "repulsion")
    omega = np.hypot(fastest(spring_model(scene)), np.sqrt(repelling / scene.cloth.area_density))
    return max(8, ceil(FRAME_SECONDS * float(omega) / PHASE))


def solve(scene: Scene, frames: int) -> Floats:
    """`Solution.places` and `Solution.coarser`, (2, horizon, N, 3), for at most so many frames.

    Raises ValueError for a scene that has none.
    """
    if reason := without_solution(scene):
        raise ValueError(f"{scene.name}: {reason}")
    steps, side = steps_of(scene), particles_of(scene).side
    coarser = until_horizon(scene, steps, frames, side)
    finer = Motion(scene, 2 * steps)
    return np.stack([[finer.frame() for _ in coarser], coarser])


def until_horizon(scene: Scene, steps: int, frames: int, side: float) -> NDArray[np.float64]:
    """Places after each frame before a start that is `NUDGE` off has grown apart by `GROWN` times as much, and before
    a spring comes to the strain that is its limit or at which it tears, which are not in the reference; one frame at
    least.
    """
    most = min([one.strain for one in (scene.limit, scene.tear) if one is not None], default=inf)
    run = Motion(scene, steps)
    off = Motion(scene, steps, NUDGE * side * np.random.default_rng(1).standard_normal(run.x.shape))
    places: list[Floats] = []
    for _ in range(frames):
        here, there = run.frame(), off.frame()
        grown = float(np.sqrt(((here - there) ** 2).sum(axis=1).mean())) / (NUDGE * side)
        if places and (grown > GROWN or run.strain > most):
            break
        places.append(here)
    return np.array(places)
