"""The converged motion: methods agree, published numbers are met, energy is conserved."""

import numpy as np
import pytest

from taichi_cloth.evaluation.bench.error_sweep import GRAVITY, Curtain, curtain_solution, richardson_verlet
from taichi_cloth.evaluation.validate.swing import CURTAIN


@pytest.mark.parametrize("cells", [pytest.param(n, marks=[pytest.mark.long] * (n == max(CURTAIN))) for n in CURTAIN])
def test_the_published_numbers_of_the_curtain(cells: int) -> None:
    bottom = curtain_solution(Curtain(cells))[[14, 29, 59], -1]
    assert bottom == pytest.approx(np.array(CURTAIN[cells]), abs=1e-8)


@pytest.mark.parametrize(
    "curtain", [Curtain(16), Curtain(8, degrees=80.0), Curtain(10, stiffness=5e3, area_density=0.5)]
)
def test_another_method_gives_the_same_motion(curtain: Curtain) -> None:
    assert richardson_verlet(curtain, 30) == pytest.approx(curtain_solution(curtain, 30), abs=1e-8)


def test_one_link_is_an_elastic_pendulum_that_conserves_energy() -> None:
    curtain = Curtain(1, stiffness=200.0)
    x = curtain_solution(curtain, 60)[:, 1]
    v = (x[2:] - x[:-2]) * 30  # central, exact to second order
    spring = 0.5 * curtain.stiffness * (np.linalg.norm(x, axis=1) - 1) ** 2
    energy = 0.5 * curtain.mass * (v**2).sum(axis=1) + curtain.mass * GRAVITY * x[1:-1, 1] + spring[1:-1]
    start = curtain.mass * GRAVITY * curtain.start[1, 1]
    assert energy == pytest.approx(np.full(58, start), abs=0.02 * abs(start))


def midpoint(curtain: Curtain, frames: int, steps: int) -> np.ndarray:
    """Return the motion by the implicit midpoint rule: Newton's method in each step, with a dense matrix."""
    n, h = 2 * (curtain.cells + 1), 1 / 60 / steps
    x, v = curtain.start.ravel(), np.zeros(n)
    seen = []

    def stiffness(positions: np.ndarray) -> np.ndarray:
        """Return ∂a/∂x."""
        matrix = np.zeros((n, n))
        gap = np.diff(positions.reshape(-1, 2), axis=0)
        for j, g in enumerate(gap):
            long = np.linalg.norm(g)
            unit = np.outer(g, g) / long**2
            k = curtain.stiffness / curtain.mass * (np.eye(2) - curtain.rest / long * (np.eye(2) - unit))
            above, below = slice(2 * j, 2 * j + 2), slice(2 * j + 2, 2 * j + 4)
            matrix[below, below] -= k
            matrix[below, above] += k
            matrix[above, above] -= k
            matrix[above, below] += k
        matrix[:2] = 0
        return matrix

    for _ in range(frames):
        for _ in range(steps):
            d = h * v  # displacement in this step
            for _ in range(8):
                middle = x + d / 2
                wrong = d - h * v - h * h / 2 * curtain.acceleration(middle.reshape(-1, 2)).ravel()
                if np.abs(wrong).max() < 1e-15:
                    break
                d = d - np.linalg.solve(np.eye(n) - h * h / 4 * stiffness(middle), wrong)
            x, v = x + d, 2 * d / h - v
        seen.append(x.reshape(-1, 2))
    return np.array(seen)


def test_implicit_steps_give_the_same_motion() -> None:
    """Errors are of orders h² and h⁴: two step lengths remove the first, a third removes the second (Richardson)."""
    curtain = Curtain(6, stiffness=300.0)
    a, b, c = (midpoint(curtain, 12, steps) for steps in (60, 120, 240))
    once, again = (4 * b - a) / 3, (4 * c - b) / 3
    assert (16 * again - once) / 15 == pytest.approx(curtain_solution(curtain, 12), abs=1e-8)
