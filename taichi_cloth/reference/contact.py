"""Contact with colliders as unilateral constraints on velocities (Moreau 1988), in float64.

A particle that would end a step within a collider's margin gets the impulse that stops its approach to the surface,
and Coulomb friction: a tangential impulse of at most the coefficient times the normal one, which at most stops the
sliding. A collider that reflects sends it back with its restitution; one that repels pushes with a force instead, whose
impulse in a step has the same friction. As steps shrink all of them tend to the motion that their keys describe.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene.model import Collider, Ground, Mesh, Scene
from .poses import Pose, is_still, pose
from .shapes import Distance, distance_of
from .springs import Bools, Floats
from .surfaces import MeshDistance


@dataclass(eq=False)
class Obstacle:
    """A collider of a scene, between steps."""

    collider: Collider | Ground
    distance: Distance
    still: Pose | None  # of one that never moves
    clearance: float = 0.0  # [m] no particle is nearer to the margin of a still one than this

    def pose(self, seconds: float) -> Pose:
        return self.still or pose(self.collider, seconds)

    def far(self, speed: float, h: float) -> bool:
        """Whether no particle that moves at most at `speed` can touch it at the end of a step."""
        self.clearance -= speed * h
        return self.still is not None and self.clearance > 0

    def gap(self, x: Floats, at: Pose) -> tuple[Floats, Floats]:
        """Distance to the margin [m] (M,), negative within, and the normal (3, M) in space, of places (3, M)."""
        distance, normal = self.distance(at.local(x))
        gap = distance - self.collider.margin
        self.clearance = float(gap.min(initial=np.inf))
        return gap, at.axes @ normal


def obstacles_of(scene: Scene) -> list[Obstacle]:
    """The colliders of a scene that keep particles out."""
    colliders: list[Collider | Ground] = [
        *(one for one in (*scene.spheres, *scene.capsules) if one.against == "particles"),
        *(*scene.boxes, *scene.planes, *scene.meshes),
    ]
    if scene.ground is not None:
        colliders.append(scene.ground)
    found: list[Obstacle] = []
    for one in colliders:
        distance = MeshDistance(one) if isinstance(one, Mesh) else distance_of(one)
        found.append(Obstacle(one, distance, pose(one, 0.0) if is_still(one) else None))
    return found


def impulse(normal: Floats, relative: Floats, pushed: Floats, friction: float) -> Floats:
    """Change of velocity (3, M) for a normal one of `pushed` [m/s] (M,), with Coulomb friction.

    `relative` is the velocity against the surface without it.
    """
    after = relative + pushed * normal
    sliding = after - (after * normal).sum(axis=0) * normal
    speed = np.sqrt((sliding * sliding).sum(axis=0))
    stopped = np.minimum(friction * pushed, speed) / np.where(speed > 0, speed, 1.0)
    change: Floats = pushed * normal - stopped * sliding
    return change


def push_of(obstacle: Obstacle, x: Floats, v: Floats, at: Pose, h: float, area_density: float) -> Floats:
    """Change of velocity in a step by a collider that repels, (3, M)."""
    gap, normal = obstacle.gap(x, at)
    pushed = h * obstacle.collider.stiffness / area_density * np.maximum(-gap, 0.0)
    return impulse(normal, v - at.surface_velocity(x), pushed, obstacle.collider.friction)


def touch(obstacle: Obstacle, x: Floats, v: Floats, at: Pose) -> tuple[Bools, Floats]:
    """Which places at the end of a step are within the margin, (M,), and the change of their velocities, (3, M)."""
    gap, normal = obstacle.gap(x, at)
    touched = gap < 0
    change = np.zeros_like(v)
    if touched.any():
        n, here = normal[:, touched], x[:, touched]
        relative = v[:, touched] - at.surface_velocity(here)
        approach = np.maximum(-(relative * n).sum(axis=0), 0.0)
        bounce = obstacle.collider.restitution if obstacle.collider.response == "reflection" else 0.0
        change[:, touched] = impulse(n, relative, (1 + bounce) * approach, obstacle.collider.friction)
    return touched, change


def onto_margin(obstacle: Obstacle, x: Floats, at: Pose) -> Floats:
    """Places (3, M) moved along the normal to the margin of a collider."""
    gap, normal = obstacle.gap(x, at)
    return x - gap * normal
