"""Closed-form solutions and small exact calculations in float64. SI units; NumPy only."""

from __future__ import annotations

from collections.abc import Callable
from math import asinh, atan2, atanh, cos, cosh, exp, log, pi, radians, sin, sqrt, tanh

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TWO_STAGE = ("lines", "implicit")  # solvers that use the method of Alexander 1977
# Bottom row (forward, up) [m] of the swinging curtain after 0.25, 0.5 and 1 s, by cells per side. They were computed
# in float64 by Dormand and Prince's method of order 8, until they did not change any more.
CURTAIN = {
    16: ((0.5231750679, -0.8297375679), (-0.2103274487, -0.9759157740), (-0.6740654639, -0.7338234369)),
    32: ((0.5226717572, -0.8292342573), (-0.2309021056, -0.9685538124), (-0.6677511421, -0.7397831360)),
    64: ((0.5224470917, -0.8290095917), (-0.2433597394, -0.9621248437), (-0.6646460383, -0.7425699090)),
}
GRAVITY = 9.81  # [m/s²] default of a scene


def euler_drop(seconds: float, h: float) -> float:
    """Return the distance [m] that symplectic or backward Euler falls from rest: ½gt² plus ½ght."""
    steps = round(seconds / h)
    return GRAVITY * h * h * steps * (steps + 1) / 2


def projected_spin_rate(turns: float, h: float, seconds: float) -> float:
    """Return the share of its rate [turns/s] that a rigid pair keeps if it moves by projected steps.

    A step goes along the tangent and is projected back: φ' = atan(sin φ/(2 − cos φ)) from step to step, because x −
    x_prev is the velocity of position-based dynamics.
    """
    first = phi = atan2(2 * pi * turns * h, 1.0)
    for _ in range(round(seconds / h) - 1):
        phi = atan2(sin(phi), 2 - cos(phi))
    return phi / first


def pendulum_period(degrees: float, length: float) -> float:
    """Return the period of a pendulum, 4·√(l/g)·K(sin ½θ₀) [s].

    The complete elliptic integral K comes from the arithmetic-geometric mean (Gauss).
    """
    a, b = 1.0, cos(radians(degrees) / 2)
    for _ in range(40):
        a, b = (a + b) / 2, sqrt(a * b)
    return 2 * pi * sqrt(length / GRAVITY) / a


def projected_swing(degrees: float, length: float, h: float, seconds: float, every: float) -> Floats:
    """Return the angles [rad] from hanging, `every` seconds apart, of a pendulum that moves by projected steps.

    A step is symplectic Euler without the rod, then a projection to the rod's length; x − x_prev is the velocity.
    Position-based dynamics moves a pendulum in this way if all constraints are satisfied.
    """
    angle = radians(degrees)
    x = length * np.array([sin(angle), -cos(angle)])
    v = np.zeros(2)
    angles, per = [angle], round(every / h)
    for step in range(1, round(seconds / every) * per + 1):
        x_new = x + h * v - np.array([0.0, GRAVITY * h * h])
        x_new *= length / np.hypot(*x_new)
        x, v = x_new, (x_new - x) / h
        if step % per == 0:
            angles.append(atan2(x[0], -x[1]))
    return np.array(angles)


def chain_modes(links: int, length: float, count: int) -> tuple[Floats, Floats]:
    """Return (ω [rad/s], shapes (links, count)) of small oscillations of a hanging chain of equal links and masses.

    The links are rigid. The link above mass j carries links − j + 1 masses. The ω² are g/l times the zeros of the
    Laguerre polynomial.
    """
    carried = np.arange(links, 0, -1.0)
    stiffness = np.diag(carried + np.append(carried[1:], 0.0))
    stiffness -= np.diag(carried[1:], 1) + np.diag(carried[1:], -1)
    squares, shapes = np.linalg.eigh(stiffness * GRAVITY * links / length)
    return np.sqrt(squares[:count]), shapes[:, :count]


def hanging_drop(links: int, mass: float, constant: float) -> float:
    """Return the elongation [m] of a hanging chain of equal springs [N/m] and masses [kg] under its weight."""
    return mass * GRAVITY * links * (links + 1) / (2 * constant)


