"""Tests do not use the cache folder of the user. Solutions with a known error."""

from collections.abc import Iterator

import numpy as np
import pytest

from taichi_cloth.evaluation.reference.solution import Solution
from taichi_cloth.scene import Scene
from taichi_cloth.simulation.simulation import Simulation


@pytest.fixture(autouse=True, scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


def off_once(scene: Scene, frames: int, frame: int, error: float, uncertainty: float, side: float) -> Solution:
    """Return the motion that the scene's solver computes, but for one particle in one frame.

    There the solution is off by `error`, and its coarser run by `uncertainty` more, as shares of the side [m].
    """
    with Simulation(scene) as simulation:
        positions = []
        for _ in range(frames):
            simulation.step()
            positions.append(simulation.positions())
    finer = np.array(positions)
    finer[frame, -1, 2] += error * side
    coarser = finer.copy()
    coarser[frame, -1, 2] += uncertainty * side
    return Solution(finer, coarser, side)
