"""Cases 15 to 23, 35, 36, 39: colliders, and layers of the cloth."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import radians

import numpy as np

from ..contact.bodies import pose
from ..scene.model import FRAME_SECONDS, Box, Capsule, Forces, Ground, Keyframes, Plane, Scene, Sphere
from .scenes import THICKNESS, off_itself, sheet
from .setting import CELLS
from .trial import Trial
from .watch import Floats

MARGIN = 0.01  # [m]
EJECTED = 2.0  # [m/s] at most, of what a collider suddenly holds


def hung(trial: Trial) -> Scene:
    return sheet(trial.cells, pins=("top",))


# -- a cloth that lies on itself -----------------------------------------------------------------------


def folded(layers: int, cells: int, side: float) -> tuple[Scene, Floats]:
    """One strip in level layers, a cell apart, joined by a riser at either end in turn; and its places."""
    cell = side / cells
    rows = layers * (cells + 1) - 1
    scene = sheet((rows, cells), pins=(), size=(side, rows * cell))
    places = np.zeros((rows + 1, cells + 1, 3))
    places[..., 0] = np.linspace(-side / 2, side / 2, cells + 1)
    for row in range(rows + 1):
        layer, along = divmod(row, cells + 1)
        forth = along if layer % 2 == 0 else cells - along
        places[row, :, 1:] = (-layer + (layers - 1) / 2) * cell, forth * cell - side / 2
    return scene, places.reshape(-1, 3)


def gap(trial: Trial, cells: int) -> float:
    """The least distance between two layers' particles [m]."""
    x = trial.simulation.positions().astype(np.float32)
    layers = x.reshape(-1, (cells + 1) ** 2, 3)
    nearest = np.inf
    for upper, lower in pairwise(layers):
        a, b = upper[: -2 * (cells + 1)], lower[2 * (cells + 1) :]  # without the fold
        squares = (a * a).sum(1)[:, None] + (b * b).sum(1)[None] - 2 * a @ b.T
        nearest = min(nearest, float(squares.min()))
    return float(np.sqrt(max(nearest, 0.0)))


