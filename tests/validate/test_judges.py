"""A simulation whose state is noise makes every row of a reference fall short, each measured with one solver."""

from __future__ import annotations

from itertools import count
from pathlib import Path

import numpy as np
import pytest
from rows import name_of

from taichi_cloth.evaluation.validate.check import FAIL, Reference, Result, measure
from taichi_cloth.evaluation.validate.references import REFERENCES
from taichi_cloth.evaluation.validate.validation_report import read_json
from taichi_cloth.simulation.simulation import Simulation

DRAPE = "A4.6"  # rasterizes the shadow, which noise makes too large for memory: test_drape.py tests its judge

# Simulated frames of all setups of a reference, with the solver that `test_noise_falls_short_in_every_row` uses.
FRAMES = {
    "A1.1": 60,
    "A1.2": 60,
    "A1.3": 96,
    "A1.4": 60,
    "A1.5": 600,
    "A1.6": 35,
    "A1.7": 60,
    "A2.1": 1199,
    "A2.2": 300,
    "A2.3": 1732,
    "A2.4": 174,
    "A2.5": 1854,
    "A2.6": 95,
    "A2.7": 60,
    "A2.8": 12149,
    "A3.1": 3000,
    "A3.2": 7200,
    "A3.3": 7920,
    "A3.4": 8640,
    "A3.5": 1800,
    "A4.1": 1200,
    "A4.2": 2400,
    "A4.3": 7800,
    "A4.4": 720,
    "A4.5": 3000,
    "A5.1": 3600,
    "A5.2": 720,
    "A6.1": 900,
    "A6.2": 2880,
    "A7.1": 219,
    "A7.2": 602,
    "A7.3": 4740,
    "A7.4": 1620,
    "A7.5": 1440,
    "A8.1": 714,
    "A8.2": 60,
    "A8.3": 30,
    "A8.4": 150,
    "A8.5": 120,
    "A8.6": 357,
    "A8.7": 2880,
    "A8.8": 120,
    "A8.9": 180,
    "A8.10": 60,
    "A9.1": 2160,
    "A9.2": 1440,
    "A9.3": 2160,
    "A9.4": 3720,
    "A9.5": 1200,
    "A9.7": 3280,
    "A9.8": 8640,
    "B1": 180,
    "B3": 7200,
    "B4": 1158,
    "B5": 300,
    "B6.1": 600,
    "B6.2": 60,
    "B6.3": 60,
}


def noise_of(particles: int, seed: int) -> np.ndarray:
    """Return noise, (particles, 3): half a meter for half of the particles, and some meters for the others."""
    near = np.arange(particles)[:, None] < particles // 2
    random = np.random.default_rng(seed)
    return np.where(near, random.normal(0.3, 0.5, (particles, 3)), random.normal(3.0, 1.0, (particles, 3)))


@pytest.fixture
def noise(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Steps move nothing, and are counted in the list. After one, positions, velocities and reaction forces have noise.

    It is another at every call.
    """
    calls, counted = count(), [0]

    def step(self: Simulation, frames: int = 1) -> None:
        counted[0] += frames
        self.set_frame(self.frame + frames)

    def disturb(name: str) -> None:
        read = getattr(Simulation, name)

        def disturbed(self: Simulation) -> np.ndarray:
            values: np.ndarray = read(self)
            return values + noise_of(len(values), next(calls)) if self.frame > 0 else values

        monkeypatch.setattr(Simulation, name, disturbed)

    monkeypatch.setattr(Simulation, "step", step)
    for name in ("positions", "velocities", "reaction_forces"):
        disturb(name)
    return counted


@pytest.fixture(scope="module")
def stored() -> list[Result]:
    return read_json(Path(__file__).parents[2] / "benchmarks" / "results" / "validation.json").results


@pytest.mark.parametrize("reference", [one for one in REFERENCES if one.number != DRAPE], ids=lambda one: one.number)
def test_noise_falls_short_in_every_row(reference: Reference, noise: list[int], stored: list[Result]) -> None:
    """No setup runs for a shorter time than it should, and the stored run has the same rows with the same bounds."""
    solver = "explicit" if "explicit" in reference.solvers else reference.solvers[0]
    results = measure(reference, solver)
    assert results
    assert noise == [FRAMES[reference.number]]
    assert [result.row.what for result in results if result.row.verdict != FAIL] == []
    kept = [result for result in stored if (result.number, result.solver) == (reference.number, solver)]
    assert list(map(bounds_of, kept)) == list(map(bounds_of, results))


def bounds_of(result: Result) -> tuple[str, float, float]:
    """Return the name of a row and its bounds."""
    return name_of(result), result.row.tolerance, result.row.tight_tolerance
