"""Closed forms, compared with numbers computed by hand and with each other."""

from math import pi, sqrt

import numpy as np
import pytest
from scipy import integrate, special
from scipy.optimize import minimize

from taichi_cloth.evaluation.validate import exact


def test_euler_falls_half_a_step_farther() -> None:
    assert exact.euler_drop(1.0, 1 / 60) == pytest.approx(4.98675, abs=1e-9)
    assert exact.euler_drop(1.0, 1 / 6000) == pytest.approx(4.9058175, abs=1e-9)


@pytest.mark.parametrize(("h", "kept"), [(1 / 60, 0.266), (1 / 240, 0.483), (1 / 600, 0.657), (1 / 6000, 0.940)])
def test_a_projected_pair_keeps_the_published_share_of_its_spin(h: float, kept: float) -> None:
    assert exact.projected_spin_rate(1.0, h, 10.0) == pytest.approx(kept, abs=1e-3)
    assert exact.projected_spin_rate(1.0, h, 10.0) == pytest.approx((1 + 2 * (2 * pi) ** 2 * h * 10) ** -0.5, rel=0.02)


@pytest.mark.parametrize("degrees", [1, 10, 90, 170])
def test_the_period_of_a_pendulum_is_an_elliptic_integral(degrees: int) -> None:
    elliptic = special.ellipk(np.sin(np.radians(degrees) / 2) ** 2)
    assert exact.pendulum_period(degrees, 0.7) == pytest.approx(4 * sqrt(0.7 / 9.81) * elliptic, rel=1e-12)


def test_hanging_modes_are_zeros_of_a_laguerre_polynomial() -> None:
    omegas, shapes = exact.chain_modes(10, 1.0, 3)
    assert omegas == pytest.approx([3.676621, 8.459284, 13.319101], abs=1e-6)
    assert omegas == pytest.approx(np.sqrt(98.1 * special.roots_laguerre(10)[0][:3]), rel=1e-9)
    assert shapes.shape == (10, 3)


def test_hanging_drop_is_the_sum_of_the_springs() -> None:
    assert exact.hanging_drop(20, 0.01, 1000.0) == pytest.approx(0.020601)
    assert exact.hanging_drop(20, 0.01, 1000.0) == pytest.approx(sum(9.81 * 0.01 * n / 1000 for n in range(1, 21)))


@pytest.mark.parametrize(("links", "sag"), [(16, 0.266648), (32, 0.266231), (64, 0.266127)])
def test_the_sag_of_a_hammock(links: int, sag: float) -> None:
    """One meter with 0.2 kg and 1000 N per unit strain, at a span of 0.8 m."""
    assert exact.hammock(0.8, links, 1.0, 0.2 / links, 1000.0 * links)[0] == pytest.approx(sag, abs=1e-6)


def test_a_stiff_hammock_of_many_links_is_a_catenary() -> None:
    sag, tension = exact.hammock(0.8, 400, 1.0, 0.2 / 400, 1e9)
    assert sag == pytest.approx(0.265438, abs=1e-5)
    assert tension / (0.2 * exact.GRAVITY) == pytest.approx(0.603639, abs=2e-3)  # half a link below the support


def test_fall_in_air_solves_its_equation() -> None:
    terminal = exact.terminal_speed(0.2, 1.225, 1.0)
    assert terminal == pytest.approx(1.78977, abs=1e-5)
    solved = integrate.solve_ivp(
        lambda _, y: [y[1], 9.81 - 9.81 * (y[1] / terminal) ** 2], (0, 0.3), [0, 0], rtol=1e-10, atol=1e-12
    )
    speed, distance = exact.fall_in_air(0.3, terminal)
    assert (distance, speed) == pytest.approx(tuple(solved.y[:, -1]), rel=1e-8)


