"""A simulation whose state is noise makes every row of a reference fall short, each measured with one solver."""

from __future__ import annotations

import re
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.evaluation.validate.check import FAIL, Reference, Result, measure
from taichi_cloth.evaluation.validate.references import REFERENCES
from taichi_cloth.evaluation.validate.validation_report import read_json
from taichi_cloth.simulation.simulation import Simulation

DRAPE = "A4.6"  # rasterizes the shadow, which noise makes too large for memory: test_drape.py tests its judge


def noise_of(particles: int, seed: int) -> np.ndarray:
    """Return noise, (particles, 3): half a meter for half of the particles, and some meters for the others."""
    near = np.arange(particles)[:, None] < particles // 2
    random = np.random.default_rng(seed)
    return np.where(near, random.normal(0.3, 0.5, (particles, 3)), random.normal(3.0, 1.0, (particles, 3)))


@pytest.fixture
def noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps move nothing. After one, positions, velocities and reaction forces have noise, another at every call."""
    calls = count()

    def step(self: Simulation, frames: int = 1) -> None:
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


@pytest.fixture(scope="module")
def stored() -> list[Result]:
    return read_json(Path(__file__).parents[2] / "benchmarks" / "results" / "validation.json").results


@pytest.mark.parametrize("reference", [one for one in REFERENCES if one.number != DRAPE], ids=lambda one: one.number)
def test_noise_falls_short_in_every_row(reference: Reference, noise: None, stored: list[Result]) -> None:
    """The stored run has the same rows with the same bounds."""
    solver = "explicit" if "explicit" in reference.solvers else reference.solvers[0]
    results = measure(reference, solver)
    assert results
    assert [result.row.what for result in results if result.row.verdict != FAIL] == []
    kept = [result for result in stored if (result.number, result.solver) == (reference.number, solver)]
    assert list(map(bounds_of, kept)) == list(map(bounds_of, results))


def bounds_of(result: Result) -> tuple[str, float, float]:
    """Return the name of a row, without what was measured or when an error was largest, and its bounds."""
    row = result.row
    return re.sub(r" \(.*% lost\)| at frame \d+| after [\d.]+ s$", "", row.what), row.tolerance, row.tight_tolerance
