"""What rows measure: hand-made cloth in a margin and compressed cloth fall short."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import sqrt

import numpy as np
import pytest

from taichi_cloth.evaluation.validate import check, elasticity, flight, friction, swing
from taichi_cloth.evaluation.validate.check import EXCELLENT, FAIL, PASS, Check, base
from taichi_cloth.evaluation.validate.exact import buckled, spring_amplitude
from taichi_cloth.scene.schema import Forces
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.usefixtures("serial_layout")


@pytest.mark.parametrize(
    ("depth", "verdict"), [(-1e-6, EXCELLENT), (0.0015, PASS), (0.003, FAIL), (0.03, FAIL), (np.nan, FAIL)]
)
def test_cloth_in_the_margin_of_a_ball_is_in_its_thickness(
    depth: float, verdict: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The ball reaches up to y = −0.05 m and its margin of 0.02 m to −0.03 m: cloth may be 2 mm below that."""

    def advance(simulation: Simulation, seconds: float) -> None:
        x = simulation.topology.start.copy()
        x[:, 1] = -0.03 - depth
        simulation.set_state(x) if np.isfinite(depth) else monkeypatch.setattr(simulation, "positions", lambda: x)

    monkeypatch.setattr(friction, "advance", advance)
    monkeypatch.setattr(friction, "still", lambda simulation, on: iter(()))
    *_, row = friction.resting("explicit")
    assert row.what == "depth in a ball, of the thickness"
    assert row.error == pytest.approx(max(depth, 0.0) / 0.02, abs=1e-5, nan_ok=True)
    assert row.verdict == verdict


def test_cloth_at_rest_has_the_kinetic_energy_of_all_particles_and_the_motion_of_the_fastest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One particle of a sheet of 1 kg moves at 1 mm/s, and 0.1 mm in the frame."""
    with Simulation(replace(base("explicit"), forces=Forces(gravity=0.0))) as simulation:
        corner_mass = float(simulation.topology.mass[0])

        def step() -> None:
            x, v = simulation.positions(), np.zeros((81, 3))
            x[0, 1] += 1e-4
            v[0, 2] = 1e-3
            simulation.set_state(x, v)

        monkeypatch.setattr(simulation, "step", step)
        energy, motion = friction.still(simulation, "air")
        assert energy.measured == pytest.approx(0.5e-6 * corner_mass / float(simulation.topology.mass.sum()), rel=1e-5)
        assert motion.measured == pytest.approx(1e-4, rel=1e-3)  # float32
    assert (energy.verdict, motion.verdict) == (PASS, FAIL)


@pytest.mark.parametrize("fall", [flight.free_fall, flight.fall_with_all_features])
def test_compressed_cloth_is_strained(fall: Callable[[str], Iterator[Check]], monkeypatch: pytest.MonkeyPatch) -> None:
    """By ten times the strain that passes, without a stretched spring."""

    def advance(simulation: Simulation, seconds: float) -> None:
        simulation.set_state(simulation.topology.start * 0.999)

    monkeypatch.setattr(flight, "advance", advance)
    *_, row = fall("xpbd")
    assert row.what.startswith("strain")
    assert row.error == pytest.approx(1e-3, rel=0.01)
    assert row.verdict == FAIL


def test_sheared_cloth_is_strained() -> None:
    """Threads keep their lengths, and only diagonals are strained."""
    with Simulation(check.base("xpbd")) as simulation:
        x = simulation.topology.start.copy()
        assert flight.largest_strain(simulation) < 1e-6
        x[:, 0] += 1e-3 * x[:, 1]
        simulation.set_state(x)
        assert simulation.metrics().max_strain < 1e-5
        assert flight.largest_strain(simulation) == pytest.approx(5e-4, rel=0.01)


@pytest.mark.parametrize("level", [0.0, elasticity.CLAMPED_LEVEL])
@pytest.mark.parametrize("compression", elasticity.COMPRESSIONS)
def test_a_buckled_strip_starts_far_from_the_solution(compression: float, level: float) -> None:
    """It has its full length, and its rise differs from the solution by five times the bound or more."""
    start = elasticity.tent(1 - compression, np.linspace(0.0, 1.0, 1001), level)
    assert start[[0, -1]] == pytest.approx(np.array([[-0.5, 0.0], [0.5, 0.0]]) * [1 - compression, 1.0], abs=1e-9)
    assert np.linalg.norm(np.diff(start, axis=0), axis=1).sum() == pytest.approx(1.0, abs=1e-3)
    assert abs(start[:, 1].max() / buckled(compression) - 1) > 5 * elasticity.BUCKLED[0]


def test_a_strip_without_bending_stiffness_falls_short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(elasticity, "COMPRESSIONS", (0.1,))
    monkeypatch.setattr(elasticity, "BENDING", 0.0)
    rows = list(elasticity.buckling("explicit"))
    assert len(rows) == 2
    assert all(row.error > 5 * elasticity.BUCKLED[0] for row in rows)
    assert [row.verdict for row in rows] == [FAIL, FAIL]


@pytest.mark.parametrize(("off", "explained"), [(2e-4, True), (3e-3, False)])
def test_a_small_share_of_an_amplitude_is_judged_relative_to_itself(
    off: float, explained: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 0.5 m, 0.064 % are left. Positions of a meter can be no nearer than 2e-4 of that."""
    share = spring_amplitude("xpbd", sqrt(1000.0), 1 / 60, 60)

    def positions(simulation: Simulation) -> np.ndarray:
        x = simulation.topology.start.copy()
        x[2:, 1] -= 0.5 * share * (1 + off)
        return x

    monkeypatch.setattr(swing, "advance", lambda simulation, seconds: None)
    monkeypatch.setattr(Simulation, "positions", positions)
    row = swing.numerical_damping("xpbd", "1000 N/m", 1000.0, 1)
    assert row.exact == share == pytest.approx(6.4e-4, rel=1e-2)
    assert row.error == pytest.approx(off)
    assert row.verdict == FAIL
    assert row.explained == explained


def test_a_share_near_one_has_no_law(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(swing, "advance", lambda simulation, seconds: None)
    row = swing.numerical_damping("explicit", "1000 N/m", 1000.0, 100)
    assert row.error == pytest.approx(0.0, abs=1e-5)  # nothing has moved: all of the amplitude is left
    assert row.limit is None