def layers(trial: Trial) -> None:
    """Ten, with a ball that comes down on them."""
    cells = max(4, 10 * trial.cells // CELLS)
    scene, places = folded(10, cells, 1.0)
    ball = Sphere(center=(0.0, 1.4, 0.0), radius=0.3, margin=MARGIN, path=((0.0, 0, 0, 0), (2.0, 0.0, -0.8, 0.0)))
    ground = Ground(height=-0.6, friction=0.4)
    trial.open(replace(scene, spheres=(ball,), ground=ground, self_collision=off_itself(1.0 / cells)), rest=np.inf)
    stack(trial, cells, places, 1.0 / cells)


def many_layers(trial: Trial) -> None:
    """Fifty on a bar."""
    cells = max(2, 4 * trial.cells // CELLS)
    scene, places = folded(50, cells, 0.2)
    bar = Capsule(center=(0.0, -1.4, 0.0), rotation=(0.0, 0.0, 90.0), length=1.0, radius=0.1, margin=MARGIN)
    ground = Ground(height=-2.0)
    apart = off_itself(0.2 / cells)
    trial.open(replace(scene, capsules=(bar,), ground=ground, self_collision=apart), far=2.0, rest=np.inf)
    stack(trial, cells, places, 0.2 / cells)


def stack(trial: Trial, cells: int, places: Floats, cell: float) -> None:
    trial.start(places)
    nearest = np.inf
    for k in range(300):
        trial.one_frame()
        if k % 10 == 9:
            nearest = min(nearest, gap(trial, cells))
    trial.settle()
    trial.tell("gap missing, of half a thickness", 1 - min(nearest, gap(trial, cells)) / (THICKNESS * cell / 2), 0.0)


# -- fast ----------------------------------------------------------------------------------------------


def shot(speed: float, radius: float) -> Sphere:
    """A ball that comes from 1 m before the sheet, stops 0.4 m behind it for half a second, and goes back slowly."""
    way, there = 1.4, 1.4 / speed
    path: Keyframes = ((0.0, 0, 0, 0), (there, 0, 0, way), (there + 0.5, 0, 0, way), (there + 2.5, 0, 0, 0))
    return Sphere(center=(0.0, 0.0, -1.0), radius=radius, margin=MARGIN, path=path)


def run_past(trial: Trial, seconds: float, most: float = np.inf) -> None:
    """Runs on, and no particle may go through the ball, nor one be faster than `most` [m/s].

    It looks after every substep: a frame's straight way may lead through what a particle was flung round.
    """
    simulation = trial.simulation
    [ball] = simulation.scene.spheres
    total = 0
    before = simulation.positions() - pose(ball, simulation.seconds)[0]

    def look(share: float) -> None:
        nonlocal total, before
        start, end = (pose(ball, simulation.seconds + s)[0] for s in (0.0, FRAME_SECONDS))
        after = simulation.positions() - (start + share * (end - start))  # straight on within a frame
        total += went_through(before, after, ball.radius)
        before = after

    for _ in range(round(seconds / FRAME_SECONDS)):
        trial.one_frame(look=look)
        trial.tell("speed [m/s]", trial.watch.speed, most)
        trial.tell("particles that went through the ball", total, 0)


def went_through(before: Floats, after: Floats, radius: float) -> int:
    """How many went, along z, from one side of a ball to the other within half its radius of the middle.

    Places from its middle [m], (N, 3), before and after a substep. What slides around it has farther to go.
    """
    share = before[:, 2] / np.where(before[:, 2] == after[:, 2], np.inf, before[:, 2] - after[:, 2])
    beside = np.linalg.norm(before[:, :2] + share[:, None] * (after - before)[:, :2], axis=1)
    return int(((before[:, 2] * after[:, 2] < 0) & (beside < radius / 2)).sum())


def fast_ball(trial: Trial) -> None:
    speed = trial.one_of((5.0, 20.0, 50.0, 100.0))
    ball = shot(speed, 0.1)
    trial.open(replace(hung(trial), spheres=(ball,)), far=1.0, rest=hung(trial))
    trial.start()
    run_past(trial, 1.4 / speed + 2.6)
    trial.settle()


def small_ball(trial: Trial) -> None:
    ball = shot(20.0, 0.01)
    trial.open(replace(hung(trial), spheres=(ball,)), far=1.0, rest=hung(trial))
    trial.start()
    trial.run(1.4 / 20 + 0.05)
    x = trial.simulation.positions()
    near = np.linalg.norm(x[:, :2], axis=1) < 2 / trial.cells
    trial.tell("whether the ball went through", float(x[near, 2].max() < trial.simulation.bodies()[0].center[2]))
    trial.run(2.6)
    trial.settle()


def fast_cloth(trial: Trial) -> None:
    """A free sheet at 100 m/s meets a ball that stands still."""
    speed = 100.0
    ball = Sphere(center=(0.0, 0.0, 2.0), radius=0.3, margin=MARGIN)
    scene = sheet(trial.cells, pins=(), forces=Forces(gravity=0.0), spheres=(ball,))
    trial.open(scene, rest=np.inf)
    trial.start(velocity=(0.0, 0.0, speed))
    run_past(trial, 1.0, 1.01 * speed)


# -- suddenly there ------------------------------------------------------------------------------------


def engulfed(trial: Trial) -> None:
    ball = Sphere(center=(0.0, 0.0, -0.05), radius=1.0, margin=MARGIN)
    trial.open(sheet(trial.cells, pins=(), forces=Forces(gravity=0.0), spheres=(ball,)), rest=np.inf)
    trial.start()
    for _ in range(300):
        trial.one_frame()
        trial.tell("speed [m/s]", trial.watch.speed, EJECTED)


def teleported(trial: Trial) -> None:
    """From afar into the middle of the sheet, or from a radius of next to nothing."""
    if trial.number % 2:
        ball = Sphere(center=(0.0, 0.0, 0.01), radius=1e-3, margin=MARGIN)
    else:
        path: Keyframes = ((0.5, 0, 0, 0), (0.500001, 0, 0, 5.01))
        ball = Sphere(center=(0.0, 0.0, -5.0), radius=0.3, margin=MARGIN, path=path)
    trial.open(replace(hung(trial), spheres=(ball,)), rest=np.inf)
    trial.start()
    trial.run(0.5 - FRAME_SECONDS)
    if trial.number % 2:
        trial.act(lambda: trial.simulation.set("sphere_radius", 0.5))
    for _ in range(300):
        trial.one_frame()
        trial.tell("speed [m/s]", trial.watch.speed, EJECTED)


def ball_on_pin(trial: Trial) -> None:
    ball = Sphere(center=(-0.5, 0.5 - 0.1, 0.0), radius=0.15, margin=0.0)
    trial.open(sheet(trial.cells, spheres=(ball,)), rest=np.inf)
    trial.start()
    trial.settle()


def squeeze(trial: Trial) -> None:
    """Two balls close on the sheet until they touch, and go on into each other for 0.1 m; then they leave."""
    free = hung(trial)
    reach = 0.3 + MARGIN
    path: Keyframes = ((0.0, 0, 0, 0), (1.0, 0, 0, 0.5 + 0.05), (2.0, 0, 0, 0.55), (3.0, 0, 0, 0))
    back: Keyframes = tuple((t, x, y, -z) for t, x, y, z in path)
    first = Sphere(center=(0.0, -0.1, -0.5 - reach), radius=0.3, margin=MARGIN, path=path)
    other = Sphere(center=(0.0, -0.1, 0.5 + reach), radius=0.3, margin=MARGIN, path=back)
    trial.open(replace(free, spheres=(first, other)), rest=free)
    trial.start()
    trial.run(3.0)
    trial.settle()


# -- friction ------------------------------------------------------------------------------------------


def friction(trial: Trial) -> None:
    """Slopes of 30° and 89°, and a minute on the floor."""
    mu, slope = trial.one_of(
        ((0.0, 30.0), (1.0, 30.0), (10.0, 30.0), (1e6, 30.0), (1.0, 89.0), (1e6, 89.0), (0.5, 0.0))
    )
    plane = Plane(center=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, -slope), margin=MARGIN, friction=mu)
    up = np.array([np.sin(radians(slope)), np.cos(radians(slope)), 0.0])
    scene = sheet(trial.cells // 2, pins=(), rotation=(-90.0, 0.0, -slope), planes=(plane,))
    middle = (float(MARGIN * up[0]), float(MARGIN * up[1]), 0.0)
    trial.open(replace(scene, cloth=replace(scene.cloth, center=middle)), rest=np.inf)
    trial.simulation.reset()
    trial.watch.begin()
    trial.run(1.0)
    before = trial.simulation.positions()
    trial.run(60.0 if slope == 0 else 9.0)
    if mu > np.tan(radians(slope)):
        moved = np.linalg.norm(trial.simulation.positions() - before, axis=1).max()
        trial.tell("creep [m]", float(moved), 1e-3)


def rotating_ball(trial: Trial) -> None:
    """A sheet falls on a ball that turns about its upright axis."""
    rate = 180.0
    ball = Sphere(center=(0.0, -0.35, 0.0), radius=0.3, margin=MARGIN, friction=0.4, spin=(0.0, rate, 0.0))
    scene = sheet(trial.cells, pins=(), rotation=(-90.0, 0.0, 0.0), spheres=(ball,), ground=Ground(height=-1.2))
    trial.open(scene, rest=np.inf)
    trial.start()
    trial.run(2.0)
    for _ in range(480):
        trial.one_frame()
        x, v = trial.simulation.positions(), trial.simulation.velocities()
        across = np.hypot(x[:, 0], x[:, 2])
        spin = (x[:, 2] * v[:, 0] - x[:, 0] * v[:, 2]) @ trial.simulation.topology.mass
        inertia = across**2 @ trial.simulation.topology.mass
        trial.tell("rate of the sheet, of the ball's", float(spin / inertia / radians(rate)), 1.1)


def tablecloth(trial: Trial) -> None:
    """Pulled by an edge at 1 m/s over a table, from under a ball that touches it."""
    mu = 0.3
    table = Box(center=(0.0, -0.1, 0.0), size=(1.6, 0.2, 1.6), margin=MARGIN, friction=mu)
    ball = Sphere(center=(0.2, 0.1 + 2 * MARGIN, 0.0), radius=0.1, margin=MARGIN, friction=mu)
    scene = sheet(trial.cells, pins=("right",), rotation=(-90.0, 0.0, 0.0), boxes=(table,), spheres=(ball,))
    scene = replace(scene, cloth=replace(scene.cloth, center=(0.0, MARGIN, 0.0)))
    x = trial.open(scene, rest=np.inf)
    trial.start()
    trial.run(0.5)
    edge = x[trial.simulation.topology.pinned]
    for k in range(1, 31):
        trial.lead_pins(edge + [k * FRAME_SECONDS, 0, 0])
        trial.one_frame()
    trial.settle()
