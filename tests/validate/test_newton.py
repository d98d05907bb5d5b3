"""Implicit steps in float64, compared with closed forms and another method."""

from math import cos, sin, sqrt

import numpy as np
import pytest
from scipy.optimize import minimize

from taichi_cloth.evaluation.validate import exact, strand
from taichi_cloth.evaluation.validate.strand import Chain

H = 1 / 60


def chain(links: int, constant: float, last: float = 1.0, gravity: float = 9.81) -> Chain:
    mass = np.ones(links + 1)
    mass[-1] = last
    first = np.arange(links)
    ends = np.stack([first, first + 1], axis=-1)
    return Chain(mass, ends, np.full(links, 0.1), np.full(links, constant), gravity)


def straight(links: int, degrees: float) -> np.ndarray:
    """Return the positions of a straight chain, `degrees` above horizontal."""
    angle = np.radians(degrees)
    return 0.1 * np.arange(links + 1)[:, None] * np.array([cos(angle), sin(angle)])


@pytest.mark.parametrize(("step", "solver"), [(strand.backward_euler_step, "xpbd"), (strand.sdirk_step, "lines")])
def test_one_spring_follows_the_law_of_its_scheme(step, solver: str) -> None:
    one = chain(1, 30.0, gravity=0.0)
    x, v = straight(1, -90.0), np.zeros((2, 2))
    x[1, 1] -= 0.01
    seen = [1.0]
    for _ in range(20):
        x, v, tension = step(one, x, v, H)
        seen.append(-(x[1, 1] + 0.1) / 0.01)
        assert tension[0] == pytest.approx(30.0 * 0.01 * seen[-1], abs=1e-9)
    assert seen == pytest.approx(exact.spring_scheme(solver, sqrt(30.0), H, 20), abs=1e-9)


def test_a_step_minimizes_its_energy() -> None:
    soft = chain(4, 500.0, last=3.0)
    x, v = straight(4, -20.0), np.zeros((5, 2))
    v[-1] = (0.5, 1.0)
    y = strand.inertial_target(soft, x, v, H)

    def energy(free: np.ndarray) -> float:
        positions = np.vstack([x[:1], free.reshape(-1, 2)])
        stretch = soft.strains(positions) * soft.rest
        kinetic = (soft.mass[:, None] * (positions - y) ** 2).sum() / (2 * H**2)
        return float(kinetic + (soft.constant * stretch**2).sum() / 2)

    found = minimize(energy, y[1:].ravel(), method="BFGS", options={"gtol": 1e-7})
    step = strand.backward_euler_step(soft, x, v, H)
    assert step.x[1:].ravel() == pytest.approx(found.x, abs=1e-7)
    assert strand.step_residual(soft, y, step.x, H).max() < 1e-9
    assert strand.step_residual(soft, y, y, H).max() > 1.0


def test_the_heavy_strand_has_the_published_elongation() -> None:
    """19 links of 1e8 N/m, 18 masses of 1 kg and one of 1000 under 10 m/s²: 1.917 mm, at rest."""
    heavy = chain(19, 1e8, last=1000.0, gravity=10.0)
    x = straight(19, -90.0)
    load = heavy.mass[::-1].cumsum()[-2::-1] * 10.0
    x[1:, 1] -= (load / 1e8).cumsum()
    assert x[-1, 1] == pytest.approx(-1.9 - 1.9171e-3, abs=1e-9)
    step = strand.backward_euler_step(heavy, x, np.zeros_like(x), H)
    assert step.x == pytest.approx(x, abs=1e-12)
    assert step.tension == pytest.approx(load, rel=1e-6)


def linearized(heavy: Chain, x: np.ndarray, v: np.ndarray, rounds: int) -> np.ndarray:
    """Return a step as `lines` solves it: all multipliers at once, with the spring directions of each iteration."""
    found, multiplier = strand.inertial_target(heavy, x, v, H), np.zeros(len(heavy.rest))
    give, inverse = 1 / (heavy.constant * H**2), np.repeat(1 / heavy.mass, 2)
    inverse[:2] = 0.0
    for _ in range(rounds):
        unit, long = heavy.gaps(found)
        jacobian = strand._jacobian(heavy, unit)
        wrong = long - heavy.rest + give * multiplier
        change = np.linalg.solve(jacobian * inverse @ jacobian.T + np.diag(give), -wrong)
        multiplier += change
        found = found + (inverse * (jacobian.T @ change)).reshape(-1, 2)
    return found


def test_rounding_and_rotated_springs_leave_a_residual() -> None:
    """Along the motion of the heavy strand, in weights of a light particle: the bounds of B6.2 depend on these."""
    heavy = chain(19, 1e8, last=1000.0, gravity=10.0)
    x, v = straight(19, -30.0), np.zeros((20, 2))
    rounded, rotated = [], []
    for _ in range(40):
        y = strand.inertial_target(heavy, x, v, H)
        step = strand.backward_euler_step(heavy, x, v, H)
        rounded.append(strand.step_residual(heavy, y, step.x.astype(np.float32).astype(float), H).max() / 10.0)
        rotated.append([strand.step_residual(heavy, y, linearized(heavy, x, v, n), H).max() / 10.0 for n in (20, 60)])
        x, v, _ = step
    assert 0.5 < max(rounded) < 4.0
    assert np.max(rotated, axis=0)[1] > 20.0
    assert np.array(rotated)[:, 0] == pytest.approx(np.array(rotated)[:, 1], rel=0.01, abs=0.1)


def test_a_step_that_does_not_converge_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(strand, "MAX_ITERATIONS", 1)
    with pytest.raises(ArithmeticError, match="does not converge"):
        strand.backward_euler_step(chain(3, 1e4), straight(3, 0.0), np.zeros((4, 2)), H)
