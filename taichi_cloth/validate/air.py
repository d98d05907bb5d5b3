"""A6: air."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from ..measure.convergence import unfinished_share
from ..scene.model import Forces, Scene, Wind
from ..simulation import Simulation
from ..view.clock import FrameClock
from .exact import fall_in_air, sail_sag, sail_tension, terminal_speed
from .laws import SOFTER
from .row import Row, relative
from .setups import ELASTIC, Timed, advance, base, center, strip, strip_constant, substep

STILL = Wind(turbulence=0.0)
DENSITIES = (0.1, 0.15, 0.2, 0.5)  # [kg/m²]
TIMES = (0.2, 1.0)  # [s]
RATES = (30, 120, 240)  # pictures a second, beside the 60 of all other rows
FALL = (1e-2, 1e-3)  # A6: 1 %, 0.1 %
SAIL = (1e-2, 2e-3)  # A6: 1 %, 0.2 %
SAIL_LINKS = 32
SPANS = (0.6, 0.8, 0.9)  # [m]
TENSION_SPAN = 0.8
WIND = 2.0  # [m/s]


def falling(solver: str) -> Iterator[Row]:
    """A level sheet in still air: its speed at the end, and on the way there."""
    for density in DENSITIES:
        terminal = terminal_speed(density, STILL.air_density, STILL.drag)
        with Timed(level(solver, density)) as simulation:
            done, start = 0.0, center(simulation)[1]
            for seconds in TIMES if density == 0.2 else ():
                advance(simulation, seconds - done)
                done = seconds
                speed, way = fall_in_air(seconds, terminal)
                yield relative(f"speed after {seconds:g} s of falling flat [m/s]", speed, mean_speed(simulation), *FALL)
                yield relative(f"way after {seconds:g} s [m]", way, start - center(simulation)[1], *FALL)
            advance(simulation, 3.0 - done)
            yield relative(f"terminal speed of {density:g} kg/m² [m/s]", terminal, mean_speed(simulation), *FALL)
    exact = fall_in_air(1.0, terminal_speed(0.2, STILL.air_density, STILL.drag))[1]
    ways = [way_with_pictures(solver, rate) for rate in RATES]
    worst = max(ways, key=lambda way: abs(way - exact))
    rates = ", ".join(map(str, RATES))
    yield relative(f"way after 1 s at {rates} pictures a second, the worst [m]", exact, worst, *FALL)


def way_with_pictures(solver: str, rate: int) -> float:
    """Of a sheet that falls flat for a second [m], in frames as a window makes them at so many pictures a second."""
    with Timed(level(solver, 0.2)) as simulation:
        clock, start = FrameClock(0.0), center(simulation)[1]
        for picture in range(1, rate + 1):
            for _ in range(clock.due(picture / rate)):
                simulation.advance_frame()
        way: float = start - center(simulation)[1]
        return way


def level(solver: str, density: float) -> Scene:
    return replace(base(solver, rotation=(-90.0, 0.0, 0.0), area_density=density), wind=STILL)


def sail(solver: str) -> Iterator[Row]:
    """A strip held at two edges across a steady wind, without gravity. Its shape tells which law of drag is coded."""
    for name, lift in (
        ("lift and drag: pressure with the cosine", 1.0),
        ("drag alone: its square, along the wind", 0.0),
    ):
        for span in SPANS:
            scene = strip(solver, SAIL_LINKS, constant=5e3, pins=("top", "bottom"))
            scene = replace(scene, wind=replace(STILL, z=WIND, lift=lift), forces=Forces(gravity=0.0))
            scene = replace(scene, solver=replace(scene.solver, damping=3.0))
            with Timed(scene) as simulation:
                start = simulation.topology.start.reshape(SAIL_LINKS + 1, 3, 3).copy()
                along = np.linspace(0.5, -0.5, SAIL_LINKS + 1)
                start[:, :, 1] = span * along[:, None]
                start[:, :, 2] = (np.sqrt(1 - span**2) * (0.5 - np.abs(along)))[:, None]
                simulation.place(start.reshape(-1, 3))
                advance(simulation, 8.0)
                sag = float(simulation.positions()[:, 2].max())
                yield relative(f"sag at {span:g} m, {name} [m]", sail_sag(span, lift == 0.0), sag, *SAIL)
                if span == TENSION_SPAN and solver in ELASTIC:
                    pulled = tension(simulation, across=lift == 0.0) / (
                        0.5 * STILL.air_density * STILL.drag * WIND**2 * 0.1
                    )
                    exact = sail_tension(span, lift == 0.0)
                    row = relative(f"tension in the middle over p·L at {span:g} m, {name}", exact, pulled, *SAIL)
                    yield row.by_law(SOFTER, partial(longer_links, simulation)) if solver == "xpbd" else row


def longer_links(simulation: Simulation) -> float:
    """How much longer links are than their tension makes them, as a share: it is their lengths that `tension` sees.

    The outer ones of the three columns have half the springs of the middle one, and bear half its wind, but masses are
    equal: each has its own share.
    """
    constant, mass = strip_constant(simulation), float(simulation.topology.mass[4])
    h, sweeps = substep(simulation), simulation.scene.solver.iterations
    outer, inner = (unfinished_share(part * constant, mass, h, sweeps) for part in (0.25, 0.5))
    return (2 * outer + inner) / 3


def mean_speed(simulation: Simulation) -> float:
    """Downwards [m/s]."""
    return -float(np.average(simulation.velocities()[:, 1], weights=simulation.topology.mass))


def tension(simulation: Simulation, across: bool) -> float:
    """[N] of the middle half of a strip, by how much longer its links are; its part across the wind, or all of it.

    Drag alone leaves only that part the same all along. `verlet` has no such number.
    """
    x = simulation.positions().reshape(-1, 3, 3)
    quarter = (len(x) - 1) // 4
    gap = np.diff(x, axis=0)[quarter:-quarter]
    long = np.linalg.norm(gap, axis=2)
    share = np.abs(gap[:, :, 1]) / long if across else 1.0
    return strip_constant(simulation) * float(((long - 1.0 / (len(x) - 1)) * share).mean())
