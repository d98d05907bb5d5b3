"""Colliders on the host, in NumPy: their pose at a time, distances to them, and the table that kernels read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from math import pi, radians, sin
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry.grid import rotation_matrix
from ..kernels import step_params as c
from ..scene.collider_schema import (
    RESPONSES,
    Collider,
    ContactProperties,
    Ground,
    Mesh,
    Motion,
    RoundCollider,
)
from ..scene.keys import Keyframes, Vec3
from ..scene.schema import Scene
from .shapes import SHAPES, Shape

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Body = TypeVar("Body", bound=Motion)

# [m] A particle this near to the margin still touches the collider. A continuous test stops this far within the margin,
# so that a particle at rest starts outside.
SURFACE_TOLERANCE = 1e-4
TELEPORT_SPEED = 340.0  # [m/s] keyframes with a higher speed teleport the collider: nothing between is swept
MAX_TRACE_STEPS, TRACE_TOLERANCE = 200, 1e-5  # of a ray; the tolerance in m


class PosedCollider(NamedTuple):
    """A collider at one time."""

    collider: Collider | Ground
    """The object of the scene, with the values of its runtime parameters."""
    center: NDArray[np.float64]
    """(3,) [m]."""
    axes: NDArray[np.float64]
    """Its own axes x, y and z as columns, (3, 3)."""
    size: NDArray[np.float64]
    """Half sides of a box, radius of a sphere, half length and radius of a capsule [m]; else 0, (3,)."""


def shape_of(collider: Collider | Ground) -> Shape:
    """Return the shape of a collider; the ground is a plane."""
    return next(shape for shape in SHAPES if isinstance(collider, shape.classes))


def rotation_from_vector(vector: Floats) -> Floats:
    """Return the 3×3 rotation about a vector by its length [rad] (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / angle if angle else vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix: Floats = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return matrix


def rotation_vector_between(before: Floats, after: Floats) -> Floats:
    """Return the rotation vector [rad] of the shortest rotation from axes `before` to axes `after`."""
    if before is after or (before == after).all():
        return np.zeros(3)
    relative = after @ before.T
    axis = np.array([relative[2, 1] - relative[1, 2], relative[0, 2] - relative[2, 0], relative[1, 0] - relative[0, 1]])
    sine, cosine = float(np.linalg.norm(axis)) / 2, (float(np.trace(relative)) - 1) / 2
    vector: Floats = axis / (2 * sine) * np.arctan2(sine, cosine) if sine > 1e-12 else np.zeros(3)
    return vector


@lru_cache(maxsize=256)  # called in every frame
def _initial_pose(collider: Motion | Ground) -> tuple[Floats, Floats]:
    """Return the pose before any motion, read-only."""
    if isinstance(collider, Ground):
        center, axes = np.array([0.0, collider.height, 0.0]), np.eye(3)
    else:
        center = np.array(collider.center)
        axes = rotation_matrix(collider.rotation) if isinstance(collider, Collider) else np.eye(3)
    for values in (center, axes):
        values.setflags(write=False)
    return center, axes


def keyframe_offset(collider: Motion, seconds: float) -> Floats:
    """Return what keyframes add at a time, (6,): an offset [m], then a rotation about x, y and z [degrees]."""
    if not collider.keyframes:
        return np.zeros(6)
    rows = _keyframe_rows(collider.keyframes)
    if len(rows) == 1:
        return rows[0, 1:]
    return np.array([np.interp(seconds, rows[:, 0], rows[:, k]) for k in range(1, 7)])


@lru_cache(maxsize=256)  # called in every frame
def _keyframe_rows(keyframes: Keyframes) -> Floats:
    """Return keyframes as an array (K, 7), read-only: time [s], offset [m], rotation [degrees]."""
    rows = np.array([(*row, 0.0, 0.0, 0.0)[:7] for row in keyframes])
    rows.setflags(write=False)
    return rows


def pose(collider: Motion | Ground, seconds: float) -> tuple[Floats, Floats]:
    """Return center [m] and axes at a time, as `Motion` and `Collider` define them."""
    center, axes = _initial_pose(collider)
    if isinstance(collider, Ground):
        return center, axes
    if any(collider.oscillation) or any(collider.rocking):
        phases = zip(collider.period, collider.phase, strict=True)
        wave = [sin(2 * pi * seconds / period + radians(phase)) for period, phase in phases]
        center = center + [by * share for by, share in zip(collider.oscillation, wave, strict=True)]
        if any(collider.rocking):
            x, y, z = (by * share for by, share in zip(collider.rocking, wave, strict=True))
            axes = rotation_matrix((x, y, z)) @ axes
    if collider.keyframes:
        offset = keyframe_offset(collider, seconds)
        center = center + offset[:3]
        if offset[3:].any():
            axes = rotation_matrix(tuple(offset[3:])) @ axes
    if any(collider.spin):
        axes = rotation_from_vector(np.radians(collider.spin) * seconds) @ axes
    return center, axes


def in_first_pose(body: Motion, positions: Floats) -> Floats:
    """Return positions relative to the pose of a body at the start: to its center there, in its axes there, (N, 3)."""
    center, axes = pose(body, 0.0)
    local: Floats = (positions - center) @ axes
    return local


def displaced(collider: Body, start: float, end: float, displacement: tuple[Floats, Floats]) -> Body:
    """Return a collider that is also displaced from its prescribed motion, for times between `start` and `end` [s].

    `displacement`: its displacement at both times [m], (3,) each; between, it changes linearly.
    """
    before, after = displacement
    if np.array_equal(before, after):  # the same keyframes in every frame, so that caches find this collider again
        keyframes = collider.keyframes or ((0.0, 0.0, 0.0, 0.0),)
        shifted = tuple((row[0], *np.add(row[1:4], after).tolist(), *row[4:]) for row in keyframes)
        return replace(collider, keyframes=shifted)
    rows = []
    for seconds, shift in ((start, before), (end, after)):
        offset = keyframe_offset(collider, seconds).copy()
        offset[:3] += shift
        rows.append((seconds, *map(float, offset)))
    return replace(collider, keyframes=tuple(rows))


def is_deforming(collider: Motion | Ground) -> bool:
    """Return whether a collider changes its shape: kernels then meet its triangles (`deforming_meshes.py`)."""
    return isinstance(collider, Mesh) and bool(collider.clip)


def colliders_of(scene: Scene) -> list[Collider | Ground]:
    """Return all colliders of a scene, shape by shape."""
    ground = [] if scene.ground is None else [scene.ground]
    colliders: list[Collider | Ground] = []
    for shape in SHAPES:
        colliders += getattr(scene, shape.section)
        if Ground in shape.classes:
            colliders += ground
    return colliders


def collider_counts(colliders: Sequence[Collider | Ground]) -> tuple[tuple[int, ...], ...]:
    """Return the number of rigid colliders by response (`RESPONSES`) and shape (`SHAPES`)."""
    rigid = [collider for collider in colliders if not is_deforming(collider)]
    return tuple(
        tuple(
            sum(shape_of(collider) is shape and collider.response == response for collider in rigid) for shape in SHAPES
        )
        for response in RESPONSES
    )


def pose_colliders(colliders: Sequence[Collider | Ground], seconds: float) -> list[PosedCollider]:
    """Return every collider at a time [s]. A deforming mesh has its shape then."""
    now = [replace(one, clip_time=seconds) if isinstance(one, Mesh) and one.clip else one for one in colliders]
    return [PosedCollider(one, *pose(one, seconds), np.array(shape_of(one).size(one))) for one in now]


def collider_table(
    colliders: Sequence[Motion | Ground],
    start: float,
    end: float,
    margin_reduction: tuple[ArrayLike, ArrayLike] = (0.0, 0.0),
    origin: Vec3 = (0.0, 0.0, 0.0),
) -> Floats32:
    """Return the table of one frame: a row for every (rigid) collider, then one for every attachment (`step_params`).

    `start`, `end`: of the frame [s]. `margin_reduction`: of every collider at both times [m] (`Depenetration`). Centers
    are relative to `origin` [m]. Rows are ordered by response, then by shape.
    """
    initial, order, moving = _initial_table(tuple(colliders), origin)
    table = initial.copy()
    for row, collider in moving:
        _set_motion(table[row], collider, start, end, origin)
    before, after = map(np.asarray, margin_reduction)
    if before.any():
        table[: before.size, c.COLLIDER_MARGIN] -= before
        table[: before.size, c.COLLIDER_MARGIN_CHANGE] = before - after
    return table[order]


@lru_cache(maxsize=64)  # called in every frame
def _initial_table(
    colliders: tuple[Motion | Ground, ...], origin: Vec3
) -> tuple[Floats32, NDArray[np.int64], tuple[tuple[int, Motion | Ground], ...]]:
    """Return the rows of colliders at their initial poses, the order of these rows in the table, and what moves.

    What moves is a row and its collider.
    """
    table = np.zeros((len(colliders), c.COLLIDER_COLUMNS), np.float32)
    for row, collider in zip(table, colliders, strict=True):
        row[:] = _static_row(collider, origin)
    meshes = [isinstance(collider, Mesh) for collider in colliders]
    table[meshes, c.COLLIDER_SIZE] = np.arange(sum(meshes))
    responses = [
        RESPONSES.index(collider.response) if isinstance(collider, ContactProperties) else len(RESPONSES)
        for collider in colliders
    ]
    moving = tuple((row, collider) for row, collider in enumerate(colliders) if not is_static(collider))
    return table, np.argsort(responses, kind="stable"), moving


def _set_motion(row: Floats32, collider: Motion | Ground, start: float, end: float, origin: Vec3) -> None:
    """Set the columns of a collider's motion in the frame from `start` to `end` [s]."""
    (center, axes), (end_center, end_axes) = pose(collider, start), pose(collider, end)
    if teleports(collider, start, end):
        center, axes = end_center, end_axes
    elif isinstance(collider, Motion) and (any(collider.oscillation) or any(collider.rocking)):
        # Keyframes and spin are even motions, or change their speed between two frames only.
        middle, middle_axes = pose(collider, (start + end) / 2)
        row[c.COLLIDER_BEND : c.COLLIDER_BEND + 3] = middle - (center + end_center) / 2
        turned = rotation_vector_between(axes, middle_axes) - rotation_vector_between(axes, end_axes) / 2
        row[c.COLLIDER_ROTATION_BEND : c.COLLIDER_ROTATION_BEND + 3] = turned
    row[c.COLLIDER_START : c.COLLIDER_START + 3] = np.subtract(center, origin)
    row[c.COLLIDER_END : c.COLLIDER_END + 3] = np.subtract(end_center, origin)
    row[c.COLLIDER_ROTATION : c.COLLIDER_ROTATION + 3] = rotation_vector_between(axes, end_axes)
    row[c.COLLIDER_AXES : c.COLLIDER_AXES + 9] = axes.ravel()


def _static_row(collider: Motion | Ground, origin: Vec3) -> Floats32:
    """Return the row of a collider at its initial pose."""
    row = np.zeros(c.COLLIDER_COLUMNS, np.float32)
    center, axes = pose(collider, 0.0)
    center = center - origin
    if isinstance(collider, Collider | Ground):
        center = shape_of(collider).nearest_center(center, axes)
    for column in (c.COLLIDER_START, c.COLLIDER_END):
        row[column : column + 3] = center
    row[c.COLLIDER_AXES : c.COLLIDER_AXES + 9] = axes.ravel()
    if isinstance(collider, Collider | Ground):
        row[c.COLLIDER_SIZE : c.COLLIDER_SIZE + 3] = shape_of(collider).size(collider)
        row[c.COLLIDER_MARGIN], row[c.COLLIDER_FRICTION] = collider.margin, collider.friction
        row[c.COLLIDER_CONTINUOUS] = collider.continuous
        row[c.COLLIDER_RESTITUTION], row[c.COLLIDER_STIFFNESS] = collider.restitution, collider.stiffness
        row[c.COLLIDER_TRIANGLES] = collides_with_triangles(collider)
    return row


def table_range(counts: tuple[tuple[int, ...], ...], response: int, shape: int) -> tuple[int, int]:
    """Return the first row of a response and shape in the table, and the row after the last.

    `counts`: number of colliders by response and shape, see `collider_counts`.
    """
    first = sum(map(sum, counts[:response])) + sum(counts[response][:shape])
    return first, first + counts[response][shape]


def is_static(collider: Motion | Ground) -> bool:
    """Return whether a collider never moves."""
    return isinstance(collider, Ground) or not (
        any(collider.oscillation)
        or any(collider.rocking)
        or any(collider.spin)
        or collider.keyframes
        or is_deforming(collider)
    )


def teleports(collider: Motion | Ground, start: float, end: float) -> bool:
    """Return whether keyframes move a collider at once between two times [s]."""
    return not isinstance(collider, Ground) and any(
        first < end and start < last for first, last in _teleports(collider)
    )


@lru_cache(maxsize=256)  # called in every frame
def _teleports(collider: Motion) -> tuple[tuple[float, float], ...]:
    """Return the start and end [s] of every such move."""
    moves = pairwise(np.array([row[:4] for row in collider.keyframes]))
    return tuple((a[0], b[0]) for a, b in moves if np.linalg.norm(b[1:] - a[1:]) > TELEPORT_SPEED * (b[0] - a[0]))


def collides_with_triangles(collider: Collider | Ground) -> bool:
    """Return whether whole triangles collide with it, not only particles."""
    return isinstance(collider, RoundCollider) and collider.collide_with == "triangles"


def signed_distance(posed: PosedCollider, points: Floats) -> Floats:
    """Return the distance of points (N, 3) to a collider's surface as drawn [m], (N,); negative inside."""
    return shape_of(posed.collider).signed_distance(posed.collider, (points - posed.center) @ posed.axes)


def triangle_distance(posed: PosedCollider, corners: Floats) -> Floats:
    """Return the distance of triangles, corners (T, 3, 3), to the surface of a collider [m], (T,); negative inside.

    Only for a shape that collides with triangles.
    """
    distance = shape_of(posed.collider).triangle_distance
    assert distance is not None
    return distance(posed.collider, (corners - posed.center) @ posed.axes)


def max_penetration(colliders: Sequence[PosedCollider], points: Floats) -> float:
    """Return the largest depth of points (N, 3) below a surface [m], at least 0. Margins do not count."""
    return max([0.0, *(float(-signed_distance(collider, points).min()) for collider in colliders)])


def ray_cast(colliders: Sequence[PosedCollider], origin: Floats, direction: Floats) -> float:
    """Return the distance along a ray to the first collider [m], infinity if there is none.

    Colliders that contain the origin do not count.
    """
    outside = [collider for collider in colliders if signed_distance(collider, origin[None])[0] > 0]
    traveled = 0.0
    for _ in range(MAX_TRACE_STEPS):
        point = (origin + traveled * direction)[None]
        nearest = min((float(signed_distance(collider, point)[0]) for collider in outside), default=np.inf)
        if nearest < TRACE_TOLERANCE:
            return traveled
        traveled += nearest
        if not traveled < 1e6:
            break
    return np.inf
