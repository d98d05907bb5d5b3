"""Closed forms and small exact calculations, in float64. SI units; NumPy only."""

from __future__ import annotations

from collections.abc import Callable
from math import asinh, atan2, atanh, cos, cosh, exp, log, pi, radians, sin, sqrt, tanh

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

GRAVITY = 9.81  # [m/s²] the default of a scene


def euler_drop(seconds: float, h: float) -> float:
    """Way [m] that symplectic or backward Euler falls from rest: ½gt² and ½ght more."""
    steps = round(seconds / h)
    return GRAVITY * h * h * steps * (steps + 1) / 2


def dumbbell_rate(turns: float, h: float, seconds: float) -> float:
    """Share of its rate [turns/s] that a rigid pair keeps when each step goes along the tangent and is pulled back.

    φ' = atan(sin φ/(2 − cos φ)) from step to step: x − x_prev is the velocity of position-based dynamics.
    """
    first = phi = atan2(2 * pi * turns * h, 1.0)
    for _ in range(round(seconds / h) - 1):
        phi = atan2(sin(phi), 2 - cos(phi))
    return phi / first


def pendulum_period(degrees: float, length: float) -> float:
    """4·√(l/g)·K(sin ½θ₀) [s], with the complete elliptic integral by the arithmetic-geometric mean (Gauss)."""
    a, b = 1.0, cos(radians(degrees) / 2)
    for _ in range(40):
        a, b = (a + b) / 2, sqrt(a * b)
    return 2 * pi * sqrt(length / GRAVITY) / a


def projected_swing(degrees: float, length: float, h: float, seconds: float, every: float) -> Floats:
    """Angles [rad] from hanging, every so many seconds, of a pendulum whose steps go along the tangent.

    Symplectic Euler without its rod, then pulled back to its length; x − x_prev is its velocity. It is what
    position-based dynamics make of a pendulum when all constraints are met.
    """
    angle = radians(degrees)
    x = length * np.array([sin(angle), -cos(angle)])
    v = np.zeros(2)
    seen, per = [angle], round(every / h)
    for step in range(1, round(seconds / every) * per + 1):
        there = x + h * v - np.array([0.0, GRAVITY * h * h])
        there *= length / np.hypot(*there)
        x, v = there, (there - x) / h
        if step % per == 0:
            seen.append(atan2(x[0], -x[1]))
    return np.array(seen)


def chain_modes(links: int, length: float, count: int) -> tuple[Floats, Floats]:
    """(ω [rad/s], shapes (links, count)) of a hanging chain of equal rigid links and masses that swings a little.

    The link above mass j carries links − j + 1 of them. The ω² are g/l times the zeros of the Laguerre polynomial.
    """
    carried = np.arange(links, 0, -1.0)
    stiffness = np.diag(carried + np.append(carried[1:], 0.0))
    stiffness -= np.diag(carried[1:], 1) + np.diag(carried[1:], -1)
    squares, shapes = np.linalg.eigh(stiffness * GRAVITY * links / length)
    return np.sqrt(squares[:count]), shapes[:, :count]


def hanging_drop(links: int, mass: float, constant: float) -> float:
    """How much lower [m] the end of a chain of equal springs [N/m] and masses [kg] hangs than without weight."""
    return mass * GRAVITY * links * (links + 1) / (2 * constant)


def hammock(span: float, links: int, length: float, mass: float, constant: float) -> tuple[float, float]:
    """Sag [m] and tension of the last link [N] of a strip held at both ends.

    It is `length` in all, of springs [N/m] with equal masses [kg] at their joints.
    """
    vertical = (np.arange(links) - (links - 1) / 2) * mass * GRAVITY
    rest = length / links

    def shape(horizontal: float) -> tuple[float, float]:
        tension = np.hypot(horizontal, vertical)
        long = rest + tension / constant
        return float((long * horizontal / tension).sum()), float(-np.cumsum(long * vertical / tension).min())

    horizontal = root(lambda f: shape(f)[0] - span, 1e-12, constant * length + mass * GRAVITY * links)
    return shape(horizontal)[1], float(np.hypot(horizontal, vertical[-1]))


def root(function: Callable[[float], float], low: float, high: float) -> float:
    """Where a rising function is zero, by bisection."""
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if function(middle) < 0 else (low, middle)
    return (low + high) / 2


def taut_modes(links: int, tension: float, mass: float, length: float, count: int) -> Floats:
    """ω [rad/s] of a string of equal links and masses [kg] under a tension [N], across: 2·√(T/ma)·sin(jπ/2N)."""
    j = np.arange(1, count + 1)
    omegas: Floats = 2 * np.sqrt(tension * links / (mass * length)) * np.sin(j * pi / (2 * links))
    return omegas


def upright_modes(links: int, constant: float, mass: float, count: int) -> Floats:
    """ω [rad/s] of equal springs [N/m] and masses [kg] along themselves, hanging from one end."""
    j = np.arange(1, count + 1)
    omegas: Floats = 2 * np.sqrt(constant / mass) * np.sin((2 * j - 1) * pi / (2 * (2 * links + 1)))
    return omegas


