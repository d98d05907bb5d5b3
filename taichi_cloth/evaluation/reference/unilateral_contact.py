"""Contact with colliders as unilateral constraints on velocities (Moreau 1988), in float64.

A particle that would end a step within a collider's margin gets the impulse that stops its approach to the surface, and
Coulomb friction: a tangential impulse of at most the coefficient times the normal one, which at most stops the sliding.
A collider with reflection reverses the approach, times its restitution. A collider with repulsion applies a penalty
force instead, whose impulse in a step has the same friction. As steps shrink, all responses converge to the motion that
their keys describe.

Poses and velocities of colliders and attachments follow their keys at every moment; they are not interpolated linearly
between frames. So do the vertices of a mesh with a clip, which are interpolated between those of the clip only.

A triangle of the cloth that would end a step within the margin of a sphere or capsule with `collide_with = "triangles"`
gets an impulse at its point closest to the collider's axis. It moves the corners as those of a rigid triangle: by their
barycentric weights at the point and their masses. Triangles share corners, so they are solved one after the other,
repeatedly, until none approaches the collider.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ...geometry.spring_model import Bools, Floats, Ints
from ...scene.collider_schema import Capsule, Collider, Ground, Mesh, Motion, Sphere
from ...scene.schema import Scene
from .collider_distance import DIFFERENCE_STEP, ClipDistance, Distance, barycentric, distance_of

# -- poses -------------------------------------------------------------------------------------------------------------


class Pose(NamedTuple):
    """The pose of a collider or attachment at one time, with its velocity."""

    center: Floats  # [m] (3,)
    axes: Floats  # (3, 3) its own axes as columns
    velocity: Floats  # [m/s] (3,) of the center
    spin: Floats  # [1/s] (3,) angular velocity
    seconds: float = 0.0

    def local(self, x: Floats) -> Floats:
        """Return positions (3, M) along its own axes, relative to its center."""
        return self.axes.T @ (x - self.center[:, None])

    def surface_velocity(self, x: Floats) -> Floats:
        """Return the velocity of its material at positions (3, M) [m/s], (3, M)."""
        return self.velocity[:, None] + cross(self.spin, x - self.center[:, None])


def cross(spin: Floats, arm: Floats) -> Floats:
    """Return spin × arm for arrays of shape (3,) and (3, M)."""
    return np.stack(
        [
            spin[1] * arm[2] - spin[2] * arm[1],
            spin[2] * arm[0] - spin[0] * arm[2],
            spin[0] * arm[1] - spin[1] * arm[0],
        ]
    )


def rotation_from_euler(degrees: Floats) -> Floats:
    """Return the rotation about x, then y, then z by angles [degrees], (3, 3)."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    rotation: Floats = about_z @ about_y @ about_x
    return rotation


