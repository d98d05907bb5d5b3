"""Contact of balls and capsules with whole triangles of the cloth, in float64.

A triangle that would end a step within the margin gets an impulse at its point nearest to the collider's axis: as in
`contact.py` the one that stops the approach of that point, with Coulomb friction. The corners share it as a rigid
triangle's do, by their weights in the point and their masses. Triangles share corners, so one after the other they get
what is left to stop, until nothing is.
"""

from __future__ import annotations

import numpy as np

from ..scene.model import Capsule, Sphere
from .contact import impulse
from .poses import Pose, pose
from .springs import Floats, Ints

ROUNDS = 200  # at most, over all triangles in contact
LEFT = 1e-12  # [m/s] of approach, and [m] of depth, that count as none


class TriangleContact:
    """A collider that keeps out the triangles whose corners are given, (3 corners, T)."""

    def __init__(self, collider: Sphere | Capsule, corners: Ints, inverse_mass: Floats) -> None:
        """`inverse_mass` [1/kg] (N,) is 0 of particles that do not move by themselves."""
        self._collider = collider
        self._half = collider.length / 2 if isinstance(collider, Capsule) else 0.0
        self._reach = collider.radius + collider.margin
        self._friction = collider.friction
        self._corners, self._inverse_mass = corners, inverse_mass

    def stop(self, x: Floats, v: Floats, seconds: float) -> Ints:
        """Changes velocities (3, N) in place so that no triangle within the margin approaches the collider further;
        places (3, N) are those of the step's end, at a time. Returns the triangles that are within.
        """
        at = pose(self._collider, seconds)
        within, weights, normal = self._within(x, at)
        points = [self._corners[:, t] for t in within]
        for _ in range(ROUNDS):
            most = 0.0
            for corners, weight, n in zip(points, weights.T, normal.T, strict=True):
                relative = v[:, corners] @ weight - at.surface_velocity(x[:, corners] @ weight[:, None])[:, 0]
                approach = max(-float(relative @ n), 0.0)
                if approach > 0:
                    change = impulse(n[:, None], relative[:, None], np.array([approach]), self._friction)
                    v[:, corners] += change * self._shares(corners, weight)
                    most = max(most, approach)
            if most <= LEFT:
                break
        return within

    def put_out(self, x: Floats, seconds: float, triangles: Ints) -> None:
        """Moves these triangles to the margin, in place."""
        at = pose(self._collider, seconds)
        for _ in range(ROUNDS):
            deepest = 0.0
            for corners in self._corners[:, triangles].T:
                weight, away = nearest(at.local(x[:, corners])[:, :, None].transpose(1, 0, 2), self._half)
                far = float(np.sqrt((away**2).sum()))
                if self._reach - far > LEFT:
                    x[:, corners] += (self._reach - far) * (at.axes @ away / far) * self._shares(corners, weight[:, 0])
                    deepest = max(deepest, self._reach - far)
            if deepest <= LEFT:
                break

    def _within(self, x: Floats, at: Pose) -> tuple[Ints, Floats, Floats]:
        """Triangles within the margin, their corners' weights in the nearest point (3, M) and the normals there."""
        local = at.local(x)
        off = local.copy()
        off[1] -= np.clip(off[1], -self._half, self._half)
        distance = np.sqrt((off * off).sum(axis=0))[self._corners[0]]
        sides = [local[:, self._corners[k]] - local[:, self._corners[0]] for k in (1, 2)]
        longest = np.sqrt(np.maximum(*[(side * side).sum(axis=0) for side in sides]))
        near = np.flatnonzero(distance < self._reach + longest)
        weights, away = nearest(local[:, self._corners[:, near]].transpose(1, 0, 2), self._half)
        far = np.sqrt((away * away).sum(axis=0))
        chosen = far < self._reach
        return near[chosen], weights[:, chosen], at.axes @ (away[:, chosen] / far[chosen])

    def _shares(self, corners: Ints, weight: Floats) -> Floats:
        """What every corner gets of a change at the point, (3,)."""
        each = weight * self._inverse_mass[corners]
        whole = float(weight @ each)
        found: Floats = each / whole if whole > 0 else np.zeros(3)
        return found


def nearest(corners: Floats, half: float) -> tuple[Floats, Floats]:
    """Where triangles (3 corners, 3, M) are nearest to the piece of the y axis from −half to half, which goes through
    none of them: weights of their corners there (3, M), and the way to there from the axis (3, M).

    That is the nearest to an end of the axis, or on a side (Ericson 2005, 5.1.9 and 5.1.10).
    """
    tried = [_weights_nearest_to(np.array([[0.0], [end], [0.0]]), corners) for end in (-half, half)]
    for k in range(3):
        p, side = corners[k], corners[(k + 1) % 3] - corners[k]
        share = _share_of_side(p, side, half)
        weights = np.zeros((3, share.size))
        weights[k], weights[(k + 1) % 3] = 1 - share, share
        tried.append(weights)
    ways = []
    for weights in tried:
        way = np.einsum("km,kim->im", weights, corners)
        way[1] -= np.clip(way[1], -half, half)
        ways.append(way)
    best = np.argmin([(way * way).sum(axis=0) for way in ways], axis=0)
    here = np.arange(best.size)
    return np.array(tried)[best, :, here].T, np.array(ways)[best, :, here].T


def _share_of_side(p: Floats, side: Floats, half: float) -> Floats:
    """How far along the sides from p the points are that are nearest to the axis, (M,).

    Nearest to the endless line first; where that is beyond an end of the piece, nearest to this end.
    """
    across = side[0] ** 2 + side[2] ** 2
    share = np.clip(-(p[0] * side[0] + p[2] * side[2]) / np.where(across > 0, across, 1.0), 0.0, 1.0)
    end = np.clip(p[1] + share * side[1], -half, half)
    to_end = (end - p[1]) * side[1] - p[0] * side[0] - p[2] * side[2]
    found: Floats = np.clip(to_end / (side * side).sum(axis=0), 0.0, 1.0)
    return found


def _weights_nearest_to(place: Floats, corners: Floats) -> Floats:
    """Weights of the corners (3, M) in the points of triangles nearest to a place (3, 1)."""
    edge, other, away = corners[1] - corners[0], corners[2] - corners[0], place - corners[0]
    a, b, c = (edge * edge).sum(axis=0), (edge * other).sum(axis=0), (other * other).sum(axis=0)
    d, e = (edge * away).sum(axis=0), (other * away).sum(axis=0)
    second, third = np.array([c * d - b * e, a * e - b * d]) / (a * c - b * b)
    inside = np.array([1 - second - third, second, third])
    least, found = np.full(a.size, np.inf), inside
    for k in range(3):
        p, side = corners[k], corners[(k + 1) % 3] - corners[k]
        share = np.clip(((place - p) * side).sum(axis=0) / (side * side).sum(axis=0), 0.0, 1.0)
        squared = ((place - p - share * side) ** 2).sum(axis=0)
        weights = np.zeros_like(inside)
        weights[k], weights[(k + 1) % 3] = 1 - share, share
        found = np.where((inside < 0).any(axis=0) & (squared < least), weights, found)
        least = np.minimum(least, squared)
    return found
