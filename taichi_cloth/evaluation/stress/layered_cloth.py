"""Cases 14 to 16 and 20 to 23: self-collision, and balls that overlap the cloth."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import hypot, sqrt

import numpy as np
from numpy.typing import NDArray

from ...geometry.grid import rotation_matrix
from ...geometry.topology import spring_strains
from ...scene.collider_schema import Capsule, Ground, Sphere
from ...scene.keys import Keyframes
from ...scene.schema import FRAME_SECONDS, Forces
from .contact import MARGIN, hung
from .invariants import Floats
from .setup import (
    CELLS,
    FLAT,
    SIDE,
    particle_self_collision,
    sheet,
    static_strain,
    triangle_self_collision,
    with_layers,
)
from .trial import CALM_STRAIN, INTERSECTIONS, Trial

Indices = NDArray[np.int32]


def to_segments(p: Floats, a: Floats, b: Floats) -> Floats:
    """Return the distance of each point from its segment [m], (M,). Points `p` and ends `a`, `b` are (M, 3)."""
    edge = b - a
    t = np.einsum("ij,ij->i", p - a, edge) / np.maximum(np.einsum("ij,ij->i", edge, edge), 1e-300)
    distances: Floats = np.linalg.norm(p - a - np.clip(t, 0.0, 1.0)[:, None] * edge, axis=1)
    return distances


def to_triangles(p: Floats, a: Floats, b: Floats, c: Floats) -> Floats:
    """Return the distance of each point from its triangle [m], (M,). Points `p` and corners are (M, 3)."""
    normal = np.cross(b - a, c - a)
    squared_norm = np.maximum(np.einsum("ij,ij->i", normal, normal), 1e-300)
    inside = np.ones(len(p), bool)  # whether the projection of the point is inside the triangle
    for q, r in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("ij,ij->i", np.cross(r - q, p - q), normal) >= 0
    plane = np.abs(np.einsum("ij,ij->i", p - a, normal)) / np.sqrt(squared_norm)
    edges = np.minimum(np.minimum(to_segments(p, a, b), to_segments(p, b, c)), to_segments(p, c, a))
    return np.where(inside, np.minimum(plane, edges), edges)


def nearest(points: Floats, x: Floats, triangles: Indices, reach: float) -> float:
    """Return the smallest distance between points (P, 3) and triangles (T, 3) [m], at most `reach`.

    Triangles are indices of the particles `x`, (N, 3).
    """
    a, b, c = (x[triangles[:, k]] for k in range(3))
    center = (a + b + c) / 3
    radius = max(float(np.linalg.norm(corner - center, axis=1).max()) for corner in (a, b, c))
    k, t = near(points, center, reach + radius)
    distances = to_triangles(points[k], a[t], b[t], c[t])
    return min(reach, float(distances.min(initial=reach)))


def between_segments(p: Floats, q: Floats, r: Floats, s: Floats) -> Floats:
    """Return the distance of each segment p–q from its segment r–s [m], (M,). Ends are (M, 3)."""
    u, v, w = q - p, s - r, p - r
    a, b, c = (np.einsum("ij,ij->i", u, other) for other in (u, v, w))
    e, f = (np.einsum("ij,ij->i", v, other) for other in (v, w))
    a, e = np.maximum(a, 1e-300), np.maximum(e, 1e-300)
    on_first = np.clip((b * f - c * e) / np.maximum(a * e - b * b, 1e-12 * a * e), 0.0, 1.0)
    on_other = np.clip((b * on_first + f) / e, 0.0, 1.0)
    on_first = np.clip((b * on_other - c) / a, 0.0, 1.0)
    distances: Floats = np.linalg.norm(w + on_first[:, None] * u - on_other[:, None] * v, axis=1)
    return distances


def nearest_edges(x: Floats, y: Floats, edges: Indices, reach: float) -> float:
    """Return the smallest distance between the edges of two layers [m], at most `reach`.

    `x` and `y` (N, 3) are the positions of both, `edges` (E, 2) those of each.
    """
    (a, b), (c, d) = ((layer[edges[:, 0]], layer[edges[:, 1]]) for layer in (x, y))
    longest = max(float(np.linalg.norm(edge, axis=1).max()) for edge in (b - a, d - c))
    k, t = near((a + b) / 2, (c + d) / 2, reach + longest)
    return min(reach, float(between_segments(a[k], b[k], c[t], d[t]).min(initial=reach)))


def near(p: Floats, q: Floats, reach: float) -> tuple[Indices, Indices]:
    """Return all pairs of points of `p` (P, 3) and `q` (Q, 3) that are nearer than `reach` [m], and a few others."""
    origin = q.mean(axis=0)  # relative to it float32 is precise enough
    p32, q32 = (p - origin).astype(np.float32), (q - origin).astype(np.float32)
    squares = (p32 * p32).sum(1)[:, None] + (q32 * q32).sum(1)[None] - 2 * p32 @ q32.T
    first, other = np.nonzero(squares < 1.01 * reach**2)
    return first.astype(np.int32), other.astype(np.int32)


def smallest_gap(x: Floats, triangles: Indices, count: int, reach: float) -> float:
    """Return the smallest distance between adjacent layers [m], at most `reach`.

    Distances are those of particles to triangles, in both directions, and of edges to edges. `x` (N, 3) has the
    particles of `count` layers, layer by layer. `triangles` are those of the first layer.
    """
    sides = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    edges = np.unique(np.sort(sides, axis=1), axis=0)
    gap = reach
    for a, b in pairwise(x.reshape(count, -1, 3)):
        gap = min(gap, nearest(a, b, triangles, gap), nearest(b, a, triangles, gap), nearest_edges(a, b, edges, gap))
    return gap


def is_stacked(x: Floats, count: int) -> bool:
    """Return whether the mean height still increases from each layer to the next."""
    heights = x.reshape(count, -1, 3)[:, :, 1].mean(axis=1)
    return bool((np.diff(heights) > 0).all())


EJECTED = 2.0  # [m/s] largest speed of cloth that a collider suddenly encloses
DEPTH = 0.05  # [m] of the pin below the surface of the ball


def watch_ejection(trial: Trial, seconds: float) -> None:
    """Run, and check in every frame that no particle is ejected faster than `EJECTED`."""
    for _ in range(round(seconds / FRAME_SECONDS)):
        trial.one_frame()
        trial.record("speed [m/s]", trial.watch.speed, EJECTED)


def engulfed(trial: Trial) -> None:
    """Start a free sheet inside a ball of 1 m."""
    ball = Sphere(center=(0.0, 0.0, -0.05), radius=1.0, margin=MARGIN, friction=0.0)
    trial.open(sheet(CELLS, pins=(), forces=Forces(gravity=0.0), spheres=(ball,)))
    trial.start()
    watch_ejection(trial, 8.0)
    trial.settle()


def teleported(trial: Trial) -> None:
    """Teleport a ball from 5 m away into the middle of the sheet within a frame, and back six seconds later.

    At the end the sheet hangs freely: no independent code gives its rest shape on the ball.
    """
    path: Keyframes = ((0.5, 0, 0, 0), (0.500001, 0, 0, 5.01), (6.5, 0, 0, 5.01), (6.500001, 0, 0, 0))
    ball = Sphere(center=(0.0, 0.0, -5.0), radius=0.3, margin=MARGIN, keyframes=path, friction=0.0)
    trial.open(replace(hung(), spheres=(ball,)), rest=hung())
    trial.start()
    watch_ejection(trial, 6.5)
    trial.settle()


def inflated(trial: Trial) -> None:
    """Inflate a ball of 1 mm in the middle of the sheet to 0.5 m in one frame, and deflate it after six seconds."""
    ball = Sphere(center=(0.0, 0.0, 0.01), radius=1e-3, margin=MARGIN, friction=0.0)
    trial.open(replace(hung(), spheres=(ball,)), rest=hung())
    trial.start()
    watch_ejection(trial, 0.5)
    trial.change(lambda: trial.simulation.params.update({"sphere_radius": 0.5}))
    watch_ejection(trial, 6.0)
    trial.change(lambda: trial.simulation.params.update({"sphere_radius": 1e-3}))
    trial.settle()


def beside_pin(radius: float, depth: float, cell: float) -> float:
    """Return the strain of the springs from a pin at `depth` inside a ball to its two neighbors on the surface.

    The neighbors are as close to the pin as possible, and a diagonal of a cell apart. `radius`, `depth`, `cell` in [m].
    """
    side = cell / sqrt(2)
    up = sqrt(radius**2 - side**2) - (radius - depth)
    return hypot(side, up) / cell - 1


def ball_on_pin(trial: Trial) -> None:
    """Start with a pinned corner 5 cm inside a ball. It must stay, and its neighbors come to rest on the ball.

    Geometry stretches the springs between them: `beside_pin` is added to the bound on the strain there only.
    """
    radius, cell = 0.15, SIDE / CELLS
    ball = Sphere(center=(-SIDE / 2, SIDE / 2 - (radius - DEPTH), 0.0), radius=radius, margin=0.0, friction=0.0)
    free = sheet(CELLS)
    bound = static_strain(trial.setting.of(free)) + CALM_STRAIN
    trial.open(replace(free, spheres=(ball,)), rest_strain=bound + beside_pin(radius, DEPTH, cell))
    trial.start()
    trial.settle()
    trial.record("strain off the ball", strain_outside(trial, np.array(ball.center), radius + cell), bound)


def strain_outside(trial: Trial, center: Floats, radius: float) -> float:
    """Return the largest strain of structural springs with both ends outside a sphere [m]."""
    topology, x = trial.simulation.topology, trial.simulation.positions()
    springs = topology.family("structural")
    outside = (np.linalg.norm(x - center, axis=1) > radius)[topology.ends[springs]].all(axis=1)
    return float(spring_strains(topology, x)[springs][outside].max())


def squeeze(trial: Trial) -> None:
    """Squeeze the sheet between two balls of 0.3 m until they touch, then overlap by 0.1 m; then they move back."""
    radius, start = 0.3, 0.5
    touching = start - radius  # [m] travel of each ball
    path: Keyframes = (
        (0.0, 0, 0, 0),
        (1.0, 0, 0, touching),
        (1.5, 0, 0, touching),
        (2.0, 0, 0, touching + 0.05),
        (2.5, 0, 0, touching + 0.05),
        (3.5, 0, 0, 0),
    )
    mirrored: Keyframes = tuple((t, x, y, -z) for t, x, y, z in path)
    first = Sphere(center=(0.0, -0.1, -start), radius=radius, margin=MARGIN, keyframes=path, friction=0.0)
    other = Sphere(center=(0.0, -0.1, start), radius=radius, margin=MARGIN, keyframes=mirrored, friction=0.0)
    trial.open(replace(hung(), spheres=(first, other)), rest=hung())
    trial.start()
    trial.run(3.5)
    trial.settle()


TWIST_RATE, TWIST = 72.0, 720.0  # of each edge: [degrees/s], [degrees]
SHAPE = 0.01 * SIDE  # [m] from the position of a particle before the twist, once the sheet is untwisted
LOOK_EVERY = 30  # frames between counts of self-intersections, or measurements of gaps
LAYERS, SPACING, TURN = 10, 0.1, 9.0  # layers, and from each to the next [m], [degrees]
HALF = 0.5  # share of the thickness that must remain between two layers
MANY_LAYERS, MANY_SPACING = 50, 0.04  # layers, and from each to the next [m]


def twist(trial: Trial) -> None:
    """Twist two edges against each other at 72°/s by 720° each, and back.

    The sheet must hang as before, without self-intersections.
    """
    trial.open(sheet(CELLS, pins=("left", "right"), self_collision=particle_self_collision(SIDE / CELLS)))
    trial.start()
    trial.settle()
    simulation = trial.simulation
    before, intersections = simulation.positions(), 0
    pins = before[simulation.topology.pinned]
    frames = round(TWIST / TWIST_RATE / FRAME_SECONDS)
    for k in [*range(1, frames + 1), *range(frames - 1, -1, -1)]:
        trial.set_pins(twisted(pins, TWIST * k / frames))
        trial.one_frame()
        if k % LOOK_EVERY == 0:
            intersections = max(intersections, simulation.intersections())
    trial.record("intersections in the worst frame", intersections)
    trial.settle()
    distance = float(np.linalg.norm(simulation.positions() - before, axis=1).max())
    trial.record(INTERSECTIONS, simulation.intersections(), 0)
    trial.record("distance from the shape before [m]", distance, SHAPE)


def twisted(pins: Floats, degrees: float) -> Floats:
    """Return the positions of two edges: the right one rotated about x by an angle, the left one by its negative."""
    rotated = [pins @ rotation_matrix((sign * (degrees % 360), 0, 0)).T for sign in (1, -1)]
    return np.where(pins[:, :1] > 0, *rotated)


class Stack:
    """Layers that lie on each other, and the smallest gap between adjacent ones."""

    def __init__(self, trial: Trial, count: int, thickness: float) -> None:
        self._trial, self._count, self._thickness = trial, count, thickness
        topology = trial.simulation.topology
        self._triangles = topology.triangles[: len(topology.triangles) // count]
        self._frames = 0

    def run(self, seconds: float) -> None:
        """Run, and check the gap every `LOOK_EVERY` frames."""
        for _ in range(round(seconds / FRAME_SECONDS)):
            self._trial.one_frame()
            self.after_frame()

    def after_frame(self) -> None:
        """Check the gap if this is one of every `LOOK_EVERY` frames."""
        self._frames += 1
        if self._frames % LOOK_EVERY == 0:
            self.look()

    def look(self) -> None:
        """Check that the gap is at least half a thickness."""
        self._trial.record("gap missing, of half a thickness", self.missing(), 0.0)

    def missing(self) -> float:
        """Return how far the smallest gap falls short of half a thickness, as a share of that."""
        x = self._trial.simulation.positions()
        return 1 - smallest_gap(x, self._triangles, self._count, self._thickness) / (HALF * self._thickness)

    def end(self) -> None:
        """Check the gap, and that there are no self-intersections and the layers are in order."""
        self.look()
        simulation = self._trial.simulation
        self._trial.record(INTERSECTIONS, simulation.intersections(), 0)
        self._trial.record("stacks out of order", float(not is_stacked(simulation.positions(), self._count)), 0)


def layers(trial: Trial, cells: int | None = None) -> None:
    """Drop ten level layers, 0.1 m apart and each rotated by 9° against the one below, on the ground.

    Then a ball moves down and stays a thickness deep in the pile: colliders are kinematic, and their weight cannot act.
    """
    cells = cells or CELLS
    contact = particle_self_collision(SIDE / cells)
    ground = Ground(height=-SPACING, friction=0.4)
    top = ground.height + ground.margin + (LAYERS - 1) * contact.thickness  # [m] height of the pile
    radius, start_height = 0.3, LAYERS * SPACING + 0.5
    rest = top + MARGIN + radius - contact.thickness
    path: Keyframes = ((1.0, 0, 0, 0), (2.0, 0, rest - start_height, 0))
    ball = Sphere(center=(0.0, start_height, 0.0), radius=radius, margin=MARGIN, friction=0.4, keyframes=path)
    scene = sheet(cells, pins=(), rotation=FLAT, spheres=(ball,), ground=ground, self_collision=contact)
    trial.open(with_layers(scene, LAYERS, SPACING, TURN))
    trial.start()
    stack = Stack(trial, LAYERS, contact.thickness)
    stack.run(2.5)
    trial.settle(after_frame=stack.after_frame)
    stack.end()
    center = trial.simulation.colliders()[0].center
    surface = np.linalg.norm(trial.simulation.positions() - center, axis=1) - (radius + MARGIN)
    trial.record("distance of the ball from the pile [m]", float(surface.min()), contact.thickness)


def many_layers(trial: Trial, cells: int | None = None) -> None:
    """Drop fifty layers, 4 cm apart, on a bar, from which none may fall. Cells have one size, so fewer are less cloth.

    Gaps and intersections are recorded: the specification bounds only the time.
    """
    contact = triangle_self_collision()
    bar = Capsule(center=(0.0, -0.2, 0.0), rotation=(0.0, 0.0, 90.0), length=2 * SIDE, radius=0.1, margin=MARGIN)
    cells = cells or CELLS
    size, ground = (cells * SIDE / CELLS,) * 2, Ground(height=-2.0)
    scene = sheet(cells, size=size, pins=(), rotation=FLAT, capsules=(bar,), ground=ground, self_collision=contact)
    trial.open(with_layers(scene, MANY_LAYERS, MANY_SPACING), far=2.0)
    trial.start()
    stack = Stack(trial, MANY_LAYERS, contact.thickness)
    trial.run(5.0)
    trial.record("gap missing, of half a thickness", stack.missing())
    trial.settle()
    trial.record(INTERSECTIONS, trial.simulation.intersections())
    heights = trial.simulation.positions().reshape(MANY_LAYERS, -1, 3)[:, :, 1]
    trial.record("layers that fell off the bar", int((heights.max(axis=1) < bar.center[1]).sum()), 0)
