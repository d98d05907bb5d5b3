"""Cases 20 to 23: balls that are where the cloth is."""

from __future__ import annotations

from dataclasses import replace
from math import hypot, sqrt

import numpy as np

from ..measure.cloth import spring_strains
from ..scene.model import FRAME_SECONDS, Forces, Keyframes, Sphere
from .rest import static_strain
from .scenes import SIDE, sheet
from .setting import CELLS
from .shots import MARGIN, hung
from .trial import CALM_STRAIN, Trial
from .watch import Floats

EJECTED = 2.0  # [m/s] at most, of what a collider suddenly holds
DEPTH = 0.05  # [m] of a pin within a ball


def watch_ejection(trial: Trial, seconds: float) -> None:
    """Runs on, and nothing may be thrown out."""
    for _ in range(round(seconds / FRAME_SECONDS)):
        trial.one_frame()
        trial.tell("speed [m/s]", trial.watch.speed, EJECTED)


def engulfed(trial: Trial) -> None:
    """A ball of 1 m is around all of a free sheet."""
    ball = Sphere(center=(0.0, 0.0, -0.05), radius=1.0, margin=MARGIN)
    trial.open(sheet(CELLS, pins=(), forces=Forces(gravity=0.0), spheres=(ball,)))
    trial.start()
    watch_ejection(trial, 8.0)
    trial.settle()


def teleported(trial: Trial) -> None:
    """A ball is within a frame in the middle of the sheet, from 5 m away, and six seconds later as far away again.

    So the sheet ends as it hangs by itself: what it would come to on the ball no independent code tells.
    """
    path: Keyframes = ((0.5, 0, 0, 0), (0.500001, 0, 0, 5.01), (6.5, 0, 0, 5.01), (6.500001, 0, 0, 0))
    ball = Sphere(center=(0.0, 0.0, -5.0), radius=0.3, margin=MARGIN, path=path)
    trial.open(replace(hung(), spheres=(ball,)), rest=hung())
    trial.start()
    watch_ejection(trial, 6.5)
    trial.run(3.0)
    trial.settle()


def inflated(trial: Trial) -> None:
    """A ball of 1 mm amid the sheet has a radius of 0.5 m in the next frame, and is small again after six seconds."""
    ball = Sphere(center=(0.0, 0.0, 0.01), radius=1e-3, margin=MARGIN)
    trial.open(replace(hung(), spheres=(ball,)), rest=hung())
    trial.start()
    watch_ejection(trial, 0.5)
    trial.act(lambda: trial.simulation.set("sphere_radius", 0.5))
    watch_ejection(trial, 6.0)
    trial.act(lambda: trial.simulation.set("sphere_radius", 1e-3))
    trial.run(3.0)
    trial.settle()


def beside_pin(radius: float, depth: float, cell: float) -> float:
    """Strain of the threads from a pin that is `depth` within a ball to the nearest places on its surface [m].

    Two neighbours lie there, as far from each other as a diagonal is long.
    """
    aside = cell / sqrt(2)
    up = sqrt(radius**2 - aside**2) - (radius - depth)
    return hypot(aside, up) / cell - 1


def ball_on_pin(trial: Trial) -> None:
    """A pinned corner is 5 cm within a ball. It stays, and its neighbours come to rest on the ball.

    Their threads are longer than at rest: `beside_pin` is added to the static strain there, and nowhere else.
    """
    radius, cell = 0.15, SIDE / CELLS
    ball = Sphere(center=(-SIDE / 2, SIDE / 2 - (radius - DEPTH), 0.0), radius=radius, margin=0.0)
    free = sheet(CELLS)
    bound = static_strain(trial.setting.of(free)) + CALM_STRAIN
    trial.open(replace(free, spheres=(ball,)), rest_strain=bound + beside_pin(radius, DEPTH, cell))
    trial.start()
    trial.run(5.0)
    trial.settle()
    trial.tell("strain off the ball", strain_off(trial, np.array(ball.center), radius + cell), bound)


def strain_off(trial: Trial, center: Floats, away: float) -> float:
    """Largest of the threads both of whose ends are so far [m] from a point."""
    topology, x = trial.simulation.topology, trial.simulation.positions()
    threads = topology.family("structural")
    off = (np.linalg.norm(x - center, axis=1) > away)[topology.ends[threads]].all(axis=1)
    return float(spring_strains(topology, x)[threads][off].max())


def squeeze(trial: Trial) -> None:
    """Two balls of 0.3 m close on the sheet until they touch, and go on into each other for 0.1 m; then they leave."""
    radius, away = 0.3, 0.5
    touching = away - radius  # [m] of each one's way
    path: Keyframes = (
        (0.0, 0, 0, 0),
        (1.0, 0, 0, touching),
        (1.5, 0, 0, touching),
        (2.0, 0, 0, touching + 0.05),
        (2.5, 0, 0, touching + 0.05),
        (3.5, 0, 0, 0),
    )
    back: Keyframes = tuple((t, x, y, -z) for t, x, y, z in path)
    first = Sphere(center=(0.0, -0.1, -away), radius=radius, margin=MARGIN, path=path)
    other = Sphere(center=(0.0, -0.1, away), radius=radius, margin=MARGIN, path=back)
    trial.open(replace(hung(), spheres=(first, other)), rest=hung())
    trial.start()
    trial.run(3.5)
    trial.settle()
