"""How long frames take."""

from __future__ import annotations

import time

from .simulation import Simulation


def timed_frame(simulation: Simulation) -> float:
    """Milliseconds of one frame."""
    import taichi as ti

    start = time.perf_counter()
    simulation.advance_frame()
    ti.sync()
    return 1e3 * (time.perf_counter() - start)


def frames(simulations: list[Simulation], count: int, seconds: float) -> list[list[float]]:
    """Times of frames, of all simulations in turn, so that a slow moment of the machine meets all alike."""
    ms: list[list[float]] = [[] for _ in simulations]
    end = time.perf_counter() + seconds
    while len(ms[0]) < count and (not ms[0] or time.perf_counter() < end):
        for simulation, times in zip(simulations, ms, strict=True):
            times.append(timed_frame(simulation))
    return ms