def hammock(span: float, links: int, length: float, mass: float, constant: float) -> tuple[float, float]:
    """Return the sag [m] and the tension of the last link [N] of a strip that is pinned at both ends.

    `length` is its total rest length. It consists of equal springs [N/m], with equal masses [kg] at their joints.
    """
    vertical = (np.arange(links) - (links - 1) / 2) * mass * GRAVITY
    rest = length / links

    def shape(horizontal: float) -> tuple[float, float]:
        tension = np.hypot(horizontal, vertical)
        lengths = rest + tension / constant
        return float((lengths * horizontal / tension).sum()), float(-np.cumsum(lengths * vertical / tension).min())

    horizontal = bisect_root(lambda f: shape(f)[0] - span, 1e-12, constant * length + mass * GRAVITY * links)
    return shape(horizontal)[1], float(np.hypot(horizontal, vertical[-1]))


def bisect_root(function: Callable[[float], float], low: float, high: float) -> float:
    """Return the zero of an increasing function, by bisection."""
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if function(middle) < 0 else (low, middle)
    return (low + high) / 2


def taut_modes(links: int, tension: float, mass: float, length: float, count: int) -> Floats:
    """Return the transverse ω [rad/s] of a string of equal links and masses [kg] under a tension [N].

    It is 2·√(T/ma)·sin(jπ/2N).
    """
    j = np.arange(1, count + 1)
    omegas: Floats = 2 * np.sqrt(tension * links / (mass * length)) * np.sin(j * pi / (2 * links))
    return omegas


def longitudinal_modes(links: int, constant: float, mass: float, count: int) -> Floats:
    """Return the longitudinal ω [rad/s] of equal springs [N/m] and masses [kg] that hang from one end."""
    j = np.arange(1, count + 1)
    omegas: Floats = 2 * np.sqrt(constant / mass) * np.sin((2 * j - 1) * pi / (2 * (2 * links + 1)))
    return omegas


def drum_modes(cells: int, tension: float, mass: float, m: int, n: int) -> float:
    """Return ω [rad/s] of mode (m, n) of a square of one meter, pinned at its edges.

    It has `cells` cells per side, with springs under `tension` [N] in both directions.
    """
    sines = sin(m * pi / (2 * cells)) ** 2 + sin(n * pi / (2 * cells)) ** 2
    return 2 * sqrt(tension * cells / mass * sines)


