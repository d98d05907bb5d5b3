"""`xpbd` compared with closed forms: numerical damping, and stretch that does not depend on iterations and substeps."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Forces, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation

OMEGA = np.sqrt(1000.0)  # [rad/s] 1 kg on a compliance of 0.001 m/N (Macklin 2016, fig. 2)
START = 0.5  # [m] longer than at rest


def swing(rate: int, iterations: int, tau: float, frames: int) -> np.ndarray:
    """Return the elongation of a spring of 1 m after every substep [m]: a mass released without gravity.

    Two of them hang side by side. `rate`: substeps per second. `tau`: damping time [s].
    """
    cloth = Cloth(
        rows=2, columns=2, width=1.0, height=1.0, center=(0.0, 0.0, 0.0), pins=("top",), mass_lumping="uniform"
    )
    scene = Scene(
        cloth=cloth,
        fabric=Fabric(warp=1.0, weft=1.0, shear=0.0, bend_spring=0.0, damping_time=tau),
        solver=Solver("xpbd", substeps=rate // 60, iterations=iterations, damping=0.0),
        forces=Forces(gravity=0.0),
    )
    with Simulation(scene) as simulation:
        constant = OMEGA**2 * simulation.topology.mass[2]
    elongations: list[float] = []
    with Simulation(replace(scene, fabric=replace(scene.fabric, warp=constant, weft=constant))) as simulation:
        x = simulation.topology.start.copy()
        x[2:, 1] -= START
        simulation.set_state(x)
        for _ in range(frames):
            simulation.step_by_substep(lambda share: elongations.append(float(-simulation.positions()[2, 1] - 0.5)))
        assert simulation.positions()[3, 1] == simulation.positions()[2, 1]
    return np.array(elongations)


# A known bug of XPBD is to reset λ in every iteration instead of every substep: with eight iterations the spring would
# be eight times as stiff.
@pytest.mark.parametrize("iterations", [1, 8])
@pytest.mark.parametrize("rate", [240, 960, 6000])
def test_a_spring_has_the_amplitude_and_phase_of_backward_euler(rate: int, iterations: int) -> None:
    # Backward Euler multiplies the amplitude by (1 + ω²h²)^(−1/2) a step and advances the phase by atan(ωh) (accuracy
    # reference A2).
    h = 1 / rate
    elongations = swing(rate, iterations, 0.0, 60 if rate < 1000 else 12)
    decay, angle = (1 + (OMEGA * h) ** 2) ** -0.5, np.arctan(OMEGA * h)
    n = np.arange(1, len(elongations) + 1)
    # Initially at rest: x − 1 is the real part of 0.5·(1 + iωh)·(1/(1 + iωh))^(n+1), which is
    assert elongations == pytest.approx(START * decay**n * np.cos(n * angle), abs=1e-4)


@pytest.mark.parametrize("iterations", [1, 8])
@pytest.mark.parametrize("tau", [1e-4, 1e-3, 1e-2])
def test_a_damped_spring_follows_backward_euler(tau: float, iterations: int) -> None:
    """Macklin 2016, eq. 26. (x⁺ − 2x + x⁻)/h² = −ω²·(x⁺ + τ·(x⁺ − x)/h) is solved by zⁿ with
    (1 + hτω² + h²ω²)·z² − (2 + hτω²)·z + 1 = 0."""
    h = 1 / 600
    elongations = swing(600, iterations, tau, 60)
    z = np.roots([1 + h * tau * OMEGA**2 + (h * OMEGA) ** 2, -(2 + h * tau * OMEGA**2), 1]).astype(complex)
    shares = np.linalg.solve(np.array([z**0, z**-1]), [START, START])  # initially at rest: x₀ = x₋₁
    steps = np.arange(1, len(elongations) + 1)
    expected = np.real(sum(share * root**steps for share, root in zip(shares, z, strict=True)))
    assert elongations == pytest.approx(expected, abs=1e-4)
