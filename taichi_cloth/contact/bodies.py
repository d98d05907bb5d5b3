"""Colliders in NumPy: where each is and how it is turned at a time, how far points are from it, and the table of all of
them that a frame's kernel reads.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from math import pi, radians, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..kernels import controls as c
from ..mesh.grid import rotation_matrix
from ..mesh.solid import distances_of
from ..scene.model import (
    REPULSION,
    RESPONSES,
    Box,
    Capsule,
    Collider,
    Contact,
    Ground,
    Mesh,
    Motion,
    Plane,
    Round,
    Scene,
    Sphere,
    Vec3,
)

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

KINDS: tuple[tuple[type, ...], ...] = ((Sphere,), (Capsule,), (Box,), (Plane, Ground), (Mesh,))  # as `COLLIDERS`
LEAP = 340.0  # [m/s] a path that asks for more is no way: the body is at once elsewhere

MARCH_STEPS, MARCH_NEAR = 200, 1e-5  # of a ray that goes on by its distance to the nearest surface [m]


class Body(NamedTuple):
    """A collider at one time."""

    collider: Collider | Ground
    center: Floats  # (3,) [m]
    axes: Floats  # (3, 3): its own axes x, y and z as columns
    size: Floats  # (3,) [m]: see `size_of`


def size_of(collider: Collider | Ground) -> Floats:
    """Radius; half the length between a capsule's round ends, and its radius; half sides of a box [m]. A plane and a
    mesh have none; in the table a mesh has its number there.
    """
    match collider:
        case Sphere():
            size = (collider.radius, 0.0, 0.0)
        case Capsule():
            size = (collider.length / 2, collider.radius, 0.0)
        case Box():
            size = (collider.size[0] / 2, collider.size[1] / 2, collider.size[2] / 2)
        case _:
            size = (0.0, 0.0, 0.0)
    return np.array(size)


def turned(vector: Floats) -> Floats:
    """3×3 matrix that turns about a vector by its length [radians] (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / angle if angle else vector
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix: Floats = np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * across @ across
    return matrix


def turn_between(before: Floats, after: Floats) -> Floats:
    """The vector about which, by its length [radians], `after` is turned against `before`: the shortest way."""
    if np.array_equal(before, after):
        return np.zeros(3)
    turn = after @ before.T
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine, cosine = float(np.linalg.norm(axis)) / 2, (float(np.trace(turn)) - 1) / 2
    vector: Floats = axis / (2 * sine) * np.arctan2(sine, cosine) if sine > 1e-12 else np.zeros(3)
    return vector


@lru_cache(maxsize=256)  # it is asked for in every frame
def _at_rest(body: Motion | Ground) -> tuple[Floats, Floats]:
    """The pose before any motion, for reading only."""
    if isinstance(body, Ground):
        center, axes = np.array([0.0, body.height, 0.0]), np.eye(3)
    else:
        center = np.array(body.center)
        axes = rotation_matrix(body.rotation) if isinstance(body, Collider) else np.eye(3)
    for values in (center, axes):
        values.setflags(write=False)
    return center, axes


def pose(body: Motion | Ground, seconds: float) -> tuple[Floats, Floats]:
    """Middle [m] and axes at a time, as the keys of `Motion` and `Collider` say."""
    center, axes = _at_rest(body)
    if isinstance(body, Ground):
        return center, axes
    if any(body.sway) or any(body.rock):
        phases = zip(body.period, body.phase, strict=True)
        wave = np.array([sin(2 * pi * seconds / period + radians(phase)) for period, phase in phases])
        center = center + np.array(body.sway) * wave
        if any(body.rock):
            axes = rotation_matrix(tuple(np.array(body.rock) * wave)) @ axes
    if body.path:
        rows = np.array([(*row, 0.0, 0.0, 0.0)[:7] for row in body.path])
        offset = np.array([np.interp(seconds, rows[:, 0], rows[:, k]) for k in range(1, 7)])
        center = center + offset[:3]
        axes = rotation_matrix(tuple(offset[3:])) @ axes
    if any(body.spin):
        axes = turned(np.radians(body.spin) * seconds) @ axes
    return center, axes


def colliders_of(scene: Scene) -> list[Collider | Ground]:
    """All of them, kind by kind."""
    ground = [] if scene.ground is None else [scene.ground]
    return [*scene.spheres, *scene.capsules, *scene.boxes, *scene.planes, *ground, *scene.meshes]


def counts_of(colliders: Sequence[Collider | Ground], response: int) -> tuple[int, ...]:
    """How many of each kind, in the order of `COLLIDERS`, answer to contact like this; the ground is a plane."""
    kinds = [next(k for k, kind in enumerate(KINDS) if isinstance(one, kind)) for one in colliders]
    answer = RESPONSES[response]
    return tuple(
        sum(kind == k and one.response == answer for one, kind in zip(colliders, kinds, strict=True))
        for k in range(len(KINDS))
    )


def repulsion_frequency(colliders: Sequence[Collider | Ground], area_density: float) -> float:
    """Frequency [rad/s] of cloth of so many kg/m² that all bodies repel at once."""
    total = sum(one.stiffness for one in colliders if one.response == RESPONSES[REPULSION])
    return float(np.sqrt(total / area_density))


def bodies_at(colliders: Sequence[Collider | Ground], seconds: float) -> list[Body]:
    """Every one at a time."""
    return [Body(collider, *pose(collider, seconds), size_of(collider)) for collider in colliders]


def body_table(
    bodies: Sequence[Motion | Ground],
    start: float,
    end: float,
    smaller: tuple[ArrayLike, ArrayLike] = (0.0, 0.0),
    origin: Vec3 = (0.0, 0.0, 0.0),
) -> Floats32:
    """A row for each: where it is at both ends of a frame, how it turns in it, its size, margin [m] and friction.

    The order is that of `contact/table.py`, and grips behind it. `smaller`: by how much [m] each of the first ones,
    which are colliders, is so as the frame begins and as it ends (`release.py`). Middles are
    told from the `origin` [m].
    """
    table = np.zeros((len(bodies), c.BODY_COLUMNS), np.float32)
    for row, body in zip(table, bodies, strict=True):
        row[:] = _still_row(body, origin)
        if not is_still(body):
            (center, axes), (next_center, next_axes) = pose(body, start), pose(body, end)
            if leaps(body, start, end):
                center, axes = next_center, next_axes
            row[c.BODY_FROM : c.BODY_FROM + 3] = np.subtract(center, origin)
            row[c.BODY_TO : c.BODY_TO + 3] = np.subtract(next_center, origin)
            row[c.BODY_TURN : c.BODY_TURN + 3] = turn_between(axes, next_axes)
            row[c.BODY_AXES : c.BODY_AXES + 9] = axes.ravel()
    before, after = map(np.asarray, smaller)
    table[: before.size, c.BODY_MARGIN] -= before
    table[: before.size, c.BODY_GROWTH] = before - after
    meshes = [isinstance(body, Mesh) for body in bodies]
    table[meshes, c.BODY_SIZE] = np.arange(sum(meshes))
    groups = [RESPONSES.index(body.response) if isinstance(body, Contact) else len(RESPONSES) for body in bodies]
    return table[np.argsort(groups, kind="stable")]


def leaps(body: Motion | Ground, start: float, end: float) -> bool:
    """Whether it is at once elsewhere within a frame, as its path says."""
    return not isinstance(body, Ground) and any(first < end and start < last for first, last in _leaps(body))


@lru_cache(maxsize=256)  # it is asked for in every frame
def _leaps(body: Motion) -> tuple[tuple[float, float], ...]:
    """From when to when [s]."""
    legs = pairwise(np.array([row[:4] for row in body.path]))
    return tuple((a[0], b[0]) for a, b in legs if np.linalg.norm(b[1:] - a[1:]) > LEAP * (b[0] - a[0]))


@lru_cache(maxsize=256)  # it is asked for in every frame
def _still_row(body: Motion | Ground, origin: Vec3) -> Floats32:
    """The row of a body that stays where it is at first."""
    row = np.zeros(c.BODY_COLUMNS, np.float32)
    center, axes = pose(body, 0.0)
    row[c.BODY_FROM : c.BODY_FROM + 3] = row[c.BODY_TO : c.BODY_TO + 3] = np.subtract(center, origin)
    row[c.BODY_AXES : c.BODY_AXES + 9] = axes.ravel()
    if isinstance(body, Collider | Ground):
        row[c.BODY_SIZE : c.BODY_SIZE + 3] = size_of(body)
        row[c.BODY_MARGIN], row[c.BODY_FRICTION] = body.margin, body.friction
        row[c.BODY_SWEPT] = body.swept
        row[c.BODY_RESTITUTION], row[c.BODY_STIFFNESS] = body.restitution, body.stiffness
        row[c.BODY_TRIANGLES] = meets_triangles(body)
    return row


def distance(body: Body, points: Floats) -> Floats:
    """How far points of shape (N, 3) are from its surface as drawn [m], (N,); negative inside."""
    local = (points - body.center) @ body.axes
    match body.collider:
        case Sphere():
            away: Floats = np.linalg.norm(local, axis=1) - body.size[0]
        case Capsule():
            local[:, 1] -= np.clip(local[:, 1], -body.size[0], body.size[0])
            away = np.linalg.norm(local, axis=1) - body.size[1]
        case Box():
            beyond = np.abs(local) - body.size
            away = np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)
        case Mesh():
            away = distances_of(body.collider).at(local)
        case _:
            away = local[:, 1]
    return away


def penetration(bodies: Sequence[Body], points: Floats) -> float:
    """How deep the deepest of points (N, 3) lies under a surface [m], 0 where none does. Margins are not counted."""
    return max([0.0, *(float(-distance(body, points).min()) for body in bodies)])


def first_hit(bodies: Sequence[Body], origin: Floats, direction: Floats) -> float:
    """Distance along a ray to the first body on it [m], infinity for none. One that it starts in does not count."""
    outside = [body for body in bodies if distance(body, origin[None])[0] > 0]
    gone = 0.0
    for _ in range(MARCH_STEPS):
        place = (origin + gone * direction)[None]
        near = min((float(distance(body, place)[0]) for body in outside), default=np.inf)
        if near < MARCH_NEAR:
            return gone
        gone += near
        if not gone < 1e6:
            break
    return np.inf


def meets_triangles(collider: Collider | Ground) -> bool:
    """Whether it keeps out whole triangles and not only particles."""
    return isinstance(collider, Round) and collider.against == "triangles"


def is_still(body: Motion | Ground) -> bool:
    """Whether it never moves."""
    return isinstance(body, Ground) or not (any(body.sway) or any(body.rock) or any(body.spin) or body.path)
