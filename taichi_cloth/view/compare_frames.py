"""Two scenes rendered side by side as numbered PNG files, and what each of their frames took."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..errors import BlewUp
from ..files import whole_file
from ..guard import Guard
from ..machine import machine
from ..scene import scene_to_toml
from ..simulation import Simulation
from .draw_list import DrawList
from .frames import Plan, writing_behind
from .sides import TwoPictures, apart, camera_for, partners

REPORT = "compare.json"  # beside the pictures


@dataclass(eq=False)
class Run:
    """What one side did."""

    simulation: Simulation
    ms: list[float] = field(default_factory=list)  # of physics, of each frame
    strain: list[float] = field(default_factory=list)  # largest, after each frame
    places: list[NDArray[np.float64]] = field(default_factory=list)  # [m] (N, 3) after each of the first `kept` frames

    def advance(self, kept: int) -> None:
        start = time.perf_counter()
        self.simulation.advance_frame()
        ti.sync()
        self.ms.append(1e3 * (time.perf_counter() - start))
        self.strain.append(self.simulation.measure().max_strain)
        if len(self.places) < kept:
            self.places.append(self.simulation.positions())


def render_both(
    a: Simulation, b: Simulation, plan: Plan, on_frame: Callable[[int], None], kept: int = 0
) -> tuple[Run, Run, list[float]]:
    """Runs both and writes their pictures. Returns what each did, and how far apart they are after each frame.

    The camera is that of a. The frame that compiles is not among the times: both begin again after it. Raises BlewUp
    where one does, and OSError where a file cannot be written; every PNG is whole then.
    """
    runs, distances = (Run(a), Run(b)), []
    for simulation in (a, b):
        simulation.advance_frame()
        simulation.reset()
    drawn = DrawList(a), DrawList(b)
    try:
        pictures = TwoPictures(plan.width, plan.height, plan.samples)
        partner = partners(a, b)
        camera = camera_for(a.scene, pictures.aspect)
        guards = Guard(a), Guard(b)
        with writing_behind() as write:
            for k in range(plan.frames):
                if k % plan.every == 0:
                    write(plan.path(k // plan.every), pictures.draw(drawn, plan.view, camera))
                for run, guard in zip(runs, guards, strict=True):
                    run.advance(kept)
                    if not guard.sound():
                        raise BlewUp(f"{'ab'[runs.index(run)]}: {guard.restore()}")
                distances.append(apart(a, b, partner))
                on_frame(k)
    finally:
        for one in drawn:
            one.close()
    return *runs, distances


def write_report(plan: Plan, runs: tuple[Run, Run], distances: list[float], more: dict[str, Any]) -> None:
    """`compare.json`: both scenes, and what was measured of every frame."""
    told = {
        name: {"scene": scene_to_toml(run.simulation.scene), "method": run.simulation.method}
        | {"physics_ms": np.round(run.ms, 3).tolist(), "max_strain": run.strain}
        for name, run in zip("ab", runs, strict=True)
    }
    with whole_file(plan.out / REPORT) as file:
        file.write(json.dumps({"machine": machine(), **told, "apart": distances, **more}, indent=1).encode())
