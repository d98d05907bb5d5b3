"""Cases 1 to 6: constants, masses and time."""

from __future__ import annotations

import numpy as np

from ..scene.model import FRAME_SECONDS
from ..view.clock import FrameClock
from .scenes import DENSITY, sheet
from .trial import Trial

WEIGHT = DENSITY * 9.81  # [N]


def stiffness_sweep(trial: Trial) -> None:
    """Where springs have no constant: shares from 0.1 to 1."""
    decade = trial.number % 10
    constant = 10.0**decade
    trial.open(sheet(trial.cells, constant=constant, share=(decade + 1) / 10), far=8 * WEIGHT / constant)
    trial.start()
    for _ in range(300):
        trial.one_frame()
        trial.tell("speed [m/s]", trial.watch.speed, 20.0)
    trial.settle()


def stiffness_ratio(trial: Trial) -> None:
    """Half of the springs, those down the columns, are stiffer."""
    trial.open(sheet(trial.cells, warp=1000 * trial.one_of((1e4, 1e6))))
    trial.start()
    trial.settle()


def mass_ratio(trial: Trial) -> None:
    """A weight on every corner, in masses of a particle inside."""
    times = trial.one_of((10, 100, 1000, 10_000))
    scene = sheet(trial.cells)
    particle = DENSITY / trial.cells**2
    trial.open(sheet(trial.cells, weight=times * particle), far=4 * times * particle * 9.81 / scene.fabric.warp)
    trial.start()
    trial.settle()
    trial.tell("strain", trial.watch.strain)


def pictures(trial: Trial, times: list[float]) -> None:
    """What a window does that shows pictures at these wall times [s]."""
    clock = FrameClock(0.0)
    for now in times:
        for _ in range(clock.due(now)):
            trial.one_frame()


def frame_rates(trial: Trial) -> None:
    rate = trial.one_of((240, 120, 60, 30, 10))
    trial.open(sheet(trial.cells))
    trial.start()
    pictures(trial, list(np.arange(1, 10 * rate + 1) / rate))
    low = trial.simulation.positions()[:, 1].min()
    trial.settle()
    after = trial.simulation.positions()[:, 1].min()
    trial.tell("change of the sag after 10 s, share", abs(after - low) / abs(after), 0.02)


def uneven_rates(trial: Trial) -> None:
    """Pictures 1/144 s and 1/20 s apart by turns, and once a second passes without one."""
    trial.open(sheet(trial.cells))
    trial.start()
    gaps = [1 / 144, 1 / 20] * 90
    gaps[60] = 1.0
    pictures(trial, list(np.cumsum(gaps)))
    trial.settle()


def paused(trial: Trial) -> None:
    """100 pictures at one wall time, in mid swing."""
    trial.open(sheet(trial.cells))
    trial.start(trial.simulation.topology.start * [1, 0, 0] - trial.simulation.topology.start[:, [0, 2, 1]] * [0, 0, 1])
    trial.run(0.5)
    before = trial.simulation.positions(), trial.simulation.velocities()
    clock = FrameClock(0.0)
    frames = 0
    for _ in range(100):
        frames += clock.due(0.0)
        trial.simulation.measure()
        trial.simulation.bodies()
    after = trial.simulation.positions(), trial.simulation.velocities()
    changed = sum(int((a != b).sum()) for a, b in zip(before, after, strict=True)) + frames
    trial.tell("numbers that changed while paused", changed, 0)
    trial.settle()


def long_run(trial: Trial, frames: int = 10_000) -> None:
    """81 particles: hanging, they may not drift; swinging without damping, they may not gain."""
    if trial.number % 2:
        trial.open(sheet(8, pins=("top",), damping=0.0, rotation=(30.0, 0.0, 0.0)))
        trial.start()
        trial.run(frames * FRAME_SECONDS)
        return
    trial.open(sheet(8))
    trial.start()
    trial.settle()
    trial.run(15.0)
    before = trial.simulation.positions()
    for _ in range(frames):
        trial.one_frame()
    trial.tell("drift [m]", float(np.abs(trial.simulation.positions() - before).max()), 1e-4)
