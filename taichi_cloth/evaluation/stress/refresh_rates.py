"""Cases 4, 5 and 6: refresh rates of the display, uneven refreshes, and a pause.

The simulation advances in frames of 1/60 s, independent of the display. `FrameClock` computes how many frames are due
at each refresh of the display, so the refresh rate changes the number of frames per refresh, never the time step.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ...scene.schema import FRAME_SECONDS
from ...viewer.session import Session
from ...viewer.window import FrameClock
from .setup import CELLS, SIDE, sheet
from .trial import Trial

WALL_SECONDS = 10.0
KEPT_SECONDS = 4 * FRAME_SECONDS  # of wall time between two refreshes that the clock keeps; it drops the rest by design
PAUSED_REFRESHES = 100  # display refreshes
SAG_BETWEEN_RATES = 0.02  # relative difference of the sag between two rates


def run_refreshes(trial: Trial, times: Iterable[float]) -> int:
    """Run the frames of a window that refreshes at these wall times [s]. Returns the number of frames."""
    clock, frames = FrameClock(0.0), 0
    for now in times:
        due = clock.due(now)
        frames += due
        for _ in range(due):
            trial.one_frame()
    return frames


def at_rate(rate: float) -> list[float]:
    """Return the wall times of the refreshes [s], at `rate` [Hz]."""
    return [float(k) / rate for k in range(1, round(WALL_SECONDS * rate) + 1)]


def lost_seconds(rate: float) -> float:
    """Return the time that the clock drops by design [s]."""
    return WALL_SECONDS * max(0.0, 1 - KEPT_SECONDS * rate)


def run_all_but(trial: Trial, lost: float, times: Sequence[float]) -> None:
    """Run the frames of these refreshes [s]. They must simulate the wall time but `lost` [s], to within a frame."""
    simulated = run_refreshes(trial, times) * FRAME_SECONDS
    difference = abs(times[-1] - lost - simulated)
    trial.record("simulated time beside the wall's [s]", difference, 1.01 * FRAME_SECONDS)


def frame_rates(trial: Trial, rate: float) -> None:
    """Run ten seconds of wall time at 60 Hz and at another rate. The sag of the sheet must be equal.

    Simulated time must match wall time, minus the time that the clock drops by design.
    """
    sags = []
    for each in (60.0, rate):
        trial.open(sheet(CELLS))
        trial.start()
        run_all_but(trial, lost_seconds(each), at_rate(each))
        sags.append(SIDE / 2 - float(trial.simulation.positions()[:, 1].min()))
        trial.settle()
    trial.record("time dropped by the clock [s]", lost_seconds(rate))
    trial.record("sag beside that at 60 a second, share", abs(sags[1] / sags[0] - 1), SAG_BETWEEN_RATES)


def uneven_rates(trial: Trial) -> None:
    """Alternate intervals of 1/144 s and 1/20 s between refreshes, with one of a full second."""
    trial.open(sheet(CELLS))
    trial.start()
    stall = 1.0
    intervals = [1 / 144, 1 / 20] * 90
    intervals[60] = stall
    run_all_but(trial, stall - KEPT_SECONDS, np.cumsum(intervals).tolist())
    trial.settle()


def paused(trial: Trial) -> None:
    """Refresh 100 times at one wall time while the cloth swings, as the window does: clock, session and drawing.

    The state of the cloth must stay the same to the last bit, and so must the next second, compared with a sheet that
    was not paused.
    """
    x = trial.open(sheet(CELLS))
    trial.start(x * [1, 0, 0] - x[:, [0, 2, 1]] * [0, 0, 1])
    trial.run(0.5)
    simulation = trial.simulation
    session = Session(simulation.scene)
    try:
        session.simulation.set_state(simulation.positions(), simulation.velocities())
        simulation.set_state(simulation.positions(), simulation.velocities())
        before = session.simulation.positions(), session.simulation.velocities()
        clock = FrameClock(0.0)
        for _ in range(PAUSED_REFRESHES):
            session.advance(clock.due(0.0))
            session.measure()
            session.draw_list.update(session.view, session.camera.eye)
        trial.record("numbers that changed while paused", changed(before, session), 0)
        trial.record("frames that passed while paused", session.simulation.frame, 0)
        for _ in range(60):
            session.advance(1)
            trial.one_frame()
        after = simulation.positions(), simulation.velocities()
        trial.record("numbers that a pause changed later", changed(after, session), 0)
    finally:
        session.close()
    trial.settle()


def changed(before: tuple[np.ndarray, np.ndarray], session: Session) -> int:
    """Return how many components of positions and velocities differ from those of the session."""
    now = session.simulation.positions(), session.simulation.velocities()
    return sum(int((a != b).sum()) for a, b in zip(before, now, strict=True))