def rotation_from_vector(vector: Floats) -> Floats:
    """Return the rotation about a vector by its length [rad], (3, 3)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation: Floats = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)
    return rotation


def is_still(body: Motion | Ground) -> bool:
    """Return whether a collider or attachment never moves."""
    if isinstance(body, Mesh) and body.clip:
        return False
    return isinstance(body, Ground) or not (
        any(body.oscillation) or any(body.rocking) or any(body.spin) or body.keyframes
    )


def center_and_axes(body: Motion | Ground, seconds: float) -> tuple[Floats, Floats]:
    """Return the center [m] and the axes of a collider or attachment at a time."""
    if isinstance(body, Ground):
        return np.array([0.0, body.height, 0.0]), np.eye(3)
    wave = np.sin(2 * np.pi * seconds / np.array(body.period) + np.radians(body.phase))
    center = np.array(body.center) + np.array(body.oscillation) * wave
    axes = rotation_from_euler(np.array(body.rocking) * wave) if any(body.rocking) else np.eye(3)
    if isinstance(body, Collider) and any(body.rotation):
        axes = axes @ rotation_from_euler(np.array(body.rotation))
    if body.keyframes:
        times, poses = (
            [row[0] for row in body.keyframes],
            np.array([(*row[1:], 0.0, 0.0, 0.0)[:6] for row in body.keyframes]),
        )
        offset = np.array([np.interp(seconds, times, column) for column in poses.T])
        center, axes = center + offset[:3], rotation_from_euler(offset[3:]) @ axes
    return center, rotation_from_vector(np.radians(body.spin) * seconds) @ axes


@lru_cache(maxsize=64)  # called several times in a step for every collider
def pose(body: Motion | Ground, seconds: float) -> Pose:
    """Return the read-only pose of a collider or attachment at a time; velocities are central differences."""
    center, axes = center_and_axes(body, seconds)
    if is_still(body):
        return Pose(center, axes, np.zeros(3), np.zeros(3))
    (before, axes_before), (after, axes_after) = (
        center_and_axes(body, seconds + t) for t in (-DIFFERENCE_STEP, DIFFERENCE_STEP)
    )
    turn = axes_after @ axes_before.T
    spin = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    return Pose(center, axes, (after - before) / (2 * DIFFERENCE_STEP), spin / (2 * DIFFERENCE_STEP), seconds)


# -- contact -----------------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class ColliderState:
    """A collider of a scene, with what carries over from step to step."""

    collider: Collider | Ground
    distance: Distance
    still: Pose | None
    """The pose of a collider that never moves, otherwise None."""
    clearance: float = 0.0
    """Lower bound of the distance of all particles to the margin [m], used for a collider that never moves."""

    def pose(self, seconds: float) -> Pose:
        """Return the pose at a time."""
        return self.still or pose(self.collider, seconds)

    def is_out_of_reach(self, speed: float, h: float) -> bool:
        """Return whether no particle up to this speed [m/s] can touch the collider at the end of a step of h [s]."""
        self.clearance -= speed * h
        return self.still is not None and self.clearance > 0

    def gap(self, x: Floats, at: Pose) -> tuple[Floats, Floats]:
        """Return the distance to the margin [m] (M,) and the normal (3, M) in world space, at positions (3, M).

        The distance is negative within the margin.
        """
        if isinstance(self.distance, ClipDistance):
            self.distance.move_to(at.seconds)
        distance, normal = self.distance(at.local(x))
        gap = distance - self.collider.margin
        self.clearance = float(gap.min(initial=np.inf))
        return gap, at.axes @ normal

    def surface_velocity(self, x: Floats, at: Pose) -> Floats:
        """Return the velocity of its material at positions [m/s], both (3, M), the last that `gap` was called for."""
        velocity = at.surface_velocity(x)
        return velocity + at.axes @ self.distance.velocity() if isinstance(self.distance, ClipDistance) else velocity


def obstacles_of(scene: Scene) -> list[ColliderState]:
    """Return the colliders of a scene that collide with particles."""
    colliders: list[Collider | Ground] = [
        *(collider for collider in (*scene.spheres, *scene.capsules) if collider.collide_with == "particles"),
        *(*scene.boxes, *scene.planes, *scene.meshes),
    ]
    if scene.ground is not None:
        colliders.append(scene.ground)
    return [ColliderState(one, distance_of(one), pose(one, 0.0) if is_still(one) else None) for one in colliders]


def impulse(normal: Floats, relative: Floats, pushed: Floats, friction: float) -> Floats:
    """Return the velocity change [m/s] (3, M) of a normal impulse `pushed` [m/s] (M,) with Coulomb friction.

    `relative` is the velocity relative to the surface before the impulse.
    """
    after = relative + pushed * normal
    sliding = after - (after * normal).sum(axis=0) * normal
    speed = np.sqrt((sliding * sliding).sum(axis=0))
    reduction = np.minimum(friction * pushed, speed) / np.where(speed > 0, speed, 1.0)
    change: Floats = pushed * normal - reduction * sliding
    return change


def repulsion_velocity_change(
    obstacle: ColliderState, x: Floats, v: Floats, at: Pose, h: float, area_density: float
) -> Floats:
    """Return the velocity change in one step by a collider with repulsion [m/s], (3, M)."""
    gap, normal = obstacle.gap(x, at)
    pushed = h * obstacle.collider.stiffness / area_density * np.maximum(-gap, 0.0)
    return impulse(normal, v - obstacle.surface_velocity(x, at), pushed, obstacle.collider.friction)


def contact_velocity_change(obstacle: ColliderState, x: Floats, v: Floats, at: Pose) -> tuple[Bools, Floats]:
    """Return which positions at the end of a step are within the margin, (M,), and their velocity changes, (3, M)."""
    gap, normal = obstacle.gap(x, at)
    touched = gap < 0
    change = np.zeros_like(v)
    if touched.any():
        n = normal[:, touched]
        relative = (v - obstacle.surface_velocity(x, at))[:, touched]
        approach = np.maximum(-(relative * n).sum(axis=0), 0.0)
        bounce = obstacle.collider.restitution if obstacle.collider.response == "reflection" else 0.0
        change[:, touched] = impulse(n, relative, (1 + bounce) * approach, obstacle.collider.friction)
    return touched, change


def project_to_margin(obstacle: ColliderState, x: Floats, at: Pose) -> Floats:
    """Return positions (3, M) projected along the normal to the margin of a collider."""
    gap, normal = obstacle.gap(x, at)
    return x - gap * normal


# -- contact with triangles of the cloth -------------------------------------------------------------------------------

MAX_ROUNDS = 200  # over all triangles in contact
TOLERANCE = 1e-12  # speed of approach [m/s], and depth [m], that count as zero


class TriangleContact:
    """A collider with `collide_with = "triangles"`, and the triangles it keeps outside its margin."""

    def __init__(self, collider: Sphere | Capsule, corners: Ints, inverse_mass: Floats) -> None:
        """`corners` are the particles of the triangles, (3, T).

        `inverse_mass` [1/kg], (N,), is 0 for particles that are not free.
        """
        self._collider = collider
        self._half = collider.length / 2 if isinstance(collider, Capsule) else 0.0
        self._reach = collider.radius + collider.margin
        self._friction = collider.friction
        self._corners, self._inverse_mass = corners, inverse_mass

    def stop_approach(self, x: Floats, v: Floats, seconds: float) -> Ints:
        """Change velocities `v` (3, N) in place so that no triangle within the margin approaches the collider.

        `x` (3, N) are the positions at the end of the step, at time `seconds`. Return the triangles within the margin.
        """
        at = pose(self._collider, seconds)
        within, weights, normals = self._triangles_within(x, at)
        for _ in range(MAX_ROUNDS):
            max_approach = 0.0
            for triangle, weight, normal in zip(within, weights.T, normals.T, strict=True):
                corners = self._corners[:, triangle]
                relative = v[:, corners] @ weight - at.surface_velocity(x[:, corners] @ weight[:, None])[:, 0]
                approach = max(-float(relative @ normal), 0.0)
                if approach > 0:
                    change = impulse(normal[:, None], relative[:, None], np.array([approach]), self._friction)
                    v[:, corners] += change * self._shares(corners, weight)
                    max_approach = max(max_approach, approach)
            if max_approach <= TOLERANCE:
                break
        return within

    def project(self, x: Floats, seconds: float, triangles: Ints) -> None:
        """Move these triangles out to the margin, in place."""
        at = pose(self._collider, seconds)
        for _ in range(MAX_ROUNDS):
            max_depth = 0.0
            for corners in self._corners[:, triangles].T:
                weight, offset = closest_to_axis(at.local(x[:, corners])[:, :, None].transpose(1, 0, 2), self._half)
                distance = float(np.sqrt((offset**2).sum()))
                depth = self._reach - distance
                if depth > TOLERANCE:
                    x[:, corners] += depth * (at.axes @ offset / distance) * self._shares(corners, weight[:, 0])
                    max_depth = max(max_depth, depth)
            if max_depth <= TOLERANCE:
                break

    def _triangles_within(self, x: Floats, at: Pose) -> tuple[Ints, Floats, Floats]:
        """Return the triangles within the margin, the weights of their closest points, and normals, both (3, M)."""
        local = at.local(x)
        offset = local.copy()
        offset[1] -= np.clip(offset[1], -self._half, self._half)
        distance = np.sqrt((offset * offset).sum(axis=0))[self._corners[0]]
        edges = [local[:, self._corners[k]] - local[:, self._corners[0]] for k in (1, 2)]
        longest = np.sqrt(np.maximum(*[(edge * edge).sum(axis=0) for edge in edges]))
        near = np.flatnonzero(distance < self._reach + longest)
        weights, offset = closest_to_axis(local[:, self._corners[:, near]].transpose(1, 0, 2), self._half)
        distance = np.sqrt((offset * offset).sum(axis=0))
        within = distance < self._reach
        return near[within], weights[:, within], at.axes @ (offset[:, within] / distance[within])

    def _shares(self, corners: Ints, weight: Floats) -> Floats:
        """Return the change of each corner when the point with these weights changes by 1, (3,)."""
        each = weight * self._inverse_mass[corners]
        total = float(weight @ each)
        shares: Floats = each / total if total > 0 else np.zeros(3)
        return shares


def closest_to_axis(corners: Floats, half: float) -> tuple[Floats, Floats]:
    """Return the points of triangles (3 corners, 3, M) closest to the segment from −half to half on the y axis.

    They are given by the weights of their corners, (3, M), and by the vector from the segment to the point, (3, M). The
    segment must not pass through a triangle. The closest point is then closest to an end of the segment, or on an edge
    (Ericson 2005, 5.1.9 and 5.1.10).
    """
    candidates = [_weights_closest_to(np.array([[0.0], [end], [0.0]]), corners) for end in (-half, half)]
    for k in range(3):
        p, edge = corners[k], corners[(k + 1) % 3] - corners[k]
        t = _edge_parameter(p, edge, half)
        weights = np.zeros((3, t.size))
        weights[k], weights[(k + 1) % 3] = 1 - t, t
        candidates.append(weights)
    offsets = []
    for weights in candidates:
        offset = np.einsum("km,kim->im", weights, corners)
        offset[1] -= np.clip(offset[1], -half, half)
        offsets.append(offset)
    best = np.argmin([(offset * offset).sum(axis=0) for offset in offsets], axis=0)
    index = np.arange(best.size)
    return np.array(candidates)[best, :, index].T, np.array(offsets)[best, :, index].T


def _edge_parameter(p: Floats, edge: Floats, half: float) -> Floats:
    """Return where the edges from p are closest to the segment, (M,): 0 at p, 1 at the other end.

    It is the point closest to the infinite line, or to an end of the segment if the line's point is beyond that end.
    """
    across = edge[0] ** 2 + edge[2] ** 2
    t = np.clip(-(p[0] * edge[0] + p[2] * edge[2]) / np.where(across > 0, across, 1.0), 0.0, 1.0)
    end = np.clip(p[1] + t * edge[1], -half, half)
    to_end = (end - p[1]) * edge[1] - p[0] * edge[0] - p[2] * edge[2]
    parameter: Floats = np.clip(to_end / (edge * edge).sum(axis=0), 0.0, 1.0)
    return parameter


def _weights_closest_to(point: Floats, corners: Floats) -> Floats:
    """Return the weights of the corners, (3, M), at the points of the triangles closest to a point (3, 1)."""
    projected = barycentric(point, corners)
    smallest, found = np.full(projected.shape[1], np.inf), projected
    for k in range(3):
        p, side = corners[k], corners[(k + 1) % 3] - corners[k]
        t = np.clip(((point - p) * side).sum(axis=0) / (side * side).sum(axis=0), 0.0, 1.0)
        squared = ((point - p - t * side) ** 2).sum(axis=0)
        weights = np.zeros_like(projected)
        weights[k], weights[(k + 1) % 3] = 1 - t, t
        found = np.where((projected < 0).any(axis=0) & (squared < smallest), weights, found)
        smallest = np.minimum(smallest, squared)
    return found
