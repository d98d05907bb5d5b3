"""Woven cloth as threads and their crossings, with measured curves, in float64. NumPy only.

The particle model of Breen, House and Wozny (1994, *Predicting the drape of woven cloth using interacting particles*):
particles are the crossings of threads along columns (warp) and rows (weft), and curves of a fabric tester give the
energies of stretching, shear and bending. Eberhardt, Weber and Strasser (1996, *A fast, flexible, particle-system model
for cloth draping*) made it dynamic.

    threads    width·length·∫T dε of every segment between neighbors along a thread, with ε = |d|/length − 1
    crossings  (cell area/4)·∫M dφ at every corner of every cell; the two sides that meet there enclose 90° − φ
    bending    width·ℓ·∫M dκ at every inner particle of a thread, with κ = |t₂ − t₁|/ℓ of the unit vectors t along its
               two segments: for particles on a circle of radius R exactly 1/R

T and M are per width [N/m], [N], and the moment of shear per area [J/m²]. Threads and crossings are those of the four
triangles of half weight that a membrane has in every cell: f₁ and f₂ of a triangle are two of its sides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..scene.fabric_schema import Weave
from ..scene.keys import MAX_POINTS, Curve
from .membrane_model import MAX_STRAIN, ElasticTriangles, Floats, Ints, dot, shapes_of, triangles_of
from .topology import Topology

# Stretch below which a thread acts as if it were that long: directions of shorter ones are ill-defined, and forces of
# crossings and bending, which grow with 1/stretch, would need ever shorter substeps.
MIN_STRETCH = 0.1
# Factor on the frequency bound: where the slope of a curve changes, explicit steps add energy to vibrations that they
# only just resolve. An undamped crumpled sheet of 4.6 J gained 4 J in 5 s without it; now it gains 0.2 J.
KINK_MARGIN = 1.25
MIN_SINE = 1e-3  # of the angle between threads, which divides: they are parallel to 0.06°


@dataclass(frozen=True, eq=False)
class PiecewiseLinear:
    """A curve from (0, 0), as a sum of ramps: y = Σ changeₖ·max(x − knotₖ, 0) for x ≥ 0."""

    knots: Floats
    """Where a piece begins, (K,); the first is 0."""
    changes: Floats
    """By how much the slope changes there, (K,)."""

    def at(self, x: Floats, compression: float = 1.0) -> Floats:
        """Return y at every x. Where x < 0 it is the first slope times `compression`, times x."""
        y: Floats = self.changes @ np.maximum(x - self.knots[:, None], 0.0)
        y += compression * self.changes[0] * np.minimum(x, 0.0)
        return y

    def slope(self, x: Floats, compression: float = 1.0) -> Floats:
        """Return dy/dx at every x."""
        return np.where(x < 0, compression * self.changes[0], self.changes @ (x >= self.knots[:, None]))

    def integral(self, x: Floats, compression: float = 1.0) -> Floats:
        """Return ∫y dx from 0 to every x."""
        twice: Floats = self.changes @ np.maximum(x - self.knots[:, None], 0.0) ** 2
        twice += compression * self.changes[0] * np.minimum(x, 0.0) ** 2
        return 0.5 * twice

    def largest_slope(self, end: float = np.inf) -> float:
        """Return the largest slope between 0 and `end`."""
        return float(np.cumsum(self.changes)[self.knots < end].max())


def piecewise_linear(points: Curve, scale: float = 1.0) -> PiecewiseLinear:
    """Return the curve through [0, 0] and `points`, with x times `scale`."""
    ends = [(0.0, 0.0), *((scale * x, y) for x, y in points)]
    slopes = [(y_after - y) / (x_after - x) for (x, y), (x_after, y_after) in pairwise(ends)]
    return PiecewiseLinear(np.array([x for x, _ in ends[:-1]]), np.diff(slopes, prepend=0.0))


NO_CURVE = PiecewiseLinear(np.zeros(1), np.zeros(1))


@dataclass(frozen=True, eq=False)
class ThreadBends:
    """K inner particles of threads that resist bending."""

    corners: Ints
    """The particle before it, the particle itself and the one after it, (K, 3)."""
    width: Floats
    """Width of the cloth that the thread represents [m], times the factor of a stiffness map, (K,)."""
    axis: Ints
    """0 for threads along the warp, 1 along the weft, (K,)."""


@dataclass(frozen=True, eq=False)
class WeaveModel(ElasticTriangles):
    """A grid of threads. f₁ and f₂ of its triangles are along warp and weft."""

    warp: PiecewiseLinear
    """Tension [N/m] against strain."""
    weft: PiecewiseLinear
    shear: PiecewiseLinear
    """Moment of a crossing per area [N/m] against the shear angle [radians]."""
    bending: tuple[PiecewiseLinear, PiecewiseLinear]
    """Moment per width [N] against curvature [1/m], along warp and weft."""
    bends: ThreadBends
    compression: float = 1.0
    """Stiffness of a thread that is compressed over the first slope of its curve."""

    @property
    def point_count(self) -> int:
        """Number of pieces of the curve that has most."""
        return max(len(curve.knots) for curve in (self.warp, self.weft, self.shear, *self.bending))

    @property
    def table(self) -> Floats:
        """The curves as the columns from `WEAVE` of the step parameters: knots, then changes of slope, (5, 16)."""
        table = np.zeros((5, 2, MAX_POINTS))
        for row, curve in zip(table, (self.warp, self.weft, self.shear, *self.bending), strict=True):
            row[:, : len(curve.knots)] = curve.knots, curve.changes
        return table.reshape(5, -1)

    def energy(self, x: Floats) -> float:
        shape = _Shape(*self.gradient(x))
        density = self.shear.integral(np.abs(shape.angle))
        for curve, stretch in zip((self.warp, self.weft), shape.stretches, strict=True):
            density = density + self._thread_energy(curve, stretch)
        return float(self.area @ density) + self._bending_energy(x)

    def force(self, x: Floats) -> Floats:
        shape = _Shape(*self.gradient(x))
        warp, weft = (stretch - 1 for stretch in shape.stretches)
        moment = np.sign(shape.angle) * self.shear.at(np.abs(shape.angle))
        stress = shape.stress(self.warp.at(warp, self.compression), self.weft.at(weft, self.compression), moment)
        return self.scatter(x, stress) + self._bending_force(x)

    def damper_force(self, x: Floats, v: Floats, damping_time: float) -> Floats:
        """Return the force of damping on every particle [N], (3, N): slopes of the curves times rates, times the time.

        Bending has none. `v`: velocities, (3, N) [m/s].
        """
        (f1, f2), (g1, g2) = self.gradient(x), self.gradient(v)
        shape = _Shape(f1, f2)
        rates = shape.rates(dot(f1, g1), dot(f2, g2), dot(f1, g2) + dot(f2, g1))
        slopes = (
            self.warp.slope(shape.stretches[0] - 1, self.compression),
            self.weft.slope(shape.stretches[1] - 1, self.compression),
            self.shear.slope(np.abs(shape.angle)),
        )
        warp, weft, moment = (slope * rate * damping_time for slope, rate in zip(slopes, rates, strict=True))
        return self.scatter(x, shape.stress(warp, weft, moment))

    def scaled(self, factor: float) -> WeaveModel:
        return replace(self, area=self.area * factor, bends=replace(self.bends, width=self.bends.width * factor))

    def scalar_elements(self) -> tuple[Ints, Floats]:
        """Return all triangles and bends, and matrices that bound their stiffness.

        A thread resists by at most the largest slope k of its curve up to `MAX_STRAIN`, across its direction too, since
        T/(1 + ε) ≤ k. The shear angle changes by at most |δf₁|/λ₁ + |δf₂|/λ₂, with stretches λ from 1 − `MAX_STRAIN`. A
        curvature changes by at most (|δd₁| + |δd₂|)/ℓ² with the segments d₁ and d₂, and M/κ is at most a slope.
        """
        margin, shortest = KINK_MARGIN**2, (1 - MAX_STRAIN) ** 2
        shear = 2 * self.shear.largest_slope() / shortest
        threads = np.array([curve.largest_slope(MAX_STRAIN) for curve in (self.warp, self.weft)])
        lengths = 1 / np.array(self.cells_per_meter)
        slopes = np.array([curve.largest_slope() for curve in self.bending])
        constant = (2 * slopes / lengths**3 / shortest)[self.bends.axis] * self.bends.width
        two_springs = np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
        elements = self._bounded_by(margin * (threads + shear)), margin * constant[:, None, None] * two_springs
        return np.concatenate([self.corners, self.bends.corners]), np.concatenate(elements)

    def _thread_energy(self, curve: PiecewiseLinear, stretch: Floats) -> Floats:
        """Return the energy of threads per area [J/m²], (M,)."""
        within = np.maximum(stretch, MIN_STRETCH)
        missing = np.minimum(stretch, MIN_STRETCH)  # where the force is T·λ/MIN_STRETCH
        below = (missing**3 - MIN_STRETCH**3) / 3 - (missing**2 - MIN_STRETCH**2) / 2
        energy: Floats = self.compression * curve.changes[0] / MIN_STRETCH * below
        return curve.integral(within - 1, self.compression) + energy

    def _thread_angles(self, x: Floats) -> tuple[list[Floats], list[Floats], Floats]:
        """Return the two directions at every bend, (3, K), their lengths that divide [m], and the segments' ℓ [m]."""
        rest = (1 / np.array(self.cells_per_meter))[self.bends.axis]
        a, b, c = (x.take(corner, axis=1) for corner in self.bends.corners.T)
        lengths = [np.maximum(np.sqrt(dot(d, d)), MIN_STRETCH * rest) for d in (b - a, c - b)]
        return [d / length for d, length in zip((b - a, c - b), lengths, strict=True)], lengths, rest

    def _by_axis(self, method: str, curvature: Floats) -> Floats:
        """Return what a method of the bending curves returns for every bend, (K,)."""
        values: list[Floats] = [getattr(curve, method)(curvature) for curve in self.bending]
        return np.where(self.bends.axis == 0, *values)

    def _bending_energy(self, x: Floats) -> float:
        (before, after), _, rest = self._thread_angles(x)
        curvature = np.sqrt(dot(after - before, after - before)) / rest
        return float((self.bends.width * rest) @ self._by_axis("integral", curvature))

    def _bending_force(self, x: Floats) -> Floats:
        directions, lengths, rest = self._thread_angles(x)
        turn = directions[1] - directions[0]
        size = np.sqrt(dot(turn, turn))
        pull = turn * self.bends.width * self._by_axis("at", size / rest) / np.maximum(size, 1e-12)
        on_ends = []
        for direction, length in zip(directions, lengths, strict=True):
            along = np.where(length > MIN_STRETCH * rest, dot(direction, pull), 0.0)
            on_ends.append((direction * along - pull) / length)
        force = np.concatenate([on_ends[0], -(on_ends[0] + on_ends[1]), on_ends[1]], axis=1)
        index, count = self.bends.corners.T.reshape(-1), x.shape[1]
        return np.stack([np.bincount(index, component, count) for component in force])


