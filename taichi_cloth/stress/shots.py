"""Cases 17 to 19: balls and sheets that are fast."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..contact.bodies import pose
from ..scene.model import FRAME_SECONDS, Forces, Keyframes, Scene, Sphere
from .scenes import sheet
from .setting import CELLS
from .trial import Trial
from .watch import ROUNDING, Floats

MARGIN = 0.01  # [m]
BEFORE, BEHIND = 1.0, 0.4  # [m] of the sheet: where a ball comes from, and where it stops


def hung() -> Scene:
    return sheet(CELLS, pins=("top",))


def shot(speed: float, radius: float, against: str = "particles") -> Sphere:
    """A ball that comes from before the sheet, stops behind it for half a second, and goes back slowly."""
    way, there = BEFORE + BEHIND, (BEFORE + BEHIND) / speed
    path: Keyframes = ((0.0, 0, 0, 0), (there, 0, 0, way), (there + 0.5, 0, 0, way), (there + 2.5, 0, 0, 0))
    return Sphere(center=(0.0, 0.0, -BEFORE), radius=radius, margin=MARGIN, path=path, against=against)


def run_past(trial: Trial, seconds: float, most: float | None = None) -> None:
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
    """How many crossed the plane through a ball's middle, across z, within its radius: inside the ball.

    Places from its middle [m], (N, 3), before and after a substep.
    """
    share = before[:, 2] / np.where(before[:, 2] == after[:, 2], np.inf, before[:, 2] - after[:, 2])
    beside = np.linalg.norm(before[:, :2] + share[:, None] * (after - before)[:, :2], axis=1)
    return int(((before[:, 2] * after[:, 2] < 0) & (beside < radius)).sum())


def fast_ball(trial: Trial, speed: float) -> None:
    trial.open(replace(hung(), spheres=(shot(speed, 0.1),)), far=1.0, rest=hung())
    trial.start()
    run_past(trial, (BEFORE + BEHIND) / speed + 2.6)
    trial.settle()


def small_ball(trial: Trial, against: str) -> None:
    """A ball smaller than a cell, against particles alone or against triangles. It is told whether it went through."""
    x = trial.open(replace(hung(), spheres=(shot(20.0, 0.01, against),)), far=1.0, rest=hung())
    near = np.linalg.norm(x[:, :2], axis=1) < 2 / CELLS
    trial.start()
    trial.run((BEFORE + BEHIND) / 20 + 0.05)
    behind = float(trial.simulation.positions()[near, 2].max()) < trial.simulation.bodies()[0].center[2]
    trial.tell("whether the ball went through", float(behind))
    trial.run(2.6)
    trial.settle()


def fast_cloth(trial: Trial) -> None:
    """A free sheet at 100 m/s meets a ball that stands still. Nothing is ever faster than what was thrown."""
    ball = Sphere(center=(0.0, 0.0, 2.0), radius=0.3, margin=MARGIN)
    trial.open(sheet(CELLS, pins=(), forces=Forces(gravity=0.0), spheres=(ball,)))
    trial.start(velocity=(0.0, 0.0, 100.0))
    thrown = float(np.linalg.norm(trial.simulation.velocities(), axis=1).max())
    run_past(trial, 5.0, thrown * (1 + 4 * ROUNDING))
    trial.settle()