@pytest.mark.parametrize(("h", "kept"), [(1 / 60, 0.00064), (1 / 240, 0.127), (1 / 960, 0.594), (1 / 6000, 0.920)])
def test_backward_euler_damps_a_spring_by_the_published_share(h: float, kept: float) -> None:
    """1 kg on 1000 N/m: the largest amplitude of the last period before one second."""
    omega = sqrt(1000.0)
    law = exact.spring_scheme("xpbd", omega, h, round(1 / h))
    phase = np.arctan(omega * h) * np.arange(len(law))
    decayed = (1 + (omega * h) ** 2) ** (-np.arange(len(law)) / 2)
    assert decayed[-1] == pytest.approx(kept, rel=0.01)
    assert law == pytest.approx(decayed * np.cos(phase), abs=1e-9)
    assert exact.spring_amplitude("xpbd", omega, h, round(1 / h)) == pytest.approx(decayed[-1], rel=1e-9)


@pytest.mark.parametrize(("hertz", "kept"), [(5.0, (0.0007, 0.44, 0.92)), (2.0, (0.28, 0.88, 0.99))])
def test_what_survives_a_second_of_backward_euler_is_the_published_share(hertz: float, kept: tuple[float, ...]) -> None:
    for steps, share in zip((60, 600, 6000), kept, strict=True):
        left = exact.spring_amplitude("xpbd", 2 * np.pi * hertz, 1 / steps, steps)
        assert left == pytest.approx(share, rel=0.015)


@pytest.mark.parametrize("solver", ["explicit", "lines", "rk4"])
def test_other_methods_conserve_the_amplitude_of_a_spring(solver: str) -> None:
    """To their own order: a tenth of the step loses at most about a hundredth as much."""
    lost = [abs(1 - exact.spring_amplitude(solver, 5.0, 1 / n, n)) for n in (60, 600)]
    assert lost[0] < 0.01
    assert lost[1] < 0.02 * lost[0]


