"""Contact with colliders as unilateral constraints on velocities (Moreau 1988), in float64.

A particle that would end a step within a collider's margin gets the impulse that stops its approach to the surface, and
Coulomb friction: a tangential impulse of at most the coefficient times the normal one, which at most stops the sliding.
A collider with reflection reverses the approach, times its restitution. A collider with repulsion applies a penalty
force instead, whose impulse in a step has the same friction. As steps shrink, all responses converge to the motion that
their keys describe.

Signed distances to colliders, and their gradients, are along the collider's own axes and negative inside. Poses and
velocities of colliders and attachments follow their keys at every moment; they are not interpolated linearly between
frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ...geometry.signed_distance import collider_surface
from ...geometry.spring_model import Bools, Floats, Ints
from ...scene.collider_schema import Box, Capsule, Collider, Ground, Mesh, Motion, Sphere
from ...scene.schema import Scene

# -- signed distance to meshes -----------------------------------------------------------------------------------------

CHUNK = 200  # particles whose candidate lists are built at once


class MeshDistance:
    """Signed distance to a closed triangle mesh; exact up to `reach` from the surface, a lower bound beyond.

    It is meant for particles that move little from call to call: each keeps a list of the triangles that can be closest
    to it, which is valid until the particle has moved by half the skin. The sign is that of the angle-weighted normal
    at the closest vertex, edge or face (Bærentzen and Aanæs 2005).
    """

    def __init__(self, mesh: Mesh) -> None:
        surface = collider_surface(mesh)
        self._corners = surface.vertices[surface.faces].transpose(1, 2, 0)  # (3 corners, 3, T)
        self._half = surface.half[:, None]
        self._normals = _feature_normals(surface.vertices, surface.faces.astype(np.int64))
        self.reach = mesh.margin + 0.02 * float(surface.half.max())
        self._skin = self.reach - mesh.margin
        self._list_positions: Floats | None = None  # positions of the particles when the lists were built
        self._particle = self._face = np.zeros(0, np.int64)  # candidate pairs, sorted by particle
        self._first_pair = np.zeros(0, np.int64)
        self._bound = np.zeros(0)  # lower bound of the distance at that time, for particles without a list

    def __call__(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the distance [m] (M,) and the normal (3, M) at positions (3, M) along the mesh's own axes."""
        stale = True
        if self._list_positions is not None and self._list_positions.shape == x.shape:
            moved = np.sqrt(((x - self._list_positions) ** 2).sum(axis=0))
            stale = bool((moved > self._skin / 2).any())
        if stale:
            self._build_lists(x)
            moved = np.zeros(x.shape[1])
        distance = self._bound - moved
        normal = np.zeros_like(x)
        normal[1] = 1.0
        if len(self._particle):
            closest, feature = _nearest(x[:, self._particle], self._corners[:, :, self._face])
            offset = x[:, self._particle] - closest
            squared = (offset * offset).sum(axis=0)
            smallest = np.minimum.reduceat(squared, self._first_pair)
            count = np.diff(np.append(self._first_pair, len(squared)))
            pair = np.flatnonzero(squared == np.repeat(smallest, count))
            _, first = np.unique(self._particle[pair], return_index=True)
            pair = pair[first]
            particle, length = self._particle[pair], np.sqrt(squared[pair])
            outward = self._normals[self._face[pair], feature[pair]].T
            sign = np.where((offset[:, pair] * outward).sum(axis=0) < 0, -1.0, 1.0)
            distance[particle] = sign * length
            apart = length > 1e-12
            normal[:, particle] = np.where(apart, sign * offset[:, pair] / np.where(apart, length, 1.0), outward)
        return distance, normal

    def _build_lists(self, x: Floats) -> None:
        """List, for each particle near the surface, all faces that may be closest to it."""
        self._list_positions = x.copy()
        outside = np.maximum(np.abs(x) - self._half, 0.0)
        self._bound = np.sqrt((outside * outside).sum(axis=0))
        center = self._corners.mean(axis=0)
        radius = np.sqrt(((self._corners - center) ** 2).sum(axis=1)).max(axis=0)
        particles: list[Ints] = []
        faces: list[Ints] = []
        near = np.flatnonzero(self._bound < self.reach + self._skin)
        for begin in range(0, len(near), CHUNK):
            chunk = near[begin : begin + CHUNK]
            distance = np.sqrt(((x[:, chunk, None] - center[:, None, :]) ** 2).sum(axis=0))
            lower = (distance - radius).min(axis=1)  # bounds of the distance to the surface
            upper = (distance + radius).min(axis=1)
            self._bound[chunk] = np.maximum(self._bound[chunk], lower)
            possible = distance - radius <= (upper + self._skin)[:, None]
            possible[lower > self.reach + self._skin] = False
            row, face = np.nonzero(possible)
            particles.append(chunk[row])
            faces.append(face)
        self._particle = np.concatenate([np.zeros(0, np.int64), *particles])
        self._face = np.concatenate([np.zeros(0, np.int64), *faces])
        self._first_pair = np.flatnonzero(np.diff(self._particle, prepend=-1))