class _Shape:
    """Stretches and shear angle of M triangles."""

    def __init__(self, f1: Floats, f2: Floats) -> None:
        """`f1`, `f2`: derivatives of position along warp and weft, (3, M)."""
        self.stretches = np.sqrt(dot(f1, f1)), np.sqrt(dot(f2, f2))
        self.lengths = tuple(np.maximum(stretch, MIN_STRETCH) for stretch in self.stretches)
        self.cosine = dot(f1, f2) / (self.lengths[0] * self.lengths[1])
        self.sine = np.sqrt(np.maximum(1 - self.cosine**2, MIN_SINE**2))
        self.angle: Floats = np.arcsin(np.clip(self.cosine, -1.0, 1.0))

    def stress(self, warp: Floats, weft: Floats, moment: Floats) -> Floats:
        """Return S₁₁, S₂₂ and S₁₂ [N/m], (3, M), of two tensions and a moment per area [N/m]."""
        across = moment / self.sine
        own = [
            tension / length - np.where(stretch > MIN_STRETCH, across * self.cosine / length**2, 0.0)
            for tension, stretch, length in zip((warp, weft), self.stretches, self.lengths, strict=True)
        ]
        return np.stack([*own, across / (self.lengths[0] * self.lengths[1])])

    def rates(self, d1: Floats, d2: Floats, d12: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the rates [1/s] of both strains and the shear angle, of the rates of Green's strain."""
        shares = [
            np.where(stretch > MIN_STRETCH, rate / length**2, 0.0)
            for rate, stretch, length in zip((d1, d2), self.stretches, self.lengths, strict=True)
        ]
        turning = d12 / (self.lengths[0] * self.lengths[1]) - self.cosine * (shares[0] + shares[1])
        return d1 / self.lengths[0], d2 / self.lengths[1], turning / self.sine


def build_weave(weave: Weave, compression: float, topology: Topology, factor: NDArray[np.float64] | None) -> WeaveModel:
    """Return the threads of a grid.

    `factor`: on the stiffness at every particle, (N,); None if it is the same everywhere.
    """
    corners, share = triangles_of(topology)
    inverse_shape, area = shapes_of(topology.flat, corners, 0.0)
    weight = share * area if factor is None else share * area * factor[corners].mean(axis=1)
    bending = tuple(
        piecewise_linear(points) if points else NO_CURVE for points in (weave.bending_warp, weave.bending_weft)
    )
    model = WeaveModel(
        corners,
        inverse_shape,
        weight,
        piecewise_linear(weave.warp),
        piecewise_linear(weave.weft),
        piecewise_linear(weave.shear, np.pi / 180),
        (bending[0], bending[1]),
        ThreadBends(np.zeros((0, 3), np.int32), np.zeros(0), np.zeros(0, np.int32)),
        compression,
    )
    used = bool(weave.bending_warp), bool(weave.bending_weft)
    return replace(model, bends=_bends_of(topology, model.cells_per_meter, used, factor))


def _bends_of(
    topology: Topology, cells_per_meter: tuple[float, float], used: tuple[bool, bool], factor: Floats | None
) -> ThreadBends:
    """Return the inner particles of the threads along warp and weft that are `used`."""
    rows, columns = topology.shape[0] // topology.layers, topology.shape[1]
    index = np.arange(topology.particle_count).reshape(topology.layers, rows, columns)
    corners, widths, axes = [np.zeros((0, 3), np.int64)], [np.zeros(0)], [np.zeros(0, np.int64)]
    for axis in (0, 1):
        along = index if axis == 0 else index.transpose(0, 2, 1)  # particles of a thread follow each other in axis 1
        found = np.stack([along[:, :-2], along[:, 1:-1], along[:, 2:]], axis=-1)
        share = np.ones(found.shape[:-1])
        share[:, :, [0, -1]] = 0.5  # a thread on an edge represents half a cell
        if used[axis]:
            corners.append(found.reshape(-1, 3))
            widths.append(share.reshape(-1) / cells_per_meter[1 - axis])
            axes.append(np.full(share.size, axis))
    triples, width = np.concatenate(corners), np.concatenate(widths)
    if factor is not None:
        width = width * factor[triples[:, 1]]
    return ThreadBends(triples.astype(np.int32), width, np.concatenate(axes).astype(np.int32))