def drum_modes(cells: int, tension: float, mass: float, m: int, n: int) -> float:
    """ω [rad/s] of a square of cells of one metre in all, held at its edges: springs under `tension` [N] each way."""
    sines = sin(m * pi / (2 * cells)) ** 2 + sin(n * pi / (2 * cells)) ** 2
    return 2 * sqrt(tension * cells / mass * sines)


def drum_sag(cells: int, tension: float, mass: float) -> float:
    """How low [m] its middle hangs under its weight where that is little: the five-point equation of Poisson.

    Solved in its own modes, sines both ways.
    """
    n = np.arange(1, cells)
    sines = np.sqrt(2 / cells) * np.sin(pi * np.outer(n, n) / cells)
    squares = 4 * np.sin(n * pi / (2 * cells)) ** 2
    weight = sines @ np.full((cells - 1, cells - 1), mass * GRAVITY) @ sines
    sag: Floats = sines @ (weight / (tension * cells * (squares[:, None] + squares))) @ sines
    return float(sag[cells // 2 - 1, cells // 2 - 1])


def damped_swing(omega: float, ratio: float, seconds: Floats) -> Floats:
    """Distance from rest, as a share of the first, of an oscillator let go, with this share of critical damping."""
    turns, decay = omega * sqrt(1 - ratio**2), ratio * omega
    found: Floats = np.exp(-decay * seconds) * (np.cos(turns * seconds) + decay / turns * np.sin(turns * seconds))
    return found


def relaxed_chain(links: int, rate: float, iterations: int, compliance: float, seconds: float) -> Floats:
    """Length over its links of a chain of 1 kg each that is let go hanging, after every step: XPBD itself.

    Along one line, red springs before black ones (Macklin 2016, Algorithm 1); `rate` in steps a second, `compliance`
    [m/N], links of 1 m.
    """
    h = 1 / rate
    w = np.append(0.0, np.ones(links))
    x, v = -np.arange(links + 1.0), np.zeros(links + 1)
    alpha = compliance / h**2
    steps = round(seconds / h)
    lengths = []
    for _ in range(steps):
        before, total = x.copy(), np.zeros(links)
        v[1:] -= GRAVITY * h
        x = x + h * v
        for _ in range(iterations):
            for first in (0, 1):
                j = np.arange(first, links, 2)
                change = (1.0 - x[j] + x[j + 1] - alpha * total[j]) / (w[j] + w[j + 1] + alpha)
                total[j] += change
                x[j] += w[j] * change
                x[j + 1] -= w[j + 1] * change
        v = (x - before) / h
        lengths.append(-x[-1])
    return np.array(lengths) / links


def sheet_modulus(structural: float, shear: float) -> float:
    """Force per strain and width [N/m] of a grid with both diagonals, pulled along its threads and free across them.

    The diagonals make it narrower: k_s·(k_s + 2k_d)/(k_s + k_d), of the homogenised grid.
    """
    return structural * (structural + 2 * shear) / (structural + shear)


def bias_modulus(structural: float, shear: float) -> float:
    """The same at 45° to the threads: 4k_d·(k_s + 2k_d)/(k_s + 4k_d)."""
    return 4 * shear * (structural + 2 * shear) / (structural + 4 * shear)


def sail_sag(span: float, drag_only: bool) -> float:
    """Sag [m] of one metre of sheet held at `span` [m] across a steady wind, at the angle θ to it from place to place.

    Normal pressure p·cosθ (drag and lift alike): y = −b·ln cos(x/b). Force p·cos²θ along the wind (drag alone): the
    tension has a constant part H across it, so that dθ/ds = (p/H)·cos⁴θ, and s = (H/p)·(t + t³/3) with t = tanθ.
    """
    if drag_only:

        def width(t: float) -> float:  # x of the end, over H/p
            return (t * sqrt(1 + t * t) + asinh(t)) / 2

        t = root(lambda t: span - width(t) / (t + t**3 / 3), 1e-6, 1e3)
        return ((1 + t * t) * sqrt(1 + t * t) - 1) / 3 / (2 * (t + t**3 / 3))
    half = span / 2
    # Arc length of y from one end to the other: 2b·artanh(sin(x/b)) = 1.
    b = root(lambda b: 1.0 - 2 * b * atanh(sin(half / b)), half / (pi / 2) * (1 + 1e-12), 1e3)
    return -b * log(cos(half / b))


def sail_tension(span: float, drag_only: bool) -> float:
    """Tension [N] in the middle of that sheet over what the wind would do to it face-on, p·L [N], for each width.

    Normal pressure: the same all along, b/L. Drag alone: its part across the wind, H/(p·L) = 1/(2(t + t³/3)).
    """
    sag = sail_sag(span, drag_only)
    if drag_only:
        t = root(lambda t: ((1 + t * t) * sqrt(1 + t * t) - 1) / 3 / (2 * (t + t**3 / 3)) - sag, 1e-6, 1e3)
        return 1 / (2 * (t + t**3 / 3))
    return root(lambda b: -(-b * log(cos(span / 2 / b)) - sag), span / pi * (1 + 1e-9), 1e3)


def wave(links: int, tension: float, mass: float, shape: Floats, rate: Floats, seconds: float) -> Floats:
    """Distances [m] of the joints of a taut string, (links − 1,), some time after they had this shape and rate."""
    j = np.arange(1, links)
    sines = np.sqrt(2 / links) * np.sin(pi * np.outer(j, j) / links)
    omegas = 2 * np.sqrt(tension * links / mass) * np.sin(j * pi / (2 * links))
    found: Floats = sines @ (
        np.cos(omegas * seconds) * (sines @ shape) + np.sin(omegas * seconds) / omegas * (sines @ rate)
    )
    return found


def scarf_ratio(friction: float, radius: float) -> float:
    """Longer end over shorter of a scarf that just holds on a round bar; `radius` of the bar over the shorter end.

    Along the bar dT/dφ = μ·(T + w·R·sin φ) + w·R·cos φ, the rope's own weight w beside what it carries.
    """
    held = exp(friction * pi)
    return held + 2 * friction * radius * (1 + held) / (1 + friction**2)


def terminal_speed(area_density: float, air_density: float, drag: float) -> float:
    """Speed [m/s] at which the air carries a level sheet: ½ρ·C_D·v² = σ·g."""
    return sqrt(2 * area_density * GRAVITY / (air_density * drag))


def fall_in_air(seconds: float, terminal: float) -> tuple[float, float]:
    """(speed [m/s], way [m]) of a fall from rest against drag that grows with the square of the speed."""
    t = GRAVITY * seconds / terminal
    return terminal * tanh(t), terminal**2 / GRAVITY * log(cosh(t))


def spring_scheme(solver: str, omega: float, h: float, steps: int) -> Floats:
    """Distance from rest, as a share of the first, of one spring let go, after 0, 1, … steps of each method."""
    w = omega * h
    if solver == "rk4":
        z = np.array([[0.0, 1.0], [-w * w, 0.0]])  # of (x, h·v)
        step = np.eye(2) + z + z @ z / 2 + z @ z @ z / 6 + z @ z @ z @ z / 24
    elif solver == "spring":  # half a kick, a drift, half a kick
        step = np.array([[1 - w * w / 2, 1.0], [-w * w * (1 - w * w / 4), 1 - w * w / 2]])
    elif solver == "lines":  # two stages that each solve with 1 − γz (Alexander 1977)
        z, gamma = np.array([[0.0, 1.0], [-w * w, 0.0]]), 1 - sqrt(0.5)
        one = np.linalg.inv(np.eye(2) - gamma * z)
        step = (np.eye(2) + (1 - 2 * gamma) * z) @ one @ one
    else:  # backward Euler
        step = np.array([[1.0, 1.0], [-w * w, 1.0]]) / (1 + w * w)
    states = [np.array([1.0, 0.0])]
    for _ in range(steps):
        states.append(step @ states[-1])
    return np.array(states)[:, 0]


ELASTICA_STEPS = 1000  # of a strip; halving them changes the tenth digit


def elastica(angle: float, rate: float, length: float, bends: Callable[[float, float], float]) -> Floats:
    """(angle, its rate, x, y) along a line that turns by angle'' = bends(s, angle), (steps + 1, 4); Runge–Kutta."""

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
    """(drop, reach) over the length L of a strip clamped level at one end, for Γ = σgL³/B and a tip load α = PL²/EI.

    Measured from the free tip in lengths of the strip, the angle ψ from the vertical obeys ψ'' = (Γ·s + α)·sin ψ until
    it is ½π at the clamp; the angle of the tip is found by bisection.
    """
    low, high = -0.75 * sqrt(gamma) - sqrt(load) - 5, log(pi / 2)  # of log ψ at the tip
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
    """Height over length of a weightless strip on hinges that are nearer by this share of its length: Euler's elastica.

    2·(1 − E(k)/K(k)) is the compression and k/K(k) the height, by the arithmetic-geometric mean.
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
    """Height over length of a weightless strip whose ends are clamped side by side, pointing up: a loop above them.

    One half leaves at ½π, ends above its beginning and has turned to π there; its first rate and its tension are found
    by Newton's method. (The heart loop of ASTM D1388, whose halves fall outwards, is the same equation for −π. Without
    weight it is no minimum: a strip left in it rolls over into this one.)
    """
    unknown = np.array([-6.0, 20.0])  # near enough

    def end(unknown: Floats) -> Floats:
        last: Floats = elastica(pi / 2, unknown[0], 0.5, lambda _, angle: unknown[1] * sin(angle))[-1]
        return last

    def missed(unknown: Floats) -> Floats:
        return end(unknown)[[0, 2]] - [pi, 0.0]

    for _ in range(12):
        there = missed(unknown)
        slopes = np.stack([(missed(unknown + step) - there) / 1e-6 for step in 1e-6 * np.eye(2)], axis=-1)
        unknown = unknown - np.linalg.solve(slopes, there)
    return float(end(unknown)[3])
