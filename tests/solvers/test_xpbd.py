"""`xpbd` against closed forms: its own numerical damping, and stretch that iterations and steps do not change."""

import numpy as np
import pytest
import taichi as ti
import taichi.math as tm

from taichi_cloth.kernels.maths import project_compliant


@ti.kernel
def swing(
    start: float, compliance: float, tau: float, h: float, steps: int, path: ti.types.ndarray(dtype=ti.f32, ndim=1)
):
    """A mass of 1 kg on a spring of rest length 1 m to a fixed point, let go at `start`; dashpot of `tau` [s]."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        x, v = start, 0.0
        for k in range(steps):
            predicted = x + h * v
            gap = tm.vec3(predicted, 0.0, 0.0)
            shift, _change = project_compliant(gap, 1.0, 1.0, h * h / compliance, 0.0, tau / h, predicted - x)
            v -= shift[0] / h
            x = predicted - shift[0]
            path[k] = x


@pytest.mark.parametrize("rate", [240, 960, 6000])
def test_one_spring_shrinks_and_turns_by_the_schemes_own_law(rate: int) -> None:
    # Macklin 2016, fig. 2: compliance 0.001 m/N. Backward Euler multiplies the amplitude by (1 + ω²h²)^(−1/2) a
    # step and turns by atan(ωh) (accuracy reference A2).
    omega, h, steps = np.sqrt(1000.0), 1 / rate, min(rate, 1200)
    path = np.zeros(steps, np.float32)
    swing(1.5, 0.001, 0.0, h, steps, path)
    shrink, turn = (1 + (omega * h) ** 2) ** -0.5, np.arctan(omega * h)
    n = np.arange(1, steps + 1)
    # At rest at the start: x − 1 is the real part of 0.5·(1 + iωh)·(1/(1 + iωh))^(n+1), which is
    expected = 0.5 * shrink**n * np.cos(n * turn)
    assert path - 1 == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("tau", [1e-4, 1e-3, 1e-2])
def test_one_spring_with_a_dashpot_follows_backward_euler(tau: float) -> None:
    """Macklin 2016, eq. 26. (x⁺ − 2x + x⁻)/h² = −ω²·(x⁺ + τ·(x⁺ − x)/h) goes like zⁿ with
    (1 + hτω² + h²ω²)·z² − (2 + hτω²)·z + 1 = 0."""
    omega, h, steps = np.sqrt(1000.0), 1 / 600, 600
    path = np.zeros(steps, np.float32)
    swing(1.5, 0.001, tau, h, steps, path)
    z = np.roots([1 + h * tau * omega**2 + (h * omega) ** 2, -(2 + h * tau * omega**2), 1]).astype(complex)
    shares = np.linalg.solve(np.array([z**0, z**-1]), [0.5, 0.5])  # at rest at the start: x₀ = x₋₁
    expected = np.real(sum(share * root ** np.arange(1, steps + 1) for share, root in zip(shares, z, strict=True)))
    assert path - 1 == pytest.approx(expected, abs=1e-4)
