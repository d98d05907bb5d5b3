"""Cost of each feature of a running cloth: times of frames with all features and without one, from the current frame.

All features of a frame run in one kernel, so no timer can separate them. A scene without a feature is another kernel,
which is compiled first. Both scenes run on copies of the cloth. `taichi-cloth ablate` measures costs with the same
function, `feature_cost`, from the end of a motion. `bench --features` times more than two scenes at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median

import numpy as np

from ..scene import parameters_of
from ..scene.overrides import removable_sections, scene_without
from ..simulation.running_cloth import time_frames
from ..simulation.simulation import Simulation

FRAMES, SECONDS = 60, 0.5  # limits for one feature: frames of each copy, and wall time [s]


@dataclass(frozen=True)
class FeatureTimes:
    """Median frame times [ms]."""

    frame: int
    """Number of the first frame that was timed."""
    ms: float
    """A frame with all features [ms]."""
    cost_ms: dict[str, float]
    """The time that a frame saves without a feature [ms], by feature; negative if it takes longer."""


def feature_times(running: Simulation, layout: str | None = None) -> FeatureTimes:
    """Time every feature that the running scene can do without. The running simulation does not change.

    `layout`: the layout, as for `Simulation`. Raises UsageError if the scene cannot run without one of them.
    """
    cost_ms, all_ms = {}, []
    with Simulation(running.scene, layout) as full:
        full.step()  # compiles
        for feature in removable_sections(running.scene):
            with Simulation(scene_without(running.scene, [feature]), layout) as reduced:
                reduced.step()
                for copy in (full, reduced):
                    take_over(copy, running)
                ms, cost_ms[feature] = feature_cost(full, reduced, FRAMES, SECONDS)
            all_ms.append(ms)
    return FeatureTimes(running.frame, median(all_ms) if all_ms else 0.0, cost_ms)


def feature_cost(full: Simulation, reduced: Simulation, frames: int, seconds: float) -> tuple[float, float]:
    """Return the median frame time of `full` [ms], and how much of it `reduced`, without a feature, saves [ms].

    Both run up to `frames` frames for about `seconds` [s] in all. They take turns, so that a busy period of the machine
    affects both equally.
    """
    with_feature, without = (median(times) for times in time_frames([full, reduced], frames, seconds))
    return with_feature, with_feature - without


def take_over(copy: Simulation, running: Simulation) -> None:
    """Copy the state of the running cloth with its parameters, pins and torn springs, but not its grabs."""
    for index in np.flatnonzero(copy.topology.pinned != running.topology.pinned):
        (copy.pin if running.topology.pinned[index] else copy.unpin)(int(index))
    for name in parameters_of(copy.scene).keys() & parameters_of(running.scene).keys():
        copy.params[name] = running.params[name]
    copy.untear(running.torn)
    copy.params["wind"] = running.params["wind"]
    copy.frame = running.frame
    copy.set_state(running.positions(), running.velocities())