@pytest.mark.parametrize(("solver", "order"), [("xpbd", 1), ("explicit", 2), ("rk4", 4)])
def test_a_scheme_converges_with_its_order(solver: str, order: int) -> None:
    errors = [abs(exact.spring_scheme(solver, 5.0, 1 / n, n)[-1] - np.cos(5.0)) for n in (200, 400)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize(("span", "sag"), [(0.6, 0.350113), (0.8, 0.260357), (0.9, 0.188835)])
def test_the_sag_of_a_sail_with_lift(span: float, sag: float) -> None:
    assert exact.sail_sag(span, drag_only=False) == pytest.approx(sag, abs=1e-6)


@pytest.mark.parametrize("span", [0.6, 0.9])
def test_a_sail_with_drag_only_solves_its_equation(span: float) -> None:
    """The tension is H across the wind, and along it the integral of the force p·cos²θ from the middle."""

    def end(load: float) -> np.ndarray:
        def slope(_: float, y: np.ndarray) -> list[float]:
            angle = np.arctan(y[2])
            return [np.cos(angle), np.sin(angle), load * np.cos(angle) ** 2]

        return integrate.solve_ivp(slope, (0, 0.5), [0, 0, 0], rtol=1e-10, atol=1e-12).y[:, -1]

    load = exact.bisect_root(lambda load: span / 2 - end(load)[0], 1e-3, 1e3)
    assert exact.sail_sag(span, drag_only=True) == pytest.approx(end(load)[1], rel=1e-6)


def test_a_taut_string_and_a_grid_have_the_published_numbers() -> None:
    assert exact.taut_modes(32, 10.0, 0.1 / 32, 1.0, 3) == pytest.approx([31.40331, 62.73097, 93.90750], abs=1e-5)
    assert [exact.sheet_modulus(1000.0, k) for k in (500.0, 1000.0, 100.0)] == pytest.approx([4000 / 3, 1500, 1090.909])


@pytest.mark.parametrize(
    ("gamma", "drop", "reach"),
    [(0.1, 0.012498, 0.999911), (10, 0.700200, 0.656354), (1000, 0.981141, 0.045986), (10000, 0.994110, 0.014261)],
)
def test_a_heavy_strip_has_the_published_droop(gamma: float, drop: float, reach: float) -> None:
    assert exact.cantilever(gamma) == pytest.approx((drop, reach), abs=1e-6)


@pytest.mark.parametrize(
    ("load", "drop", "reach"),
    [(0.25, 0.082746, 0.995882), (2, 0.493457, 0.839358), (10, 0.810609, 0.445004)],
)
def test_a_strip_with_a_tip_load_has_the_published_droop(load: float, drop: float, reach: float) -> None:
    """The elliptic integrals of Bisshopp and Drucker."""
    assert exact.cantilever(0.0, load) == pytest.approx((drop, reach), abs=1e-6)


def test_a_strip_with_weight_and_tip_load_solves_its_equation() -> None:
    """From the clamp, θ below horizontal: θ'' = −(Γ·(1 − s) + α)·cos θ, no moment at the tip."""
    gamma, load = 0.8, 3.0

    def slope(s: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.stack([y[1], -(gamma * (1 - s) + load) * np.cos(y[0]), np.sin(y[0]), np.cos(y[0])])

    along = np.linspace(0, 1, 50)
    found = integrate.solve_bvp(
        slope, lambda a, b: np.array([a[0], b[1], a[2], a[3]]), along, np.zeros((4, 50)), tol=1e-9, max_nodes=10**5
    )
    assert found.status == 0
    assert exact.cantilever(gamma, load) == pytest.approx(tuple(found.y[2:, -1]), abs=1e-7)


@pytest.mark.parametrize(("share", "height"), [(0.01, 0.063463), (0.1, 0.194924), (0.5, 0.373306)])
def test_a_buckled_strip_is_an_elastica(share: float, height: float) -> None:
    assert exact.buckled(share) == pytest.approx(height, abs=1e-6)


def test_a_pear_loop_has_the_least_bending_energy_of_its_length() -> None:
    """Equal links with hinges, minimized by another method."""
    n = 80  # links in one half
    link = 0.5 / n

    # The clamp is a hinge of half the length; the hinge at the top is shared with the other half.
    weights = np.array([2.0, *np.ones(n - 1), 0.5])

    def energy(angles: np.ndarray) -> float:
        all_angles = np.concatenate([[np.pi / 2], angles, [2 * np.pi - angles[-1]]])
        return float((np.diff(all_angles) ** 2 * weights).sum() / (2 * link))

    def across(angles: np.ndarray) -> float:
        return float(np.cos(angles).sum() * link)

    start = np.pi / 2 * (1 - 2 * np.sin(np.pi * np.linspace(0, 1, n)) * 0.5) + np.linspace(0, np.pi / 2, n)
    found = minimize(energy, start, constraints={"type": "eq", "fun": across}, options={"maxiter": 500})
    assert found.success
    assert exact.pear_loop() == pytest.approx(np.sin(found.x).sum() * link, abs=1e-3)


@pytest.mark.parametrize(("cells", "share"), [(16, 0.07344577), (32, 0.07361474), (64, 0.07365719), (128, 0.07366781)])
def test_a_taut_square_sags_by_the_published_share(cells: int, share: float) -> None:
    """w = C·σgL²/T, with 0.2 kg/m² and 100 N/m over one meter."""
    sag = exact.drum_sag(cells, 100.0 / cells, 0.2 / cells**2)
    assert sag == pytest.approx(share * 0.2 * 9.81 / 100.0, rel=2e-7)


def test_the_modes_of_a_square_and_of_a_strip_are_eigenvalues() -> None:
    cells, tension, mass = 6, 0.7, 0.03
    inside = cells - 1
    line = 2 * np.eye(inside) - np.eye(inside, k=1) - np.eye(inside, k=-1)
    square = np.kron(line, np.eye(inside)) + np.kron(np.eye(inside), line)
    found = np.sqrt(np.linalg.eigvalsh(square * tension * cells / mass))
    modes = sorted(exact.drum_modes(cells, tension, mass, m, n) for m in range(1, cells) for n in range(1, cells))
    assert modes == pytest.approx(found, rel=1e-9)
    free = 2 * np.eye(cells) - np.eye(cells, k=1) - np.eye(cells, k=-1)
    free[-1, -1] = 1.0  # free end
    found = np.sqrt(np.linalg.eigvalsh(free * 5.0 / mass))
    assert exact.longitudinal_modes(cells, 5.0, mass, cells) == pytest.approx(found, rel=1e-9)


def test_a_damped_swing_solves_its_equation() -> None:
    omega, ratio = 9.0, 0.13
    solved = integrate.solve_ivp(
        lambda _, y: [y[1], -2 * ratio * omega * y[1] - omega**2 * y[0]],
        (0, 0.7),
        [1.0, 0.0],
        rtol=1e-11,
        atol=1e-13,
    )
    assert exact.damped_swing(omega, ratio, np.array([0.7]))[0] == pytest.approx(solved.y[0, -1], abs=1e-8)


def test_the_bias_modulus_of_a_grid_has_the_published_numbers() -> None:
    assert [exact.bias_modulus(1000.0, k) for k in (500.0, 1000.0, 100.0)] == pytest.approx([4000 / 3, 2400, 342.857])


def test_the_tension_of_a_sail_is_published_and_solves_its_equation() -> None:
    assert exact.sail_tension(0.8, drag_only=False) == pytest.approx(0.385984, abs=1e-6)

    def end(load: float) -> float:
        def slope(_: float, y: np.ndarray) -> list[float]:
            angle = np.arctan(y[1])
            return [np.cos(angle), load * np.cos(angle) ** 2]

        return float(integrate.solve_ivp(slope, (0, 0.5), [0, 0], rtol=1e-10, atol=1e-12).y[0, -1])

    load = exact.bisect_root(lambda load: 0.4 - end(load), 1e-3, 1e3)
    assert exact.sail_tension(0.8, drag_only=True) == pytest.approx(1 / load, rel=1e-6)


def test_a_wave_solves_its_equation() -> None:
    """A string of eight links, compared with short time steps."""
    links, tension, mass = 8, 10.0, 0.02
    shape, rate = np.sin(np.arange(1.0, links)), np.cos(np.arange(1.0, links))
    stiff = (2 * np.eye(links - 1) - np.eye(links - 1, k=1) - np.eye(links - 1, k=-1)) * tension * links / mass
    solved = integrate.solve_ivp(
        lambda _, y: np.concatenate([y[links - 1 :], -stiff @ y[: links - 1]]),
        (0, 0.2),
        np.concatenate([shape, rate]),
        rtol=1e-10,
        atol=1e-12,
    )
    found = exact.string_displacement(links, tension, mass, shape, rate, 0.2)
    assert found == pytest.approx(solved.y[: links - 1, -1], abs=1e-7)


@pytest.mark.parametrize(("friction", "ratio"), [(0.1, 1.416021), (0.3, 2.762644), (0.5, 5.275316)])
def test_the_force_ratio_of_a_scarf_is_published_and_solves_its_equation(friction: float, ratio: float) -> None:
    assert exact.scarf_ratio(friction, 0.1) == pytest.approx(ratio, abs=1e-6)
    solved = integrate.solve_ivp(
        lambda phi, tension: friction * (tension + 0.1 * np.sin(phi)) + 0.1 * np.cos(phi),
        (0, pi),
        [1.0],
        rtol=1e-10,
        atol=1e-12,
    )
    assert exact.scarf_ratio(friction, 0.1) == pytest.approx(solved.y[0, -1], rel=1e-7)