def _nearest(x: Floats, corners: Floats) -> tuple[Floats, Ints]:
    """Return the closest point of each triangle (3, 3, M) to its position (3, M), and its feature, (M,).

    Features: 0, 1, 2 are the corners; 3, 4, 5 the edges from those to the next corner; 6 the face.
    """
    edges = np.stack([corners[(k + 1) % 3] - corners[k] for k in range(3)])
    normal = _cross(edges[0], -edges[2])
    best = np.full(x.shape[1], np.inf)
    closest, feature = np.zeros_like(x), np.zeros(x.shape[1], np.int64)
    inside = np.ones(x.shape[1], bool)
    for k in range(3):
        offset = x - corners[k]
        t = np.clip((offset * edges[k]).sum(axis=0) / (edges[k] ** 2).sum(axis=0), 0.0, 1.0)
        point = corners[k] + t * edges[k]
        squared = ((x - point) ** 2).sum(axis=0)
        closer = squared < best
        best = np.where(closer, squared, best)
        closest = np.where(closer, point, closest)
        feature = np.where(closer, np.where(t == 0, k, np.where(t == 1, (k + 1) % 3, 3 + k)), feature)
        inside &= (_cross(edges[k], offset) * normal).sum(axis=0) >= 0
    height = ((x - corners[0]) * normal).sum(axis=0) / (normal**2).sum(axis=0)
    return np.where(inside, x - height * normal, closest), np.where(inside, 6, feature)


