"""Implicit steps in float64 against closed forms and another method."""

from math import cos, sin, sqrt

import numpy as np
import pytest
from scipy.optimize import minimize

from taichi_cloth.validate import exact, newton
from taichi_cloth.validate.newton import Chain

H = 1 / 60


def chain(links: int, constant: float, last: float = 1.0, gravity: float = 9.81) -> Chain:
    mass = np.ones(links + 1)
    mass[-1] = last
    first = np.arange(links)
    ends = np.stack([first, first + 1], axis=-1)
    return Chain(mass, ends, np.full(links, 0.1), np.full(links, constant), gravity)


def straight(links: int, degrees: float) -> np.ndarray:
    """`degrees` over level."""
    angle = np.radians(degrees)
    return 0.1 * np.arange(links + 1)[:, None] * np.array([cos(angle), sin(angle)])


@pytest.mark.parametrize(("step", "solver"), [(newton.euler, "xpbd"), (newton.two_stages, "lines")])
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


def test_a_step_ends_where_its_energy_is_least() -> None:
    soft = chain(4, 500.0, last=3.0)
    x, v = straight(4, -20.0), np.zeros((5, 2))
    v[-1] = (0.5, 1.0)
    y = newton.without_springs(soft, x, v, H)

    def energy(places: np.ndarray) -> float:
        there = np.vstack([x[:1], places.reshape(-1, 2)])
        stretch = soft.strains(there) * soft.rest
        kinetic = (soft.mass[:, None] * (there - y) ** 2).sum() / (2 * H**2)
        return float(kinetic + (soft.constant * stretch**2).sum() / 2)

    found = minimize(energy, y[1:].ravel(), method="BFGS", options={"gtol": 1e-7})
    step = newton.euler(soft, x, v, H)
    assert step.x[1:].ravel() == pytest.approx(found.x, abs=1e-7)
    assert newton.residual(soft, y, step.x, H).max() < 1e-9
    assert newton.residual(soft, y, y, H).max() > 1.0


def test_the_heavy_strand_is_longer_by_the_printed_length() -> None:
    """19 links of 1e8 N/m, 18 masses of 1 kg and one of 1000 under 10 m/s²: 1.917 mm, and at rest."""
    heavy = chain(19, 1e8, last=1000.0, gravity=10.0)
    x = straight(19, -90.0)
    carried = heavy.mass[::-1].cumsum()[-2::-1] * 10.0
    x[1:, 1] -= (carried / 1e8).cumsum()
    assert x[-1, 1] == pytest.approx(-1.9 - 1.9171e-3, abs=1e-9)
    step = newton.euler(heavy, x, np.zeros_like(x), H)
    assert step.x == pytest.approx(x, abs=1e-12)
    assert step.tension == pytest.approx(carried, rel=1e-6)


def linearised(strand: Chain, x: np.ndarray, v: np.ndarray, rounds: int) -> np.ndarray:
    """A step as `lines` solves it: all multipliers at once, and moves along the threads as they are in each round."""
    found, multiplier = newton.without_springs(strand, x, v, H), np.zeros(len(strand.rest))
    give, inverse = 1 / (strand.constant * H**2), np.repeat(1 / strand.mass, 2)
    inverse[:2] = 0.0
    for _ in range(rounds):
        unit, long = strand.gaps(found)
        jacobian = newton._jacobian(strand, unit)
        wrong = long - strand.rest + give * multiplier
        change = np.linalg.solve(jacobian * inverse @ jacobian.T + np.diag(give), -wrong)
        multiplier += change
        found = found + (inverse * (jacobian.T @ change)).reshape(-1, 2)
    return found


def test_what_rounding_and_turned_threads_leave_of_a_residual() -> None:
    """On the way of the heavy strand, in weights of a light particle: what bounds and reason of B6.2 rest on."""
    heavy = chain(19, 1e8, last=1000.0, gravity=10.0)
    x, v = straight(19, -30.0), np.zeros((20, 2))
    rounded, turned = [], []
    for _ in range(40):
        y = newton.without_springs(heavy, x, v, H)
        step = newton.euler(heavy, x, v, H)
        rounded.append(newton.residual(heavy, y, step.x.astype(np.float32).astype(float), H).max() / 10.0)
        turned.append([newton.residual(heavy, y, linearised(heavy, x, v, n), H).max() / 10.0 for n in (20, 60)])
        x, v, _ = step
    assert 0.5 < max(rounded) < 4.0
    assert np.max(turned, axis=0)[1] > 20.0
    assert np.array(turned)[:, 0] == pytest.approx(np.array(turned)[:, 1], rel=0.01, abs=0.1)


def test_what_does_not_converge_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(newton, "MOST_ROUNDS", 1)
    with pytest.raises(ArithmeticError, match="does not converge"):
        newton.euler(chain(3, 1e4), straight(3, 0.0), np.zeros((4, 2)), H)
