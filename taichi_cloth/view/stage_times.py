"""What each stage of a running cloth costs: frames from here on with all of them, beside frames without that one.

A frame is one kernel, in which no clock can tell stages apart; and a scene without a stage is another kernel, which is
compiled first. Both run on copies. `taichi-cloth ablate` and `bench --stages` do the same from the command line.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median

import numpy as np

from ..scene import live_keys
from ..scene.leave_out import may_do_without, scene_without
from ..simulation import Simulation
from ..timing import frames

FRAMES, SECONDS = 60, 0.5  # of a pair, at most


@dataclass(frozen=True)
class StageTimes:
    """Medians [ms], from one frame on."""

    frame: int  # the first
    ms: float  # of a frame with all stages
    less: dict[str, float]  # that it takes without each


def stage_times(running: Simulation, path: str | None = None) -> StageTimes:
    """Times what the scene that runs can do without. `path` as for `Simulation`; nothing that runs changes.

    Raises WrongUse where a scene without one of them cannot be run.
    """
    less, all_ms = {}, []
    with Simulation(running.scene, path) as whole:
        whole.advance_frame()  # compiles
        for stage in may_do_without(running.scene):
            with Simulation(scene_without(running.scene, [stage]), path) as other:
                other.advance_frame()
                for copy in (whole, other):
                    take_over(copy, running)
                with_it, without = (median(times) for times in frames([whole, other], FRAMES, SECONDS))
            all_ms.append(with_it)
            less[stage] = with_it - without
    return StageTimes(running.frame, median(all_ms) if all_ms else 0.0, less)


def take_over(copy: Simulation, running: Simulation) -> None:
    """Puts a copy where the running cloth is, with its parameters, its pins and its tears, but for its hand."""
    for index in np.flatnonzero(copy.topology.pinned != running.topology.pinned):
        copy.pin(int(index), on=bool(running.topology.pinned[index]))
    for name in live_keys(copy.scene).keys() & live_keys(running.scene).keys():
        copy.set(name, running.get(name))
    copy.mend(running.torn)
    copy.set("wind", running.get("wind"))
    copy.frame = running.frame
    copy.place(running.positions(), running.velocities())