def _cross(a: Floats, b: Floats) -> Floats:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _feature_normals(points: Floats, faces: Ints) -> Floats:
    """Return the outward normals of the seven features of every face, (T, 7, 3), not normalized."""
    corners = points[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    point_normal = np.zeros_like(points)
    edge_normal: dict[tuple[int, int], Floats] = {}
    for k in range(3):
        u, v = (corners[:, (k + step) % 3] - corners[:, k] for step in (1, 2))
        cosine = (u * v).sum(axis=1) / np.linalg.norm(u, axis=1) / np.linalg.norm(v, axis=1)
        np.add.at(point_normal, faces[:, k], np.arccos(np.clip(cosine, -1, 1))[:, None] * normal)
        for pair, n in zip(np.sort(faces[:, [k, (k + 1) % 3]], axis=1).tolist(), normal, strict=True):
            edge_normal[tuple(pair)] = edge_normal.get(tuple(pair), 0.0) + n
    normals = np.zeros((len(faces), 7, 3))
    for k in range(3):
        normals[:, k] = point_normal[faces[:, k]]
        normals[:, 3 + k] = [edge_normal[tuple(p)] for p in np.sort(faces[:, [k, (k + 1) % 3]], axis=1).tolist()]
    normals[:, 6] = normal
    return normals


# -- signed distance to other shapes -----------------------------------------------------------------------------------

# Maps positions (3, M) [m] to distances [m] (M,) and outward unit normals (3, M).
Distance = Callable[[Floats], tuple[Floats, Floats]]


def distance_of(collider: Collider | Ground) -> Distance:
    """Return the distance function of a sphere, a capsule, a box, a plane or the ground."""
    match collider:
        case Sphere():
            radius = collider.radius
            return lambda x: _from_core(x, radius)
        case Capsule():
            half, capsule_radius = collider.length / 2, collider.radius
            return lambda x: _from_core(x - _on_axis(x, half), capsule_radius)
        case Box():
            half_size = np.array(collider.size)[:, None] / 2
            return lambda x: _box(x, half_size)
        case _:
            return _half_space


def _from_core(offset: Floats, radius: float) -> tuple[Floats, Floats]:
    """Return distance and normal of a shape with this radius, from offsets (3, M) to its core."""
    length = np.sqrt((offset * offset).sum(axis=0))
    normal = offset / np.where(length > 0, length, 1.0)
    normal[1, length == 0] = 1.0
    return length - radius, normal


def _on_axis(x: Floats, half: float) -> Floats:
    """Return the closest points (3, M) on a capsule's axis."""
    core = np.zeros_like(x)
    core[1] = np.clip(x[1], -half, half)
    return core


def _box(x: Floats, half_size: Floats) -> tuple[Floats, Floats]:
    beyond = np.abs(x) - half_size
    outside = np.maximum(beyond, 0.0)
    distance, normal = _from_core(outside, 0.0)
    inside = distance == 0
    face = beyond[:, inside].argmax(axis=0)
    normal[:, inside] = np.eye(3)[:, face]
    distance[inside] = beyond[:, inside].max(axis=0)
    return distance, normal * np.where(x < 0, -1.0, 1.0)


def _half_space(x: Floats) -> tuple[Floats, Floats]:
    normal = np.zeros_like(x)
    normal[1] = 1.0
    return x[1].copy(), normal


# -- poses -------------------------------------------------------------------------------------------------------------

DIFFERENCE_STEP = 1e-5  # [s] half of the interval over which velocities are differenced


class Pose(NamedTuple):
    """The pose of a collider or attachment at one time, with its velocity."""

    center: Floats  # [m] (3,)
    axes: Floats  # (3, 3) its own axes as columns
    velocity: Floats  # [m/s] (3,) of the center
    spin: Floats  # [1/s] (3,) angular velocity

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
    return Pose(center, axes, (after - before) / (2 * DIFFERENCE_STEP), spin / (2 * DIFFERENCE_STEP))


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
        distance, normal = self.distance(at.local(x))
        gap = distance - self.collider.margin
        self.clearance = float(gap.min(initial=np.inf))
        return gap, at.axes @ normal


def obstacles_of(scene: Scene) -> list[ColliderState]:
    """Return the colliders of a scene that collide with particles."""
    colliders: list[Collider | Ground] = [
        *(collider for collider in (*scene.spheres, *scene.capsules) if collider.collide_with == "particles"),
        *(*scene.boxes, *scene.planes, *scene.meshes),
    ]
    if scene.ground is not None:
        colliders.append(scene.ground)
    obstacles: list[ColliderState] = []
    for collider in colliders:
        distance = MeshDistance(collider) if isinstance(collider, Mesh) else distance_of(collider)
        obstacles.append(ColliderState(collider, distance, pose(collider, 0.0) if is_still(collider) else None))
    return obstacles


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
    return impulse(normal, v - at.surface_velocity(x), pushed, obstacle.collider.friction)


def contact_velocity_change(obstacle: ColliderState, x: Floats, v: Floats, at: Pose) -> tuple[Bools, Floats]:
    """Return which positions at the end of a step are within the margin, (M,), and their velocity changes, (3, M)."""
    gap, normal = obstacle.gap(x, at)
    touched = gap < 0
    change = np.zeros_like(v)
    if touched.any():
        n, contact = normal[:, touched], x[:, touched]
        relative = v[:, touched] - at.surface_velocity(contact)
        approach = np.maximum(-(relative * n).sum(axis=0), 0.0)
        bounce = obstacle.collider.restitution if obstacle.collider.response == "reflection" else 0.0
        change[:, touched] = impulse(n, relative, (1 + bounce) * approach, obstacle.collider.friction)
    return touched, change


def project_to_margin(obstacle: ColliderState, x: Floats, at: Pose) -> Floats:
    """Return positions (3, M) projected along the normal to the margin of a collider."""
    gap, normal = obstacle.gap(x, at)
    return x - gap * normal