def drum_sag(cells: int, tension: float, mass: float) -> float:
    """Return the sag [m] under its weight of the center of a square of one meter, pinned at its edges.

    A small sag obeys the five-point equation of Poisson. It is solved in its own modes, sines in both directions.
    """
    n = np.arange(1, cells)
    sines = np.sqrt(2 / cells) * np.sin(pi * np.outer(n, n) / cells)
    squares = 4 * np.sin(n * pi / (2 * cells)) ** 2
    weight = sines @ np.full((cells - 1, cells - 1), mass * GRAVITY) @ sines
    sag: Floats = sines @ (weight / (tension * cells * (squares[:, None] + squares))) @ sines
    return float(sag[cells // 2 - 1, cells // 2 - 1])


def damped_swing(omega: float, ratio: float, seconds: Floats) -> Floats:
    """Return the displacement of a damped oscillator after its release, as a share of the initial displacement.

    `ratio` is the share of critical damping.
    """
    damped_omega, decay = omega * sqrt(1 - ratio**2), ratio * omega
    displacement: Floats = np.exp(-decay * seconds) * (
        np.cos(damped_omega * seconds) + decay / damped_omega * np.sin(damped_omega * seconds)
    )
    return displacement


def sheet_modulus(structural: float, shear: float) -> float:
    """Return force per strain and width [N/m] of a grid with both diagonals, pulled along its threads.

    It is free across them. The diagonals make it contract sideways: k_s·(k_s + 2k_d)/(k_s + k_d), of the homogenized
    grid.
    """
    return structural * (structural + 2 * shear) / (structural + shear)


def bias_modulus(structural: float, shear: float) -> float:
    """Return force per strain and width [N/m] of a grid with both diagonals, pulled at 45° to its threads.

    It is 4k_d·(k_s + 2k_d)/(k_s + 4k_d), of the homogenized grid.
    """
    return 4 * shear * (structural + 2 * shear) / (structural + 4 * shear)


def sail_sag(span: float, drag_only: bool) -> float:
    """Return the sag [m] of one meter of cloth that is pinned at two points `span` [m] apart, across a steady wind.

    θ is the local angle of the cloth, 0 where it faces the wind.

    - Equal drag and lift give the normal pressure p·cosθ: y = −b·ln cos(x/b).
    - Drag alone gives the force p·cos²θ along the wind: the component H of the tension across the wind is constant. So
      dθ/ds = (p/H)·cos⁴θ and, with t = tanθ, s = (H/p)·(t + t³/3).
    """
    if drag_only:

        def width(t: float) -> float:  # x of the end, over H/p
            return (t * sqrt(1 + t * t) + asinh(t)) / 2

        t = bisect_root(lambda t: span - width(t) / (t + t**3 / 3), 1e-6, 1e3)
        return ((1 + t * t) * sqrt(1 + t * t) - 1) / 3 / (2 * (t + t**3 / 3))
    half = span / 2
    # Arc length of y from one end to the other: 2b·artanh(sin(x/b)) = 1.
    b = bisect_root(lambda b: 1.0 - 2 * b * atanh(sin(half / b)), half / (pi / 2) * (1 + 1e-12), 1e3)
    return -b * log(cos(half / b))


def sail_tension(span: float, drag_only: bool) -> float:
    """Return the tension in the middle of the cloth of `sail_sag` over the wind force p·L on it face-on.

    Both are per width. With normal pressure the tension is constant along the cloth: b/L. With drag alone it is the
    component across the wind: H/(p·L) = 1/(2(t + t³/3)).
    """
    sag = sail_sag(span, drag_only)
    if drag_only:
        t = bisect_root(lambda t: ((1 + t * t) * sqrt(1 + t * t) - 1) / 3 / (2 * (t + t**3 / 3)) - sag, 1e-6, 1e3)
        return 1 / (2 * (t + t**3 / 3))
    return bisect_root(lambda b: -(-b * log(cos(span / 2 / b)) - sag), span / pi * (1 + 1e-9), 1e3)


def string_displacement(links: int, tension: float, mass: float, shape: Floats, rate: Floats, seconds: float) -> Floats:
    """Return the displacements [m] of the joints of a taut string, (links − 1,), after some seconds.

    `shape` and `rate` are the initial displacements [m] and velocities [m/s].
    """
    j = np.arange(1, links)
    sines = np.sqrt(2 / links) * np.sin(pi * np.outer(j, j) / links)
    omegas = 2 * np.sqrt(tension * links / mass) * np.sin(j * pi / (2 * links))
    displacement: Floats = sines @ (
        np.cos(omegas * seconds) * (sines @ shape) + np.sin(omegas * seconds) / omegas * (sines @ rate)
    )
    return displacement


def scarf_ratio(friction: float, radius: float) -> float:
    """Return longer end over shorter end of a scarf on a round bar, just before it slips.

    `radius` is that of the bar over the shorter end. Along the bar dT/dφ = μ·(T + w·R·sin φ) + w·R·cos φ, with the
    weight per length w of the scarf.
    """
    capstan = exp(friction * pi)
    return capstan + 2 * friction * radius * (1 + capstan) / (1 + friction**2)


def terminal_speed(area_density: float, air_density: float, drag: float) -> float:
    """Return the speed [m/s] at which drag carries a level sheet: ½ρ·C_D·v² = σ·g."""
    return sqrt(2 * area_density * GRAVITY / (air_density * drag))


def fall_in_air(seconds: float, terminal: float) -> tuple[float, float]:
    """Return (speed [m/s], distance [m]) of a fall from rest against drag that grows with the square of the speed."""
    t = GRAVITY * seconds / terminal
    return terminal * tanh(t), terminal**2 / GRAVITY * log(cosh(t))


def spring_scheme(solver: str, omega: float, h: float, steps: int) -> Floats:
    """Return the displacement of one spring after 0, 1, … steps of a solver from its release.

    It is a share of the initial displacement.
    """
    step = spring_step(solver, omega * h)
    states = [np.array([1.0, 0.0])]
    for _ in range(steps):
        states.append(step @ states[-1])
    return np.array(states)[:, 0]


def spring_amplitude(solver: str, omega: float, h: float, steps: int) -> float:
    """Return the amplitude √(x² + (v/ω)²) of one spring after some steps, as a share of that at its release."""
    x, hv = np.linalg.matrix_power(spring_step(solver, omega * h), steps) @ [1.0, 0.0]
    return float(np.hypot(x, hv / (omega * h)))


def spring_step(solver: str, w: float) -> Floats:
    """Return the matrix, (2, 2), of a solver's step h for the spring x″ = −ω²x, on (x, h·v); `w` is ω·h."""
    if solver == "rk4":
        z = np.array([[0.0, 1.0], [-w * w, 0.0]])
        runge_kutta: Floats = np.eye(2) + z + z @ z / 2 + z @ z @ z / 6 + z @ z @ z @ z / 24
        return runge_kutta
    if solver == "explicit":  # half kick, drift, half kick
        return np.array([[1 - w * w / 2, 1.0], [-w * w * (1 - w * w / 4), 1 - w * w / 2]])
    if solver in TWO_STAGE:  # two stages that each solve with 1 − γz (Alexander 1977)
        z, gamma = np.array([[0.0, 1.0], [-w * w, 0.0]]), 1 - sqrt(0.5)
        one = np.linalg.inv(np.eye(2) - gamma * z)
        two_stage: Floats = (np.eye(2) + (1 - 2 * gamma) * z) @ one @ one
        return two_stage
    euler: Floats = np.array([[1.0, 1.0], [-w * w, 1.0]]) / (1 + w * w)
    return euler


# -- elastica ----------------------------------------------------------------------------------------------------------

ELASTICA_STEPS = 1000  # along a strip; halving them changes the tenth digit


def elastica(angle: float, rate: float, length: float, bends: Callable[[float, float], float]) -> Floats:
    """Return (angle, angle', x, y) along a curve with angle'' = bends(s, angle), (steps + 1, 4).

    It is integrated by the classical Runge–Kutta method.
    """

    def slope(s: float, y: Floats) -> Floats:
        return np.array([y[1], bends(s, y[0]), cos(y[0]), sin(y[0])])

    h = length / ELASTICA_STEPS
    line = [np.array([angle, rate, 0.0, 0.0])]
    for k in range(ELASTICA_STEPS):
        s, y = k * h, line[-1]
        a = slope(s, y)
        b = slope(s + h / 2, y + h / 2 * a)
        c = slope(s + h / 2, y + h / 2 * b)
        line.append(y + h / 6 * (a + 2 * b + 2 * c + slope(s + h, y + h * c)))
    return np.array(line)


def cantilever(gamma: float, load: float = 0.0) -> tuple[float, float]:
    """Return (drop, reach) over the length L of a strip that is clamped level at one end.

    `gamma` is Γ = σgL³/B and `load` is the tip load α = PL²/EI. With s measured from the free tip in units of L, the
    angle ψ from the vertical obeys ψ'' = (Γ·s + α)·sin ψ until it is ½π at the clamp. The angle of the tip is found by
    bisection.
    """
    low, high = -0.75 * sqrt(gamma) - sqrt(load) - 5, log(pi / 2)  # bounds of log ψ at the tip
    while low < (middle := (low + high) / 2) < high:
        line = elastica(float(np.exp(middle)), 0.0, 1.0, lambda s, psi: (gamma * s + load) * sin(psi))
        if line[:, 0].max() < pi / 2:
            low = middle
        else:
            high = middle
        if high - low < 1e-13:
            break
    return float(line[-1, 2]), float(line[-1, 3])


def buckled(compression: float) -> float:
    """Return height over length of a weightless strip with hinges that are closer than its length: Euler's elastica.

    `compression` is the difference as a share of the length, 2·(1 − E(k)/K(k)). The height is k/K(k). Both come from
    the arithmetic-geometric mean.
    """
    low, high = 0.0, 1.0
    for _ in range(60):
        k = (low + high) / 2
        a, b, lost, weight = 1.0, sqrt(1 - k * k), k * k / 2, 1.0
        while abs(a - b) > 1e-15:
            a, b, c = (a + b) / 2, sqrt(a * b), (a - b) / 2
            lost += weight * c * c
            weight *= 2
        low, high = (k, high) if 2 * lost < compression else (low, k)
    return k * 2 * a / pi


def pear_loop() -> float:
    """Return height over length of the loop of a weightless strip whose ends are clamped side by side, pointing up.

    One half starts at the angle ½π, ends above its start and has turned to π there. Its initial rate and its tension
    are found by Newton's method. (The heart loop of ASTM D1388, whose halves fall outward, is the same equation for −π.
    Without weight it is not a minimum: a strip left in it rolls over into this one.)
    """
    unknown = np.array([-6.0, 20.0])  # initial guess

    def end(unknown: Floats) -> Floats:
        last: Floats = elastica(pi / 2, unknown[0], 0.5, lambda _, angle: unknown[1] * sin(angle))[-1]
        return last

    def mismatch(unknown: Floats) -> Floats:
        return end(unknown)[[0, 2]] - [pi, 0.0]

    for _ in range(12):
        current = mismatch(unknown)
        slopes = np.stack([(mismatch(unknown + step) - current) / 1e-6 for step in 1e-6 * np.eye(2)], axis=-1)
        unknown = unknown - np.linalg.solve(slopes, current)
    return float(end(unknown)[3])
