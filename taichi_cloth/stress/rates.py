"""Cases 4 to 6 and 32: how often pictures are made, and for how long.

The program advances in frames of 1/60 s whatever a display does: `FrameClock` decides how many of them are due at each
picture. So a display's rate changes the number of frames a picture, never the step.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..scene.model import FRAME_SECONDS
from ..view.clock import MOST_FRAMES, FrameClock
from ..view.session import Session
from .scenes import DAMPING, SIDE, sheet
from .setting import CELLS
from .trial import Trial

WALL_SECONDS = 10.0
PAUSED_PICTURES = 100
SAG = 0.02  # by how much the sag may differ between two rates, as a share
HANGING_FRAMES, SWINGING_FRAMES = 3_600, 3_600  # of the long run, where `--long` does not ask for more
LONG_HANGING, LONG_SWINGING = 1_000_000, 100_000
DRIFT = 1e-4  # of the side, in all frames of a long run


def pictures(trial: Trial, times: Iterable[float]) -> int:
    """Runs what a window would that makes pictures at these wall times [s]; returns the number of frames."""
    clock, frames = FrameClock(0.0), 0
    for now in times:
        due = clock.due(now)
        frames += due
        for _ in range(due):
            trial.one_frame()
    return frames


def at_rate(rate: float) -> list[float]:
    """Wall times [s] of the pictures."""
    return [float(k) / rate for k in range(1, round(WALL_SECONDS * rate) + 1)]


def lost_seconds(rate: float) -> float:
    """What the clock drops by design [s]: it never makes more than `MOST_FRAMES` frames for one picture."""
    return WALL_SECONDS * max(0.0, 1 - MOST_FRAMES * FRAME_SECONDS * rate)


def frame_rates(trial: Trial, rate: float) -> None:
    """Ten seconds by the wall clock at 60 pictures a second and at another rate: the sheet hangs equally low.

    Simulated time keeps up with the wall, to a frame, but for what the clock drops by design.
    """
    sags = []
    for each in (60.0, rate):
        trial.open(sheet(CELLS))
        trial.start()
        simulated = pictures(trial, at_rate(each)) * FRAME_SECONDS
        behind = abs(WALL_SECONDS - lost_seconds(each) - simulated)
        trial.tell("simulated time beside the wall's [s]", behind, 1.01 * FRAME_SECONDS)
        sags.append(SIDE / 2 - float(trial.simulation.positions()[:, 1].min()))
        trial.settle()
    trial.tell("time dropped by the clock [s]", lost_seconds(rate))
    trial.tell("sag beside that at 60 a second, share", abs(sags[1] / sags[0] - 1), SAG)


def uneven_rates(trial: Trial) -> None:
    """Pictures 1/144 s and 1/20 s apart by turns, and once a second passes without one."""
    trial.open(sheet(CELLS))
    trial.start()
    gaps = [1 / 144, 1 / 20] * 90
    gaps[60] = 1.0
    pictures(trial, np.cumsum(gaps).tolist())
    trial.settle()


def paused(trial: Trial) -> None:
    """100 pictures at one wall time, in mid swing, as the window makes them: the clock, the session and its drawing.

    Not a bit of the cloth may change, nor of the second that follows: it is compared with a sheet that was not paused.
    """
    x = trial.open(sheet(CELLS))
    trial.start(x * [1, 0, 0] - x[:, [0, 2, 1]] * [0, 0, 1])
    trial.run(0.5)
    simulation = trial.simulation
    session = Session(simulation.scene)
    try:
        session.simulation.place(simulation.positions(), simulation.velocities())
        simulation.place(simulation.positions(), simulation.velocities())
        before = session.simulation.positions(), session.simulation.velocities()
        clock = FrameClock(0.0)
        for _ in range(PAUSED_PICTURES):
            session.advance(clock.due(0.0))
            session.measure()
            session.draw_list.update(session.view, session.camera.eye)
        trial.tell("numbers that changed while paused", changed(before, session), 0)
        trial.tell("frames that passed while paused", session.simulation.frame, 0)
        for _ in range(60):
            session.advance(1)
            trial.one_frame()
        after = simulation.positions(), simulation.velocities()
        trial.tell("numbers that a pause changed later", changed(after, session), 0)
    finally:
        session.close()
    trial.settle()


def changed(before: tuple[np.ndarray, np.ndarray], session: Session) -> int:
    """How many numbers of places and velocities are others now."""
    now = session.simulation.positions(), session.simulation.velocities()
    return sum(int((a != b).sum()) for a, b in zip(before, now, strict=True))


def hanging(trial: Trial, frames: int) -> None:
    """A sheet at rest may not drift."""
    trial.open(sheet(CELLS))
    trial.start()
    trial.settle()
    trial.run(15.0)
    before = trial.simulation.positions()
    for _ in range(frames):
        trial.one_frame()
    trial.tell("drift [m]", float(np.abs(trial.simulation.positions() - before).max()), DRIFT * SIDE)
    trial.settle()


def swinging(trial: Trial, frames: int) -> None:
    """A sheet without damping may not gain energy; then it is damped, and comes to rest."""
    trial.open(sheet(CELLS, pins=("top",), damping=0.0, rotation=(30.0, 0.0, 0.0)))
    trial.start()
    for _ in range(frames):
        trial.one_frame()
    trial.simulation.set("damping", DAMPING)
    trial.run(5.0)
    trial.settle()
