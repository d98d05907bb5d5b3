"""Contact of spheres and capsules with triangles of the cloth, in float64.

A triangle that would end a step within a collider's margin gets an impulse at its point closest to the collider's axis.
As in `unilateral_contact.py`, the impulse stops the approach of that point, with Coulomb friction. It moves the corners
as those of a rigid triangle: by their barycentric weights at the point and their masses. Triangles share corners, so
they are solved one after the other, repeatedly, until none approaches the collider.
"""

from __future__ import annotations

import numpy as np

from ...geometry.spring_model import Floats, Ints
from ...scene.collider_schema import Capsule, Sphere
from .unilateral_contact import Pose, impulse, pose

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
    edge, other, offset = corners[1] - corners[0], corners[2] - corners[0], point - corners[0]
    a, b, c = (edge * edge).sum(axis=0), (edge * other).sum(axis=0), (other * other).sum(axis=0)
    d, e = (edge * offset).sum(axis=0), (other * offset).sum(axis=0)
    second, third = np.array([c * d - b * e, a * e - b * d]) / (a * c - b * b)
    projected = np.array([1 - second - third, second, third])
    smallest, found = np.full(a.size, np.inf), projected
    for k in range(3):
        p, side = corners[k], corners[(k + 1) % 3] - corners[k]
        t = np.clip(((point - p) * side).sum(axis=0) / (side * side).sum(axis=0), 0.0, 1.0)
        squared = ((point - p - t * side) ** 2).sum(axis=0)
        weights = np.zeros_like(projected)
        weights[k], weights[(k + 1) % 3] = 1 - t, t
        found = np.where((projected < 0).any(axis=0) & (squared < smallest), weights, found)
        smallest = np.minimum(smallest, squared)
    return found
