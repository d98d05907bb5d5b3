"""A7: contact and friction."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import atan, degrees, pi, sqrt

import numpy as np

from ..scene.model import Capsule, Ground, Plane, Scene
from ..simulation import Simulation
from .exact import GRAVITY, scarf_ratio
from .row import Row, at_most, relative
from .setups import advance, base, center, strip

FRICTIONS = (0.1, 0.3, 0.5)
SPEED = 1.0  # [m/s]
SLOPES = (0.1, 0.3, 0.8)  # frictions at which the angle is sought where a sheet begins to slide
SLIP = 2e-3  # [m] in a second: what slides moves more, 1 % above the angle where it begins, and what sticks less
HALVINGS = 9  # of the range from 0.25 to 1.75 of what is sought: to 0.2 %
BAR, SHORT_END, SCARF_LINKS = 0.03, 0.3, 120  # [m] radius of the bar, and the shorter end of the scarf
LEVEL = (-90.0, 0.0, 0.0)


def stopping(solver: str) -> Iterator[Row]:
    """A sheet slides over the ground until friction has used its energy up: v²/(2μg)."""
    for friction in FRICTIONS:
        ground = Ground(height=0.0, margin=0.0, friction=friction)
        with Simulation(replace(base(solver, rotation=LEVEL), ground=ground)) as simulation:
            advance(simulation, 0.2)
            x = simulation.positions()
            simulation.place(x, (SPEED, 0.0, 0.0))
            start = center(simulation)[0]
            advance(simulation, SPEED / (friction * GRAVITY) + 0.5)
            exact = SPEED**2 / (2 * friction * GRAVITY)
            yield relative(
                f"way to a stop from 1 m/s, μ = {friction:g} [m]", exact, center(simulation)[0] - start, 0.05, 0.01
            )


def resting(solver: str) -> Iterator[Row]:
    """Dropped from 5 cm on the ground: five seconds later it lies still, on it and not in it."""
    scene = replace(base(solver, rotation=LEVEL, center=(0.0, 0.05, 0.0)), ground=Ground(height=0.0, margin=0.0))
    with Simulation(scene) as simulation:
        advance(simulation, 5.0)
        before = simulation.positions()
        simulation.advance_frame()
        energy = 0.5 * float((simulation.velocities() ** 2).sum(axis=1).max())
        yield at_most("kinetic energy of the fastest particle after 5 s [J/kg]", energy, 1e-6, 1e-10)
        way = float(np.linalg.norm(simulation.positions() - before, axis=1).max())
        yield at_most("way of the fastest particle in the next frame [m]", way, 2e-5, 2e-7)  # at those energies
        yield at_most("depth in the ground [m]", simulation.measure().penetration, 1e-4, 1e-9)
        drift = float(np.linalg.norm(center(simulation)[[0, 2]]))
        yield at_most("creep over the ground [m]", drift, 1e-3, 1e-5)


def on_slope(solver: str, tangent: float, friction: float) -> Scene:
    """A sheet that lies on a slope that falls towards −x."""
    angle = degrees(atan(tangent))
    slope = Plane(rotation=(0.0, 0.0, angle), margin=0.0, friction=friction)
    return replace(base(solver, rotation=(-90.0, 0.0, angle)), planes=(slope,))


def incline(solver: str) -> Iterator[Row]:
    """A sheet slides where the slope is steeper than the friction, tan θ > μ, at g·(sin θ − μ·cos θ); else it lies."""
    for friction in SLOPES:

        def slides(share: float, friction: float = friction) -> bool:
            with Simulation(on_slope(solver, share * friction, friction)) as simulation:
                advance(simulation, 1.0)
                return float(np.linalg.norm(center(simulation))) > SLIP

        yield relative(f"slope where it slides, μ = {friction:g}", friction, friction * where(slides), 0.05, 0.01)
    with Simulation(on_slope(solver, 0.9 * 0.5, 0.5)) as simulation:
        advance(simulation, 1.0)  # it has found its place
        before = center(simulation)
        advance(simulation, 10.0)
        creep = float(np.linalg.norm(center(simulation) - before))
        yield at_most("creep in 10 s at 0.9 of that slope, μ = 0.5 [m]", creep, 1e-3, 1e-5)
    for friction in (0.2, 0.4):
        with Simulation(on_slope(solver, 1 / sqrt(3), friction)) as simulation:
            advance(simulation, 1.0)
            way = GRAVITY * (0.5 - friction * sqrt(0.75)) / 2
            measured = float(np.linalg.norm(center(simulation)))
            yield relative(f"way down 30° in 1 s, μ = {friction:g} [m]", way, measured, 0.05, 0.01)


def scarf(solver: str) -> Iterator[Row]:
    """A scarf over a round bar slips where its longer end outweighs what friction holds along half the bar."""
    for friction in (0.1, 0.3):
        exact = scarf_ratio(friction, BAR / SHORT_END)

        def slips(share: float, friction: float = friction, exact: float = exact) -> bool:
            long_end = SHORT_END * exact * share
            length = SHORT_END + pi * BAR + long_end
            scene = strip(solver, SCARF_LINKS, constant=2000.0, pins=())
            bar = Capsule(rotation=(90.0, 0.0, 0.0), center=(0.0, 0.0, 0.0), length=1.0, radius=BAR, margin=0.0)
            bar = replace(bar, friction=friction)
            scene = replace(scene, cloth=replace(scene.cloth, height=length), capsules=(bar,))
            with Simulation(scene) as simulation:
                along = np.linspace(0.0, length, SCARF_LINKS + 1) - SHORT_END
                angle = np.clip(along / BAR, 0.0, pi)
                below = np.minimum(along, 0.0) + np.minimum(length - SHORT_END - along - long_end, 0.0)
                places = np.stack([-BAR * np.cos(angle), BAR * np.sin(angle) + below, 0.0 * along], axis=1)
                across = simulation.topology.start.reshape(-1, 3, 3)[0, :, 0] - simulation.topology.start[1, 0]
                simulation.place((places[:, None] + across[:, None] * np.array([0.0, 0.0, 1.0])).reshape(-1, 3))
                before = simulation.positions()[-2, 1]
                advance(simulation, 1.0)
                return float(before - simulation.positions()[-2, 1]) > 10 * SLIP

        yield relative(
            f"longer end over shorter where it slips, μ = {friction:g}", exact, exact * where(slips), 0.1, 0.03
        )


def where(happens: Callable[[float], bool]) -> float:
    """The share between 0.25 and 1.75 from which on something happens."""
    low, high = 0.25, 1.75
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if happens(middle) else (middle, high)
    return (low + high) / 2
